//! The state table: a ring of rows, published once per step by the component, read by any thread at any time.
//!
//! The writer never waits for a reader. A reader gets a whole row or the reason why not, never a torn one:
//! publication `n` lies in row `n % rows` under the sequence of [`crate::seq`].

use std::sync::Arc;

use crate::buf::AlignedBuf;
use crate::region::{self, Layout, Place};
use crate::seq::{self, Stale};
use crate::sync::{AtomicU64, Ordering, Padded};

/// Words of stamp and tick.
const HEAD: usize = 2;

/// Attempts of `latest` before it gives up: each lost one means that the writer went round the whole ring.
const ATTEMPTS: usize = 1000;
/// The same where another process may go round the ring only to keep a reader busy.
const REMOTE_ATTEMPTS: usize = 16;

/// Identity of the row that was read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RowInfo {
    /// Time of the step, ns of the monotonic clock.
    pub stamp_ns: u64,
    /// Number of the step as its executor counts.
    pub tick: u64,
    /// Number of the publication in this table, from 0 without gaps.
    pub row: u64,
}

/// Why there is no such row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Miss {
    /// Nothing was published yet.
    Empty,
    /// The row was there and has been overwritten.
    Lapped,
    /// The row lies in the future.
    NotYet,
    /// The kept rows go around it: that tick was never published.
    Missing,
}

/// Two whole rows around a time, to interpolate between: `before + fraction * (after - before)`, field by
/// field as the field's type allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Around {
    /// The last row at or before the time.
    pub before: RowInfo,
    /// The first row at or after the time; the same one when a row has exactly this stamp.
    pub after: RowInfo,
    /// Place of the time between the two stamps, from 0 (before) to less than 1.
    pub fraction: f64,
}

struct Table {
    words: region::Table<AtomicU64>,
    published: Place<Padded<AtomicU64>>,
    row_bytes: usize,
    rows: u64,
    /// Mask of the publication's number, where the rows are a power of two; else 0.
    mask: u64,
    stride: usize,
}

impl Table {
    #[inline]
    fn row(&self, n: u64) -> &[AtomicU64] {
        // A division costs more than the rest of a small row.
        let at = if self.mask != 0 { n & self.mask } else { n % self.rows };
        let start = at as usize * self.stride;
        &self.words[start..start + self.stride]
    }
}

/// A table of `rows` rows of `row_bytes` bytes (0 is allowed), with its one writer and its first reader.
///
/// # Panics
/// With fewer than 3 rows: a reader of the newest row could then be lapped by a single publication.
pub fn state_table(row_bytes: usize, rows: usize) -> (StateWriter, StateReader) {
    let table = Layout::on_heap(|layout| Table::lay_out(layout, row_bytes, rows));
    (StateWriter::new(Arc::clone(&table)), StateReader { table, attempts: ATTEMPTS })
}

/// Makes the writer of a table whose readers are in another process; the parts are what
/// [`remote_state_reader`] lays out.
///
/// # Panics
/// As [`state_table`].
pub fn remote_state_writer(layout: &mut Layout, row_bytes: usize, rows: usize) -> StateWriter {
    StateWriter::new(Table::lay_out(layout, row_bytes, rows))
}

/// Makes the reader of a table whose writer is in another process. It reads whole rows, if that process keeps
/// to the rules, and bytes in any case.
///
/// # Panics
/// As [`state_table`].
pub fn remote_state_reader(layout: &mut Layout, row_bytes: usize, rows: usize) -> StateReader {
    StateReader { table: Table::lay_out(layout, row_bytes, rows), attempts: REMOTE_ATTEMPTS }
}

impl Table {
    fn lay_out(layout: &mut Layout, row_bytes: usize, rows: usize) -> Arc<Table> {
        assert!(rows >= 3, "a state table has at least 3 rows, {rows} were asked for");
        let stride = (seq::OVERHEAD + HEAD + row_bytes.div_ceil(8)).next_multiple_of(8);
        Arc::new(Table {
            words: layout.table(stride * rows, |_| AtomicU64::new(0)),
            published: layout.place(|| Padded(AtomicU64::new(0))),
            row_bytes,
            rows: rows as u64,
            mask: if rows.is_power_of_two() { rows as u64 - 1 } else { 0 },
            stride,
        })
    }
}

/// The component's end: the only writer.
pub struct StateWriter {
    table: Arc<Table>,
    scratch: AlignedBuf,
    next: u64,
}

impl StateWriter {
    fn new(table: Arc<Table>) -> StateWriter {
        let scratch = AlignedBuf::new(table.row_bytes.next_multiple_of(8));
        StateWriter { table, scratch, next: 0 }
    }

    /// Publishes one row: `fill` writes it into the writer's own 64-byte aligned block (which still holds the
    /// row before), then it is copied into the ring. The step's thread; cost is two copies of the row.
    #[inline]
    pub fn publish(&mut self, stamp_ns: u64, tick: u64, fill: impl FnOnce(&mut [u8])) -> RowInfo {
        let row_bytes = self.table.row_bytes;
        fill(&mut self.scratch.as_mut_slice()[..row_bytes]);
        let n = self.next;
        seq::write(self.table.row(n), n, [stamp_ns, tick], self.scratch.as_mut_slice());
        self.next = n + 1;
        self.table.published.0.store(self.next, Ordering::Release);
        RowInfo { stamp_ns, tick, row: n }
    }

    /// As [`StateWriter::publish`], where stamp and tick are known only after the row: `fill` returns them,
    /// or `None` where there is nothing to publish.
    #[inline]
    pub fn publish_with(&mut self, fill: impl FnOnce(&mut [u8]) -> Option<(u64, u64)>) {
        let row_bytes = self.table.row_bytes;
        if let Some((stamp_ns, tick)) = fill(&mut self.scratch.as_mut_slice()[..row_bytes]) {
            self.publish(stamp_ns, tick, |_| ());
        }
    }

    /// The row that was published last, zeros before the first.
    #[inline]
    pub fn newest(&mut self) -> &[u8] {
        &self.scratch.as_mut_slice()[..self.table.row_bytes]
    }

    /// Another reader of the same table.
    pub fn reader(&self) -> StateReader {
        StateReader { table: Arc::clone(&self.table), attempts: ATTEMPTS }
    }
}

/// A reader: cheap to clone, for any thread. Every `out` takes the row's first `out.len()` bytes, and holds
/// nothing meaningful when no row was read.
#[derive(Clone)]
pub struct StateReader {
    table: Arc<Table>,
    /// Attempts of `latest`.
    attempts: usize,
}

impl StateReader {
    pub fn row_bytes(&self) -> usize {
        self.table.row_bytes
    }

    /// Returns the number of rows kept.
    pub fn rows(&self) -> u64 {
        self.table.rows
    }

    /// Returns the number of rows ever published.
    #[inline]
    pub fn published(&self) -> u64 {
        self.table.published.0.load(Ordering::Acquire)
    }

    /// The newest row. `None` when nothing was published yet, or when the writer went round the whole ring
    /// during each of 1000 attempts, 16 where it is another process.
    #[inline]
    pub fn latest(&self, out: &mut [u8]) -> Option<RowInfo> {
        let newest = self.published().checked_sub(1)?;
        self.read(newest, out).ok().or_else(|| self.latest_again(out))
    }

    /// Tries again: the writer was faster than the first attempt.
    #[cold]
    fn latest_again(&self, out: &mut [u8]) -> Option<RowInfo> {
        for _ in 1..self.attempts {
            let newest = self.published().checked_sub(1)?;
            if let Ok(info) = self.read(newest, out) {
                return Some(info);
            }
        }
        None
    }

    /// The row of publication `n` (see [`RowInfo::row`]).
    pub fn row(&self, n: u64, out: &mut [u8]) -> Result<RowInfo, Miss> {
        match self.published() {
            0 => Err(Miss::Empty),
            published if n >= published => Err(Miss::NotYet),
            _ => self.read(n, out),
        }
    }

    /// The row `k` publications before the newest; `delayed(0)` is the newest.
    pub fn delayed(&self, k: u64, out: &mut [u8]) -> Result<RowInfo, Miss> {
        let newest = self.published().checked_sub(1).ok_or(Miss::Empty)?;
        self.read(newest.checked_sub(k).ok_or(Miss::NotYet)?, out)
    }

    /// The row of this tick. Ticks must not decrease from row to row.
    pub fn at_tick(&self, tick: u64, out: &mut [u8]) -> Result<RowInfo, Miss> {
        let published = self.published();
        if published == 0 {
            return Err(Miss::Empty);
        }
        let n = self.first(published, |info| info.tick >= tick);
        if n == published {
            return Err(Miss::NotYet);
        }
        let info = self.read(n, out)?;
        if info.tick == tick {
            return Ok(info);
        }
        // The tick is known to lie between two rows only while the row before can still be read.
        self.info(n.checked_sub(1).ok_or(Miss::Missing)?)?;
        Err(Miss::Missing)
    }

    /// The row nearest in time. Stamps must not decrease from row to row. A time after the newest row gives
    /// the newest; a time before all kept rows is `Lapped` once rows have been overwritten.
    pub fn at_time(&self, stamp_ns: u64, out: &mut [u8]) -> Result<RowInfo, Miss> {
        let published = self.published();
        if published == 0 {
            return Err(Miss::Empty);
        }
        let after = self.first(published, |info| info.stamp_ns >= stamp_ns);
        if after == published {
            return self.read(published - 1, out);
        }
        let next = self.info(after)?;
        if after == 0 || next.stamp_ns == stamp_ns {
            return self.read(after, out);
        }
        // The row before may have been overwritten: then it cannot be known whether it was nearer.
        let before = self.info(after - 1)?;
        let nearer_before = stamp_ns - before.stamp_ns <= next.stamp_ns - stamp_ns;
        self.read(if nearer_before { after - 1 } else { after }, out)
    }

    /// The rows before and after a time, for a value in between: compare [`StateReader::at_time`]. Stamps
    /// must not decrease from row to row. A time after the newest row is `NotYet`; one before all kept rows
    /// is `Lapped` once rows have been overwritten, else `Missing`.
    pub fn around(&self, stamp_ns: u64, before: &mut [u8], after: &mut [u8]) -> Result<Around, Miss> {
        let published = self.published();
        if published == 0 {
            return Err(Miss::Empty);
        }
        let n = self.first(published, |info| info.stamp_ns >= stamp_ns);
        if n == published {
            let newest = self.info(published - 1)?;
            return Err(if newest.stamp_ns < stamp_ns { Miss::NotYet } else { Miss::Lapped });
        }
        let next = self.read(n, after)?;
        if next.stamp_ns == stamp_ns {
            return Ok(Around { before: self.read(n, before)?, after: next, fraction: 0.0 });
        }
        let last = self.read(n.checked_sub(1).ok_or(Miss::Missing)?, before)?;
        let into = stamp_ns.checked_sub(last.stamp_ns).ok_or(Miss::Missing)?;
        let fraction = into as f64 / (next.stamp_ns - last.stamp_ns) as f64;
        Ok(Around { before: last, after: next, fraction })
    }

    /// Gives every row from `cursor` on to `sink`, in order, through `scratch`, and moves the cursor on;
    /// returns how many rows were overwritten before they could be read. Start with a cursor of 0 (all kept
    /// rows; those already gone count as lost) or of `published()` (from now on). Ends at the row that was
    /// newest at entry.
    ///
    /// # Panics
    /// When `scratch` is shorter than a row.
    pub fn read_batch(
        &self,
        cursor: &mut u64,
        scratch: &mut [u8],
        mut sink: impl FnMut(RowInfo, &[u8]),
    ) -> u64 {
        let scratch = &mut scratch[..self.table.row_bytes];
        let end = self.published();
        let mut lost = 0;
        let mut skip_to = |cursor: &mut u64, n: u64| {
            lost += n.saturating_sub(*cursor);
            *cursor = (*cursor).max(n);
        };
        skip_to(cursor, self.oldest(end));
        while *cursor < end {
            match self.read(*cursor, scratch) {
                Ok(info) => {
                    sink(info, scratch);
                    *cursor += 1;
                }
                // The oldest row is always in danger, so at least the one that was just missed is given up.
                Err(_) => skip_to(cursor, self.oldest(self.published()).max(*cursor + 1)),
            }
        }
        lost
    }

    fn oldest(&self, published: u64) -> u64 {
        published.saturating_sub(self.table.rows)
    }

    /// The first kept row for which `reached` holds, or `published`: a binary search in which an overwritten
    /// row counts as not reached.
    fn first(&self, published: u64, reached: impl Fn(RowInfo) -> bool) -> u64 {
        let (mut low, mut high) = (self.oldest(published), published);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.info(middle).is_ok_and(&reached) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        low
    }

    fn info(&self, n: u64) -> Result<RowInfo, Miss> {
        self.read(n, &mut [])
    }

    #[inline]
    fn read(&self, n: u64, out: &mut [u8]) -> Result<RowInfo, Miss> {
        let wanted = out.len().min(self.table.row_bytes);
        let mut head = [0; HEAD];
        match seq::read(self.table.row(n), n, &mut head, &mut out[..wanted]) {
            Ok(()) => Ok(RowInfo { stamp_ns: head[0], tick: head[1], row: n }),
            Err(Stale::Later) => Err(Miss::Lapped),
            Err(Stale::Earlier) => Err(Miss::NotYet),
        }
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    /// The writer has begun to write over the oldest row and has not told so yet.
    #[test]
    fn a_tick_whose_row_is_being_written_over_is_lapped_and_not_missing() {
        let (mut writer, reader) = state_table(8, 4);
        for n in 0..10 {
            writer.publish(1000 * n, 2 * n, |row| row.fill(n as u8));
        }
        writer.table.row(10)[0].store(2 * 10 + 1, Ordering::Relaxed);
        let mut out = [0; 8];
        for tick in [12, 13] {
            assert_eq!(reader.at_tick(tick, &mut out), Err(Miss::Lapped), "tick {tick}");
        }
        assert_eq!(reader.at_tick(15, &mut out), Err(Miss::Missing), "it lies between two that are kept");
        assert_eq!(reader.at_tick(14, &mut out).map(|info| info.row), Ok(7));
    }
}
