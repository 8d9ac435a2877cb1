//! Rows of words under a sequence: one writer, any readers, and a reader never takes a torn row for a whole one.
//!
//! Word 0 is the sequence: `2n + 1` while publication `n` is written, `2n + 2` once it is whole. Every word is
//! stored with Release and loaded with Acquire, so a reader that met one new word also meets the new sequence.

use crate::sync::{AtomicU64, Ordering};

/// Words a row needs besides its data.
pub(crate) const OVERHEAD: usize = 1;

/// How a row differs from the publication asked for.
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

/// Writes publication `n` into the row, word by word from `data`. One writer only.
pub(crate) fn write(row: &[AtomicU64], n: u64, data: impl Iterator<Item = u64>) {
    row[0].store(2 * n + 1, Ordering::Relaxed);
    for (word, value) in row[OVERHEAD..].iter().zip(data) {
        word.store(value, Ordering::Release);
    }
    row[0].store(2 * n + 2, Ordering::Release);
}

/// Reads publication `n`, giving each word with its position to `take`; what was taken counts only with `Ok`.
pub(crate) fn read(
    row: &[AtomicU64],
    n: u64,
    limit: usize,
    mut take: impl FnMut(usize, u64),
) -> Result<(), Stale> {
    let whole = 2 * n + 2;
    let before = row[0].load(Ordering::Acquire);
    if before != whole {
        return Err(if before > whole { Stale::Later } else { Stale::Earlier });
    }
    for (at, word) in row[OVERHEAD..].iter().take(limit).enumerate() {
        take(at, word.load(Ordering::Acquire));
    }
    if row[0].load(Ordering::Relaxed) == whole { Ok(()) } else { Err(Stale::Later) }
}
