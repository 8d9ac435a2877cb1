//! Protobuf's wire format, as far as it is written here: keys, varints, and messages whose length is known
//! afterwards.
//!
//! Invariant: every length stands before exactly so many bytes.

/// Varint, 4 bytes, 8 bytes, length and bytes.
pub(crate) const VARINT: u32 = 0;
pub(crate) const FIXED64: u32 = 1;
pub(crate) const BYTES: u32 = 2;
pub(crate) const FIXED32: u32 = 5;

pub(crate) fn varint(to: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        to.push(value as u8 | 0x80);
        value >>= 7;
    }
    to.push(value as u8);
}

pub(crate) fn key(to: &mut Vec<u8>, number: u32, wire: u32) {
    varint(to, u64::from(number << 3 | wire));
}

pub(crate) fn bytes(to: &mut Vec<u8>, number: u32, value: &[u8]) {
    bytes_follow(to, number, value.len());
    to.extend_from_slice(value);
}

/// Writes the key and length before so many bytes.
pub(crate) fn bytes_follow(to: &mut Vec<u8>, number: u32, len: usize) {
    key(to, number, BYTES);
    varint(to, len as u64);
}

pub(crate) fn fixed32(to: &mut Vec<u8>, number: u32, value: u32) {
    key(to, number, FIXED32);
    to.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn double(to: &mut Vec<u8>, number: u32, value: f64) {
    key(to, number, FIXED64);
    to.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn number(to: &mut Vec<u8>, number: u32, value: u64) {
    key(to, number, VARINT);
    varint(to, value);
}

/// A message inside: `write` appends it, and its length is put before it.
pub(crate) fn message(to: &mut Vec<u8>, number: u32, write: impl FnOnce(&mut Vec<u8>)) {
    key(to, number, BYTES);
    let at = to.len();
    write(to);
    let len = to.len() - at;
    let mut digits = [0u8; 10];
    let mut used = 0;
    let mut rest = len as u64;
    loop {
        digits[used] = rest as u8 & 0x7f | if rest >= 0x80 { 0x80 } else { 0 };
        used += 1;
        rest >>= 7;
        if rest == 0 {
            break;
        }
    }
    to.resize(to.len() + used, 0);
    to.copy_within(at..at + len, at + used);
    to[at..at + used].copy_from_slice(&digits[..used]);
}

/// A `google.protobuf.Timestamp`.
pub(crate) fn timestamp(to: &mut Vec<u8>, field: u32, ns: u64) {
    message(to, field, |to| {
        number(to, 1, ns / 1_000_000_000);
        number(to, 2, ns % 1_000_000_000);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_stands_before_its_message_however_long_it_is() {
        for len in [0usize, 1, 127, 128, 300, 20_000] {
            let mut to = vec![9];
            message(&mut to, 1, |to| to.resize(to.len() + len, 7));
            let mut wanted = vec![9, 0x0a];
            varint(&mut wanted, len as u64);
            wanted.resize(wanted.len() + len, 7);
            assert_eq!(to, wanted, "{len}");
        }
    }
}
