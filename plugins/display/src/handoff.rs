//! Copies of frames for threads that show them: as many as they can take, and no more.
//!
//! Invariant: the step never waits and never allocates: it copies into a buffer that is free, or not at all. Nobody sleeps in
//! a channel's queue, so that using one is free of locks.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use trocar_sdk::data::StereoHeader;

/// Buffers that go round: one being shown, one on its way.
const BUFFERS: usize = 2;

/// A copy of a frame.
pub(crate) struct Snapshot {
    pub(crate) header: StereoHeader,
    bytes: Vec<u8>,
    len: usize,
}

impl Snapshot {
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

/// The step's end.
pub(crate) struct Giver {
    filled: SyncSender<Snapshot>,
    empty: Receiver<Vec<u8>>,
    lookers: Arc<AtomicU32>,
}

/// The thread's end.
pub(crate) struct Taker {
    filled: Receiver<Snapshot>,
    empty: SyncSender<Vec<u8>>,
}

/// Both ends, for frames of up to `max_bytes`; copies are made while `lookers` is not 0.
pub(crate) fn pair(max_bytes: usize, lookers: Arc<AtomicU32>) -> (Giver, Taker) {
    let (filled_in, filled) = sync_channel(BUFFERS);
    let (empty_in, empty) = sync_channel(BUFFERS);
    for _ in 0..BUFFERS {
        // There is room for all.
        let _ = empty_in.try_send(vec![0; max_bytes]);
    }
    (Giver { filled: filled_in, empty, lookers }, Taker { filled, empty: empty_in })
}

impl Giver {
    /// Copies a frame when somebody looks, its bytes fit and a buffer is free; tells whether it did.
    pub(crate) fn give(&mut self, header: &StereoHeader, from: &[u8]) -> bool {
        if self.lookers.load(Ordering::Relaxed) == 0 {
            return false;
        }
        let Ok(mut bytes) = self.empty.try_recv() else { return false };
        let fits = from.len() <= bytes.len();
        let len = if fits { from.len() } else { 0 };
        bytes[..len].copy_from_slice(&from[..len]);
        // One that does not fit goes round empty: its reader leaves it out.
        self.filled.try_send(Snapshot { header: *header, bytes, len }).is_ok() && fits
    }
}

impl Taker {
    /// The oldest copy that is there.
    pub(crate) fn take(&mut self) -> Option<Snapshot> {
        self.filled.try_recv().ok()
    }

    pub(crate) fn give_back(&mut self, copy: Snapshot) {
        let _ = self.empty.try_send(copy.bytes);
    }
}
