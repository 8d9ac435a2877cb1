//! Rows of words under a sequence: one writer, any readers, and a reader never takes a torn row for a whole
//! one.
//!
//! Word 0 is the sequence: `2n + 1` while publication `n` is written, `2n + 2` once it is whole. Every word
//! is stored with Release and loaded with Acquire, so a reader that met one new word also meets the new
//! sequence.

use crate::sync::{AtomicU64, Ordering};

/// Words a row needs besides its data.
pub(crate) const OVERHEAD: usize = 1;

/// Difference between a row and the publication asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stale {
    /// A later publication has taken the row, or is taking it.
    Later,
    /// The publication is not written yet.
    Earlier,
}

pub(crate) fn words(n: usize) -> Box<[AtomicU64]> {
    (0..n).map(|_| AtomicU64::new(0)).collect()
}

/// The sequence of publication `n`, which may be any number where another process says it.
#[inline]
fn whole(n: u64) -> u64 {
    n.wrapping_mul(2).wrapping_add(2)
}

/// Writes publication `n` into the row: the words of `head`, then `data`, which is whole words. One writer
/// only.
#[inline]
pub(crate) fn write<const H: usize>(row: &[AtomicU64], n: u64, head: [u64; H], data: &[u8]) {
    let (sequence, words) = row.split_at(OVERHEAD);
    let (first, rest) = words.split_at(H);
    let whole = whole(n);
    sequence[0].store(whole.wrapping_sub(1), Ordering::Relaxed);
    for (word, value) in first.iter().zip(head) {
        word.store(value, Ordering::Release);
    }
    let (data, _) = data.as_chunks::<8>();
    for (word, value) in rest.iter().zip(data) {
        word.store(u64::from_ne_bytes(*value), Ordering::Release);
    }
    sequence[0].store(whole, Ordering::Release);
}

/// Reads publication `n`: its first words, then as many of its bytes as `data` takes; they count only with
/// `Ok`.
#[inline]
pub(crate) fn read<const H: usize>(
    row: &[AtomicU64],
    n: u64,
    head: &mut [u64; H],
    data: &mut [u8],
) -> Result<(), Stale> {
    let whole = whole(n);
    let (sequence, words) = row.split_at(OVERHEAD);
    let (first, rest) = words.split_at(H);
    let before = sequence[0].load(Ordering::Acquire);
    if before != whole {
        return Err(if before > whole { Stale::Later } else { Stale::Earlier });
    }
    for (value, word) in head.iter_mut().zip(first) {
        *value = word.load(Ordering::Acquire);
    }
    let (data, last) = data.as_chunks_mut::<8>();
    for (value, word) in data.iter_mut().zip(rest) {
        *value = word.load(Ordering::Acquire).to_ne_bytes();
    }
    if !last.is_empty()
        && let Some(word) = rest.get(data.len())
    {
        last.copy_from_slice(&word.load(Ordering::Acquire).to_ne_bytes()[..last.len()]);
    }
    if sequence[0].load(Ordering::Relaxed) == whole { Ok(()) } else { Err(Stale::Later) }
}

#[cfg(all(test, loom))]
mod models {
    use std::sync::Arc;

    use super::*;
    use crate::loom_models::model_within;

    /// The sequence alone makes a row whole, whatever else tells a reader that there is one.
    #[test]
    fn loom_a_row_read_by_its_sequence_alone_is_whole_or_refused() {
        model_within(3, || {
            let row: Arc<Box<[AtomicU64]>> = Arc::new(words(OVERHEAD + 2));
            let theirs = Arc::clone(&row);
            let writer = loom::thread::spawn(move || {
                for n in 0..3 {
                    write(&theirs, n, [n + 1], &(10 * n + 1).to_ne_bytes());
                }
            });
            let (mut head, mut data) = ([0; 1], [0; 8]);
            if read(&row, 1, &mut head, &mut data).is_ok() {
                assert_eq!((head, u64::from_ne_bytes(data)), ([2], 11), "torn row");
            }
            writer.join().expect("the writer does not fail");
        });
    }
}
