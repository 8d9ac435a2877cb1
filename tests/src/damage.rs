//! Spoiling copies of good plugin files.
//!
//! Invariant: a damaged copy differs from the good file in exactly what the caller asked for.

/// The same bytes with one bit turned.
#[must_use]
pub fn flip_bit(good: &[u8], bit: usize) -> Vec<u8> {
    let mut bytes = good.to_vec();
    bytes[bit / 8] ^= 1 << (bit % 8);
    bytes
}

/// The same bytes with every `from` replaced by the equally long `to`.
///
/// # Panics
/// When the lengths differ or `from` does not occur.
#[must_use]
pub fn replace_in(good: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len(), "a file keeps its length");
    let mut bytes = good.to_vec();
    let found: Vec<usize> =
        bytes.windows(from.len()).enumerate().filter(|(_, w)| *w == from).map(|(at, _)| at).collect();
    assert!(!found.is_empty(), "{:?} does not occur", String::from_utf8_lossy(from));
    for at in found {
        bytes[at..at + to.len()].copy_from_slice(to);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bit_differs() {
        assert_eq!(flip_bit(&[0, 0], 9), [0, 2]);
    }

    #[test]
    fn every_occurrence_is_replaced() {
        assert_eq!(replace_in(b"abcab", b"ab", b"xy"), b"xycxy");
    }
}
