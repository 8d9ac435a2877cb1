//! The producer's end of one connection, and the way its reader is told of a sample.
//!
//! Invariant: an output never waits for a reader; no step waits for a reader that only looks on.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use trocar_rt::pool::Frame;
use trocar_rt::segment::Word;
use trocar_rt::stream::{Meta, StreamWriter};
use trocar_rt::wake::Waker;

use super::super::super::core::Core;
use super::super::super::{context, pending};
use super::super::deferred::{self, DeferredLink};
use super::super::inside::runs_kept;
use super::super::told;

/// Connection number of readers from outside.
pub(crate) const OUTSIDE: u64 = 0;

/// The producer's end of one connection.
pub(crate) struct OutLink {
    /// The connection, or [`OUTSIDE`].
    pub(crate) connection: u64,
    writer: StreamWriter,
    consumer: Consumer,
    /// True for a reader that only observes: it is given samples when the writer's turn ends.
    observes: bool,
}

/// The reader of a link, and the way it is told that there is something to read.
pub(crate) enum Consumer {
    /// A component of this process; and the place for the stamp of the newest sample, for connections with a
    /// `max_age`.
    Here(Arc<Core>, Option<Arc<AtomicU64>>),
    /// A component of another process; likewise, and the place for the number of the first sample it is
    /// offered.
    Remote { bell: Arc<Waker>, newest_ns: Option<Word>, first: Arc<AtomicU64> },
    /// A reader outside, which polls.
    Outside,
}

impl OutLink {
    /// `observes`: its reader only looks on, see [`trocar_model::Ports::looks_on`].
    pub(crate) fn new(connection: u64, writer: StreamWriter, consumer: Consumer, observes: bool) -> Self {
        OutLink { connection, writer, consumer, observes }
    }
}

impl OutLink {
    /// Tells whether only this very thread can take the written sample: it holds the consumer's entry lock
    /// for its cycle.
    #[inline]
    pub(super) fn is_read_here(&self) -> bool {
        matches!(&self.consumer, Consumer::Here(consumer, _) if consumer.object.is_kept_here())
    }

    /// Tells whether the reader observes from another thread.
    #[inline]
    fn is_watched(&self) -> bool {
        self.observes && !self.is_read_here()
    }

    #[inline]
    pub(super) fn push(&self, value: &[u8], meta: Meta) {
        if self.is_watched() {
            // SAFETY: this link stands behind the output, which was looked at in this turn, if there is one.
            if runs_kept() && unsafe { deferred::sample(self, value, meta) } {
                return;
            }
            pending::publish();
        }
        self.push_now(value, meta);
    }

    #[inline]
    pub(super) fn push_frame(&self, mut frame: Frame, meta: Meta) {
        if self.is_watched() {
            if runs_kept() {
                // SAFETY: as in `push`.
                match unsafe { deferred::frame(self, frame, meta) } {
                    None => return,
                    Some(given_back) => frame = given_back,
                }
            }
            pending::publish();
        }
        self.push_frame_now(frame, meta);
    }

    /// Pushes a sample of a tap, zeros behind it.
    #[inline]
    pub(super) fn push_parts(&self, head: &[u8], body: &[u8], bytes: usize, meta: Meta) {
        self.begin(meta.seq);
        self.writer.push_parts(head, body, bytes, meta);
        self.signal(meta.came_ns);
    }

    /// Takes back frames that a reader in another process has released.
    pub(super) fn collect(&self) {
        if let Consumer::Remote { .. } = self.consumer {
            self.writer.collect();
        }
    }

    /// True for a reader that only looks on.
    #[inline]
    pub(super) fn observes(&self) -> bool {
        self.observes
    }

    /// Notes the number of the first sample for another process, before that sample is counted.
    #[inline(always)]
    fn begin(&self, seq: u64) {
        if let Consumer::Remote { first, .. } = &self.consumer
            && first.load(Ordering::Relaxed) == 0
        {
            first.store(seq, Ordering::Relaxed);
            // Pairs with the fence of `ServerWires::offered`: a reader that finds the sample counted finds
            // its number.
            fence(Ordering::Release);
        }
    }

    #[inline(always)]
    fn signal(&self, came_ns: u64) {
        match &self.consumer {
            Consumer::Here(consumer, None) => Self::tell_of_sample(consumer),
            _ => self.signal_with_age(came_ns),
        }
    }

    /// Signals the consumer of this link.
    #[inline(always)]
    fn tell_of_sample(consumer: &Core) {
        if !consumer.looks_for_samples() {
            // SAFETY: as in `push`.
            unsafe { told::signal(consumer) };
        }
    }

    // Kept apart, so that the common way stays small.
    #[inline(never)]
    fn signal_with_age(&self, came_ns: u64) {
        match &self.consumer {
            Consumer::Here(consumer, newest_ns) => {
                if let Some(newest_ns) = newest_ns {
                    newest_ns.store(came_ns, Ordering::Relaxed);
                }
                Self::tell_of_sample(consumer);
            }
            Consumer::Remote { bell, newest_ns, .. } => {
                if let Some(newest_ns) = newest_ns {
                    newest_ns.set(came_ns);
                }
                context::wake(bell);
            }
            Consumer::Outside => {}
        }
    }
}

impl DeferredLink for OutLink {
    /// Pushes the frame now, to any kind of reader.
    #[inline]
    fn push_frame_now(&self, frame: Frame, meta: Meta) {
        self.begin(meta.seq);
        self.writer.push_frame(frame, meta);
        self.signal(meta.came_ns);
    }

    #[inline]
    fn push_now(&self, value: &[u8], meta: Meta) {
        if self.is_read_here() {
            // SAFETY: only the thread inside the component uses its reader, and this thread has the lock for
            // that until its cycle ends: no other thread is inside meanwhile, and the next holder of the lock
            // comes after.
            unsafe { self.writer.push_here(value, meta) };
        } else {
            self.begin(meta.seq);
            self.writer.push(value, meta);
        }
        self.signal(meta.came_ns);
    }
}
