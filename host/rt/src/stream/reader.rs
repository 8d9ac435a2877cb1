//! The input's end of a link.
//!
//! The reader owns the place of the sample it looks at, so the sample stays as it is until the reader goes on,
//! whatever the writer does.

use std::sync::Arc;

use super::{Link, Meta, Order, StreamCounters, StreamStats, fifo, latest, tally};
use crate::pool::Frame;
use crate::sync::Ordering;

/// A sample at the reader.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    pub meta: Meta,
    /// Whether it is seen for the first time.
    pub fresh: bool,
    /// The plain bytes, or the frame's header; 64-byte aligned.
    pub data: &'a [u8],
    /// The frame's bytes; empty for plain samples.
    pub bytes: &'a [u8],
}

/// The reading end: one thread at a time.
pub struct StreamReader {
    link: Arc<Link>,
    /// The place of the sample last seen.
    place: Option<usize>,
    /// The place the reader of a latest link has to exchange; `place` too, unless that sample never left its thread.
    own: usize,
    /// Whether there is a sample in it.
    holds: bool,
    reading: fifo::Reading,
}

impl StreamReader {
    pub(super) fn new(link: Arc<Link>) -> Self {
        let place = matches!(link.order, Order::Latest(_)).then_some(latest::READERS);
        Self { link, place, own: latest::READERS, holds: false, reading: fifo::Reading::default() }
    }

    /// The newest sample, fresh or as seen before; older unseen ones are skipped and counted. `None` before
    /// the first one and after [`StreamReader::release`]. Never waits; compare [`StreamReader::next`].
    #[inline]
    pub fn latest(&mut self) -> Option<Sample<'_>> {
        let fresh = self.advance(true);
        self.sample(fresh)
    }

    /// The next unseen sample in order, `None` when there is none. Of a latest link that is the newest.
    #[expect(
        clippy::should_implement_trait,
        reason = "the sample borrows the reader: no iterator can do that"
    )]
    #[inline]
    pub fn next(&mut self) -> Option<Sample<'_>> {
        if self.advance(false) { self.sample(true) } else { None }
    }

    /// The sample last seen, again.
    pub fn current(&self) -> Option<Sample<'_>> {
        self.sample(false)
    }

    /// Lets go of the sample, and of its frame, before the next one comes.
    pub fn release(&mut self) {
        self.take_frame();
        self.holds = false;
    }

    /// The frame last seen, to be kept or passed on by cloning.
    pub fn frame(&self) -> Option<&Frame> {
        let place = self.place.filter(|_| self.holds)?;
        // SAFETY: the reader owns the place; a shared borrow of the reader keeps it from changing.
        unsafe { self.link.slots.look(place) }.frame.as_ref()
    }

    /// Takes the frame last seen out of the reader, to be changed in place where nobody else reads it.
    pub fn take_frame(&mut self) -> Option<Frame> {
        let place = self.place.filter(|_| self.holds)?;
        // SAFETY: the reader owns the place, and `&mut self` makes this the only reference.
        let frame = unsafe { self.link.slots.content(place) }.frame.take();
        // Without its frame the place holds no sample any more; a plain one stays.
        self.holds = frame.is_none();
        frame
    }

    /// Whether the writing end still exists. Without it nothing new will come.
    pub fn has_writer(&self) -> bool {
        !self.link.writer_left.load(Ordering::Acquire)
    }

    pub fn stats(&self) -> StreamStats {
        self.counters().stats()
    }

    /// The link's counters, for whoever shows them.
    pub fn counters(&self) -> StreamCounters {
        StreamCounters(Arc::clone(&self.link.counters))
    }

    /// Moves on to the next sample or to the newest one; whether there was one.
    #[inline]
    fn advance(&mut self, newest: bool) -> bool {
        let slots = &self.link.slots;
        let counters = &self.link.counters.reader.0;
        match &self.link.order {
            Order::Latest(latest) => {
                let (came, here) = (latest.has_unseen(), &self.link.here);
                if came {
                    // SAFETY: the reader owns the place, and `&mut self` ends every look at it.
                    unsafe { slots.empty(self.own) };
                    self.own = latest.exchange(self.own);
                }
                self.place = Some(match (came, here.has_unseen()) {
                    (false, false) => return false,
                    (true, false) => self.own,
                    // SAFETY: `&mut self` is the right to read.
                    (false, true) => unsafe { here.take() },
                    (true, true) => {
                        tally(&counters.skipped, 1);
                        // SAFETY: as above.
                        let stayed = unsafe { here.take() };
                        // SAFETY: the reader owns both places.
                        let of = |place| unsafe { slots.look(place) }.meta.seq;
                        if of(self.own) > of(stayed) { self.own } else { stayed }
                    }
                });
            }
            Order::Fifo(fifo) => {
                let end = fifo.end();
                let Some(mut place) = fifo.pop(end) else { return false };
                let reading = &mut self.reading;
                let mut give_back = |place| {
                    // SAFETY: the reader owns the place, and `&mut self` ends every look at it.
                    unsafe { slots.empty(place) };
                    fifo.give_back(reading, place);
                };
                // The place seen before goes back first: the writer counts on it (see `Fifo::free_place`).
                self.place.take().into_iter().for_each(&mut give_back);
                while newest && let Some(newer) = fifo.pop(end) {
                    give_back(place);
                    tally(&counters.skipped, 1);
                    place = newer;
                }
                self.place = Some(place);
            }
        }
        self.holds = true;
        tally(&counters.taken, 1);
        true
    }

    #[inline]
    fn sample(&self, fresh: bool) -> Option<Sample<'_>> {
        let place = self.place.filter(|_| self.holds)?;
        // SAFETY: the reader owns the place and keeps it while it is borrowed.
        let (meta, data, bytes) = unsafe { self.link.slots.read(place) };
        Some(Sample { meta, fresh, data, bytes })
    }
}

impl Drop for StreamReader {
    fn drop(&mut self) {
        self.link.reader_left.store(true, Ordering::Release);
        // Frames still here go back to their pool now, not when the writer happens to go. Bounded: once the
        // writer sees that the reader left, it queues nothing more.
        self.release();
        let skipped = &self.link.counters.reader.0.skipped;
        if self.link.here.has_unseen() {
            tally(skipped, 1);
        }
        loop {
            let unseen = match &self.link.order {
                Order::Latest(latest) => latest.has_unseen().then(|| {
                    self.own = latest.exchange(self.own);
                    self.own
                }),
                Order::Fifo(fifo) => fifo.pop(fifo.end()),
            };
            let Some(place) = unseen else { break };
            // SAFETY: the place was just taken over by the reader.
            unsafe { self.link.slots.empty(place) };
            tally(skipped, 1);
        }
    }
}
