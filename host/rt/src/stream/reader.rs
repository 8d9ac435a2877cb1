//! The input's end of a link.
//!
//! The reader owns the place of the sample it looks at, so the sample stays as it is until the reader goes
//! on, whatever the writer does.

use std::sync::Arc;

use super::remote::{Admitted, Arriving};
use super::slots::Slots;
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
    /// Place the reader of a latest link has to exchange; `place` too, unless that sample never left its
    /// thread.
    own: usize,
    /// Whether there is a sample in it.
    holds: bool,
    /// The frame in it lies in memory that is not mapped yet.
    awaits: bool,
    reading: fifo::Reading,
    /// With a writer in another process.
    arriving: Option<Arriving>,
    /// Meta of the sample of another process, which cannot change it any more.
    came: Meta,
    /// Samples of another process that could not be what they were said to be.
    corrupt: u64,
}

impl StreamReader {
    pub(super) fn new(link: Arc<Link>, arriving: Option<Arriving>) -> Self {
        let place = matches!(link.order, Order::Latest(_)).then_some(latest::READERS);
        let reading = fifo::Reading::default();
        let came = Meta::default();
        Self {
            link,
            place,
            own: latest::READERS,
            holds: false,
            awaits: false,
            reading,
            arriving,
            came,
            corrupt: 0,
        }
    }

    /// Samples of another process that were thrown away, since they could not be what they were said to be.
    pub fn corrupt(&self) -> u64 {
        self.corrupt
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

    /// Gives back all that is here, the sample last seen as well, and takes nothing more: as dropping it
    /// does, for an end that may be dropped only later. Another call gives back what the writer put there
    /// meanwhile.
    pub fn close(&mut self) {
        let again = self.link.reader_left.swap(1, Ordering::AcqRel) != 0;
        // Frames still here go back to their pool now, not when the writer happens to go. Bounded: once the
        // writer sees that the reader left, it queues nothing more; and no other process keeps this going.
        self.release();
        let skipped = &self.link.counters.reader.0.skipped;
        if let Some(place) = self.place.filter(|_| std::mem::take(&mut self.awaits)) {
            skip(&self.arriving, &self.link.slots, place);
            tally(skipped, 1);
        }
        if !again && self.link.here.has_unseen() {
            tally(skipped, 1);
        }
        for _ in 0..=self.link.places() {
            let unseen = match &self.link.order {
                Order::Latest(latest) => latest.has_unseen().then(|| {
                    self.own = latest.exchange(self.own);
                    self.own
                }),
                Order::Fifo(fifo) => fifo.pop(fifo.end()),
            };
            let Some(place) = unseen else { break };
            skip(&self.arriving, &self.link.slots, place);
            // SAFETY: the place was just taken over by the reader.
            unsafe { self.link.slots.empty(place) };
            tally(skipped, 1);
        }
    }

    /// The frame last seen, to be kept or passed on by cloning.
    pub fn frame(&self) -> Option<&Frame> {
        let place = self.place.filter(|_| self.holds)?;
        // SAFETY: the reader owns the place; a shared borrow of the reader keeps it from changing.
        unsafe { self.link.slots.frame(place) }
    }

    /// Takes the frame last seen out of the reader, to be changed in place where nobody else reads it.
    pub fn take_frame(&mut self) -> Option<Frame> {
        let place = self.place.filter(|_| self.holds)?;
        // SAFETY: the reader owns the place, and `&mut self` makes this the only reference.
        let frame = unsafe { self.link.slots.frame_mut(place) }.and_then(Option::take);
        // Without its frame the place holds no sample any more; a plain one stays.
        self.holds = frame.is_none();
        frame
    }

    /// Tells whether the writing end still exists. Without it nothing new will come.
    pub fn has_writer(&self) -> bool {
        self.link.writer_left.load(Ordering::Acquire) == 0
    }

    pub fn stats(&self) -> StreamStats {
        self.counters().stats()
    }

    /// Returns the link's counters, to be shown.
    pub fn counters(&self) -> StreamCounters {
        StreamCounters(Arc::clone(&self.link.counters))
    }

    /// Moves on to the next sample or to the newest one; returns whether there was one.
    #[inline(always)]
    fn advance(&mut self, newest: bool) -> bool {
        let here = &self.link.here;
        match &self.link.order {
            // Short cut within a cycle, where one more call is an eighth of a hop.
            Order::Latest(latest) if self.arriving.is_none() && !latest.has_unseen() => {
                if !here.has_unseen() {
                    return false;
                }
                // SAFETY: `&mut self` is the right to read.
                self.place = Some(unsafe { here.take() });
                self.holds = true;
                tally(&self.link.counters.reader.0.taken, 1);
                true
            }
            _ => self.advance_any(newest),
        }
    }

    /// The same, for a sample from any thread or process.
    #[inline(never)]
    fn advance_any(&mut self, newest: bool) -> bool {
        // A waiting sample stays the next one of a queue; in a latest link a newer one takes its place.
        let newer = || matches!(&self.link.order, Order::Latest(latest) if latest.has_unseen());
        if self.awaits && !newer() {
            return self.arrive();
        }
        let slots = &self.link.slots;
        let counters = &self.link.counters.reader.0;
        match &self.link.order {
            Order::Latest(latest) => {
                let (came, here) = (latest.has_unseen(), &self.link.here);
                if came {
                    if std::mem::take(&mut self.awaits) {
                        skip(&self.arriving, slots, self.own);
                        tally(&counters.skipped, 1);
                    }
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
            Order::Fifo(_) => match self.take_in_order(newest) {
                None => return false,
                taken => self.place = taken,
            },
        }
        if self.arriving.is_some() {
            return self.arrive();
        }
        self.holds = true;
        tally(&self.link.counters.reader.0.taken, 1);
        true
    }

    /// Takes over the next sample of a queue, or the newest one in it, and gives the place seen before back.
    #[inline(always)]
    fn take_in_order(&mut self, newest: bool) -> Option<usize> {
        let Order::Fifo(fifo) = &self.link.order else { return None };
        let slots = &self.link.slots;
        let end = fifo.end();
        let mut place = fifo.pop(end)?;
        let reading = &mut self.reading;
        let mut give_back = |place| {
            // SAFETY: the reader owns the place, and `&mut self` ends every look at it.
            unsafe { slots.empty(place) };
            fifo.give_back(reading, place);
        };
        // The place seen before goes back first: the writer counts on it (see `Fifo::free_place`).
        self.place.take().into_iter().for_each(&mut give_back);
        // Bounded by the number of places, whatever another process says of the queue's end.
        for _ in 0..if newest { fifo.slots() } else { 0 } {
            let Some(newer) = fifo.pop(end) else { break };
            skip(&self.arriving, slots, place);
            give_back(place);
            tally(&self.link.counters.reader.0.skipped, 1);
            place = newer;
        }
        Some(place)
    }

    /// Takes in the data another process has written into the place taken over; returns whether there is a
    /// sample now.
    fn arrive(&mut self) -> bool {
        let (Some(place), Some(arriving)) = (self.place, &mut self.arriving) else { return false };
        let slots = &self.link.slots;
        (self.awaits, self.holds) = (false, false);
        match arriving {
            Arriving::Plain(copy) => {
                // SAFETY: the reader owns the place.
                let (meta, data, _) = unsafe { slots.read(place) };
                self.came = meta;
                self.holds = copy.take(data);
            }
            Arriving::Frames(pool, views) => {
                // SAFETY: as above.
                let content = unsafe { slots.look(place) };
                self.came = content.meta;
                // SAFETY: as above, and `&mut self` makes this the only reference.
                let mine = unsafe { slots.frame_mut(place) };
                match (Arriving::admit(pool, views, &content), mine) {
                    (Admitted::Frame(frame), Some(mine)) => {
                        *mine = Some(frame);
                        self.holds = true;
                    }
                    (Admitted::Later, _) => {
                        self.awaits = true;
                        return false;
                    }
                    _ => {}
                }
            }
        }
        let counters = &self.link.counters.reader.0;
        if self.holds {
            tally(&counters.taken, 1);
        } else {
            self.corrupt += 1;
            tally(&counters.skipped, 1);
        }
        self.holds
    }

    #[inline(always)]
    fn sample(&self, fresh: bool) -> Option<Sample<'_>> {
        let place = self.place.filter(|_| self.holds)?;
        if let Some(arriving) = &self.arriving {
            return Some(self.arrived(arriving, place, fresh));
        }
        // SAFETY: the reader owns the place and keeps it while it is borrowed.
        let (meta, data, bytes) = unsafe { self.link.slots.read(place) };
        Some(Sample { meta, fresh, data, bytes })
    }

    #[inline(never)]
    fn arrived<'a>(&'a self, arriving: &'a Arriving, place: usize, fresh: bool) -> Sample<'a> {
        let (data, bytes) = match arriving {
            Arriving::Plain(copy) => (copy.data(), &[][..]),
            Arriving::Frames(..) => {
                // SAFETY: as in `sample`.
                let (_, data, bytes) = unsafe { self.link.slots.read(place) };
                (data, bytes)
            }
        };
        Sample { meta: self.came, fresh, data, bytes }
    }
}

/// Gives a sample that will not be seen back to its source.
fn skip(arriving: &Option<Arriving>, slots: &Slots, place: usize) {
    if let Some(Arriving::Frames(pool, _)) = arriving {
        // SAFETY: the reader owns the place.
        pool.decline(unsafe { slots.look(place) }.frame.lease);
    }
}

impl Drop for StreamReader {
    fn drop(&mut self) {
        self.close();
    }
}
