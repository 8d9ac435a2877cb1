//! The output's end of a link.
//!
//! One producer at a time is inside; a second one at the same moment is turned away and counted as a drop.
//! Frames that wait in a queue leave slots of their pool free, so that a maker of frames never waits for a
//! reader that does not take them.

use std::sync::Arc;

use super::fifo::{Fifo, Writing};
use super::leases::Leases;
use super::remote::Lending;
use super::slots::{Located, Slots};
use super::{
    DropPolicy, Link, Meta, Order, Payload, StreamCounters, StreamStats, count, fifo, latest, tally,
};
use crate::exclusive::{TryCell, TryGuard};
use crate::pool::Frame;
use crate::sync::Ordering;

/// Result of a push. All but `Queued` and `DroppedOldest` mean that this sample will not be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pushed {
    Queued,
    /// Queued, and an older unseen sample gave way.
    DroppedOldest,
    /// The queue is full and keeps the old ones, too few slots of the frame's pool are free, or another
    /// thread was just pushing.
    DroppedNewest,
    /// Plain bytes to a link of frames, a frame to a link of bytes, or more bytes than a sample has.
    WrongPayload,
    /// The reader is gone.
    NoReader,
}

/// Number of times a push of [`StreamWriter::push_parts`] looks again, each time for some nanoseconds: a push
/// takes tens of them.
const LOOKS: u32 = 64;

/// The places the writer owns.
enum Owned {
    Latest { back: usize },
    Fifo(fifo::Writing),
}

/// State only the pushing thread touches.
struct End {
    owned: Owned,
    /// Frames lent on a link to another process.
    lending: Option<Lending>,
}

/// The writing end: for one producer thread, reachable through `&self`.
pub struct StreamWriter {
    link: Arc<Link>,
    end: TryCell<End>,
    /// Leases of `end`.
    leases: Option<Arc<Leases>>,
}

impl StreamWriter {
    pub(super) fn new(link: Arc<Link>, lending: Option<Lending>) -> Self {
        let owned = match &link.order {
            Order::Latest(_) => Owned::Latest { back: latest::WRITERS },
            Order::Fifo(fifo) => Owned::Fifo(fifo.writing()),
        };
        let leases = lending.as_ref().map(|lending| Arc::clone(lending.leases()));
        Self { link, end: TryCell::new(End { owned, lending }), leases }
    }

    /// Offers a sample of plain bytes, copied. Never waits.
    #[inline]
    pub fn push(&self, data: &[u8], meta: Meta) -> Pushed {
        let fits = matches!(self.link.payload, Payload::Plain { bytes } if data.len() <= bytes);
        self.offer(fits, Plain { data, meta })
    }

    /// Offers a sample in three parts: `head`, `body`, and zeros up to `bytes`. From several threads: where
    /// another one is just pushing, this looks again a few times before it counts a drop. Never waits longer.
    #[inline]
    pub fn push_parts(&self, head: &[u8], body: &[u8], bytes: usize, meta: Meta) -> Pushed {
        let filled = head.len().checked_add(body.len()).is_some_and(|n| n <= bytes);
        let fits = filled && matches!(self.link.payload, Payload::Plain { bytes: most } if bytes <= most);
        self.offer_again(fits, Parts { head, body, bytes, meta }, LOOKS)
    }

    /// As [`StreamWriter::push`], for a sample that does not leave its thread: a latest link of plain bytes
    /// takes it without an atomic operation.
    ///
    /// # Safety
    /// The calling thread has the right to read the link now, as if it held its reader: while this runs no
    /// other thread is in any method of the reader that takes `&mut self`, and one that is there later comes
    /// after it. (The drop of the reader may run meanwhile.)
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

    /// Offers a frame: its handle is passed on, or dropped. Never waits. A queue that drops its oldest keeps
    /// at most two frames for each free slot of this frame's pool, and gives up older ones until that is so
    /// (counted as dropped) or this one is alone; one that drops the newest cannot take back what it keeps,
    /// so that it takes a second one and more only while there is a free slot for each.
    pub fn push_frame(&self, frame: Frame, meta: Meta) -> Pushed {
        self.offer(self.link.payload == Payload::Frame, Lent { frame, meta })
    }

    /// Tells whether the reading end still exists.
    #[inline]
    pub fn has_reader(&self) -> bool {
        self.link.reader_left.load(Ordering::Relaxed) == 0
    }

    pub fn stats(&self) -> StreamStats {
        self.counters().stats()
    }

    /// Returns the link's counters, to be shown.
    pub fn counters(&self) -> StreamCounters {
        StreamCounters(Arc::clone(&self.link.counters))
    }

    #[inline]
    fn offer(&self, fits: bool, sample: impl Offered) -> Pushed {
        self.offer_again(fits, sample, 0)
    }

    #[inline(always)]
    fn offer_again(&self, fits: bool, sample: impl Offered, looks: u32) -> Pushed {
        let counters = &self.link.counters.writer.0;
        if fits
            && self.has_reader()
            && let Some(mut end) = self.end.try_enter().or_else(|| self.enter_again(looks))
        {
            tally(&counters.pushed, 1);
            let pushed = self.put(&mut end, sample);
            if pushed != Pushed::Queued {
                let newest_only = matches!(self.link.order, Order::Latest(_));
                let newer = newest_only && pushed == Pushed::DroppedOldest;
                tally(if newer { &counters.passed_over } else { &counters.dropped }, 1);
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

    #[cold]
    fn enter_again(&self, looks: u32) -> Option<TryGuard<'_, End>> {
        (0..looks).find_map(|_| {
            std::hint::spin_loop();
            self.end.try_enter()
        })
    }

    #[inline]
    fn put(&self, end: &mut End, sample: impl Offered) -> Pushed {
        let slots = &self.link.slots;
        let lending = &mut end.lending;
        if let Some(lending) = lending {
            lending.leases().collect();
        }
        match (&self.link.order, &mut end.owned) {
            (Order::Latest(latest), Owned::Latest { back }) => {
                // SAFETY: the writer owns its back place.
                if !unsafe { sample.fill(slots, *back, lending) } {
                    return Pushed::DroppedNewest;
                }
                let (got, unseen) = latest.publish(*back);
                *back = got;
                // SAFETY: the place was just taken over by the writer.
                unsafe { slots.empty(got) };
                if let Some(lending) = lending {
                    lending.came_back(got, unseen);
                }
                if unseen { Pushed::DroppedOldest } else { Pushed::Queued }
            }
            (Order::Fifo(fifo), Owned::Fifo(writing)) => {
                if fifo.drop == DropPolicy::DropNewest && fifo.is_full(writing) {
                    return Pushed::DroppedNewest;
                }
                let Some(given_up) = sample.make_room(fifo, writing, |oldest| empty(slots, lending, oldest))
                else {
                    return Pushed::DroppedNewest;
                };
                if given_up > 1 {
                    // The caller that learns of the drop counts one of them.
                    tally(&self.link.counters.writer.0.dropped, given_up - 1);
                }
                let Some(place) = fifo.free_place(writing) else { return Pushed::DroppedNewest };
                // SAFETY: a free place is the writer's.
                if !unsafe { sample.fill(slots, place, lending) } {
                    writing.give_back(place);
                    return Pushed::DroppedNewest;
                }
                let dropped = fifo.push(writing, place, |oldest| empty(slots, lending, oldest));
                if dropped || given_up > 0 { Pushed::DroppedOldest } else { Pushed::Queued }
            }
            _ => unreachable!("both are made together in `stream_link`"),
        }
    }
}

impl StreamWriter {
    /// Takes back frames the reader in another process has done with; each push does so too. Any thread;
    /// never waits, and no push is in its way.
    pub fn collect(&self) {
        if let Some(leases) = &self.leases {
            leases.collect();
        }
    }
}

impl Drop for StreamWriter {
    fn drop(&mut self) {
        self.link.writer_left.store(1, Ordering::Release);
        // No other thread can be inside: `&mut self`.
        let Some(mut end) = self.end.try_enter() else { return };
        let End { owned, lending } = &mut *end;
        let Some(mut lending) = lending.take() else { return };
        // Unseen frames come back now: a reader that left while they were put there would never give them
        // back.
        let taken_back = match (&self.link.order, owned) {
            (Order::Latest(latest), Owned::Latest { back }) => {
                let (got, unseen) = latest.take_back(*back);
                *back = got;
                lending.came_back(got, unseen);
                u64::from(unseen)
            }
            (Order::Fifo(fifo), Owned::Fifo(writing)) => {
                fifo.make_room(writing, |_| true, |oldest| lending.came_back(oldest, true))
            }
            _ => unreachable!("both are made together in `stream_link`"),
        };
        tally(&self.link.counters.writer.0.dropped, taken_back);
        lending.leave();
    }
}

/// A sample to be pushed.
trait Offered {
    /// Has the queue give up what this sample needs; returns how many samples those were, or `None` where it
    /// may not be queued.
    fn make_room(&self, fifo: &Fifo, writing: &mut Writing, emptied: impl FnMut(usize)) -> Option<u64>;

    /// Fills the place; returns false where the sample cannot be lent to the process at the other end.
    ///
    /// # Safety
    /// The writer owns the place and has no other reference to it; the sample is one of this link.
    unsafe fn fill(self, slots: &Slots, place: usize, lending: &mut Option<Lending>) -> bool;
}

/// Empties a place the writer has taken over and that was not read.
fn empty(slots: &Slots, lending: &mut Option<Lending>, place: usize) {
    // SAFETY: the place was just taken over by the writer.
    unsafe { slots.empty(place) };
    if let Some(lending) = lending {
        lending.came_back(place, true);
    }
}

struct Plain<'a> {
    data: &'a [u8],
    meta: Meta,
}

impl Offered for Plain<'_> {
    #[inline]
    fn make_room(&self, _: &Fifo, _: &mut Writing, _: impl FnMut(usize)) -> Option<u64> {
        Some(0)
    }

    #[inline]
    unsafe fn fill(self, slots: &Slots, place: usize, _: &mut Option<Lending>) -> bool {
        // SAFETY: the caller's promise is the one asked for.
        unsafe { slots.write(place, self.meta, self.data) };
        true
    }
}

struct Parts<'a> {
    head: &'a [u8],
    body: &'a [u8],
    /// With the zeros behind both.
    bytes: usize,
    meta: Meta,
}

impl Offered for Parts<'_> {
    #[inline]
    fn make_room(&self, _: &Fifo, _: &mut Writing, _: impl FnMut(usize)) -> Option<u64> {
        Some(0)
    }

    #[inline]
    unsafe fn fill(self, slots: &Slots, place: usize, _: &mut Option<Lending>) -> bool {
        // SAFETY: the caller's promise is the one asked for.
        unsafe { slots.write_parts(place, self.meta, self.head, self.body, self.bytes) };
        true
    }
}

struct Lent {
    frame: Frame,
    meta: Meta,
}

impl Offered for Lent {
    fn make_room(&self, fifo: &Fifo, writing: &mut Writing, emptied: impl FnMut(usize)) -> Option<u64> {
        match fifo.drop {
            DropPolicy::DropOldest => {
                let too_many = |queued: u64| !self.frame.pool_has_free(queued.div_ceil(2));
                Some(fifo.make_room(writing, too_many, emptied))
            }
            DropPolicy::DropNewest => {
                let queued = fifo.queued(writing);
                (queued == 0 || self.frame.pool_has_free(queued.saturating_add(1))).then_some(0)
            }
        }
    }

    unsafe fn fill(self, slots: &Slots, place: usize, lending: &mut Option<Lending>) -> bool {
        let (frame, located) = match lending {
            None => (Some(self.frame), Located::default()),
            Some(lending) => {
                let Some(located) = lending.lend(self.frame) else { return false };
                lending.put(place, located.lease);
                (None, located)
            }
        };
        // SAFETY: the caller's promise is the one asked for.
        unsafe { slots.put(place, self.meta, frame, located) };
        true
    }
}
