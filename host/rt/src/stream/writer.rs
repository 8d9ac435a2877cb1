//! The output's end of a link.
//!
//! One producer at a time is inside; a second one at the same moment is turned away and counted as a drop.

use std::sync::Arc;

use super::{DropPolicy, Link, Meta, Order, Payload, StreamCounters, StreamStats, count, fifo, tally};
use crate::exclusive::TryCell;
use crate::pool::Frame;
use crate::sync::Ordering;

/// What became of a push. All but `Queued` and `DroppedOldest` mean that this sample will not be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pushed {
    Queued,
    /// Queued, and an older unseen sample gave way.
    DroppedOldest,
    /// The queue is full and keeps the old ones, or another thread was just pushing.
    DroppedNewest,
    /// Plain bytes to a link of frames, a frame to a link of bytes, or more bytes than a sample has.
    WrongPayload,
    /// The reader is gone.
    NoReader,
}

/// The places the writer owns.
pub(super) enum End {
    Latest { back: usize },
    Fifo(fifo::Writing),
}

/// The writing end: for one producer thread, reachable through `&self`.
pub struct StreamWriter {
    pub(super) link: Arc<Link>,
    pub(super) end: TryCell<End>,
}

impl StreamWriter {
    /// Offers a sample of plain bytes, copied. Never waits.
    #[inline]
    pub fn push(&self, data: &[u8], meta: Meta) -> Pushed {
        let fits = matches!(self.link.payload, Payload::Plain { bytes } if data.len() <= bytes);
        // SAFETY: `offer` gives a place that the writer owns; the length fits.
        self.offer(fits, |place| unsafe { self.link.slots.write(place, meta, data) })
    }

    /// As [`StreamWriter::push`], for a sample that does not leave its thread: a latest link of plain bytes takes it without an
    /// atomic operation.
    ///
    /// # Safety
    /// The calling thread has the right to read the link now, as if it held its reader: while this runs no other thread is in
    /// any method of the reader that takes `&mut self`, and one that is there later comes after it. (The drop of the reader
    /// may run meanwhile.)
    #[inline]
    pub unsafe fn push_here(&self, data: &[u8], meta: Meta) -> Pushed {
        let fits = matches!(self.link.payload, Payload::Plain { bytes } if data.len() <= bytes);
        if !fits || !matches!(self.link.order, Order::Latest(_)) || !self.has_reader() {
            return self.push(data, meta);
        }
        let here = &self.link.here;
        // SAFETY: the caller has the right to read, so the back place is nobody else's; the length fits.
        unsafe { self.link.slots.write(here.back(), meta, data) };
        let counters = &self.link.counters.reader.0;
        tally(&counters.pushed_here, 1);
        if here.publish() {
            tally(&counters.skipped, 1);
            return Pushed::DroppedOldest;
        }
        Pushed::Queued
    }

    /// Offers a frame: its handle is passed on, or dropped. Never waits.
    pub fn push_frame(&self, frame: Frame, meta: Meta) -> Pushed {
        self.offer(self.link.payload == Payload::Frame, |place| {
            // SAFETY: `offer` gives a place that the writer owns, and this is its only reference.
            let content = unsafe { self.link.slots.content(place) };
            content.meta = meta;
            content.frame = Some(frame);
        })
    }

    /// Whether the reading end still exists.
    #[inline]
    pub fn has_reader(&self) -> bool {
        !self.link.reader_left.load(Ordering::Relaxed)
    }

    pub fn stats(&self) -> StreamStats {
        self.counters().stats()
    }

    /// The link's counters, for whoever shows them.
    pub fn counters(&self) -> StreamCounters {
        StreamCounters(Arc::clone(&self.link.counters))
    }

    #[inline]
    fn offer(&self, fits: bool, fill: impl FnOnce(usize)) -> Pushed {
        let counters = &self.link.counters.writer.0;
        if fits
            && self.has_reader()
            && let Some(mut end) = self.end.try_enter()
        {
            tally(&counters.pushed, 1);
            let pushed = self.put(&mut end, fill);
            if pushed != Pushed::Queued {
                tally(&counters.dropped, 1);
            }
            return pushed;
        }
        count(&counters.turned_away, 1);
        if !fits {
            Pushed::WrongPayload
        } else if !self.has_reader() {
            Pushed::NoReader
        } else {
            Pushed::DroppedNewest
        }
    }

    #[inline]
    fn put(&self, end: &mut End, fill: impl FnOnce(usize)) -> Pushed {
        match (&self.link.order, end) {
            (Order::Latest(latest), End::Latest { back }) => {
                fill(*back);
                let (got, unseen) = latest.publish(*back);
                *back = got;
                // SAFETY: the place was just taken over by the writer.
                unsafe { self.link.slots.empty(got) };
                if unseen { Pushed::DroppedOldest } else { Pushed::Queued }
            }
            (Order::Fifo(fifo), End::Fifo(writing)) => {
                if fifo.drop == DropPolicy::DropNewest && fifo.is_full(writing) {
                    return Pushed::DroppedNewest;
                }
                let Some(place) = fifo.free_place(writing) else { return Pushed::DroppedNewest };
                fill(place);
                // SAFETY: the oldest place was just taken over by the writer.
                let dropped = fifo.push(writing, place, |oldest| unsafe { self.link.slots.empty(oldest) });
                if dropped { Pushed::DroppedOldest } else { Pushed::Queued }
            }
            _ => unreachable!("both are made together in `stream_link`"),
        }
    }
}

impl Drop for StreamWriter {
    fn drop(&mut self) {
        self.link.writer_left.store(true, Ordering::Release);
    }
}
