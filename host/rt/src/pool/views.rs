//! The pools of another process, as a reader of its frames finds them.
//!
//! Invariant: an entry is made once and never changed, so that a frame is found without a lock.

use std::sync::{Arc, OnceLock};

use super::file::PoolFile;

/// Pools of the other process that a reader can know in its life.
pub(crate) const MOST_VIEWS: usize = 16;

/// The pools of another process, as the reader finds frames in them. A manager makes the entries; none is
/// ever changed.
pub struct RemoteViews {
    header_bytes: usize,
    views: [OnceLock<Arc<PoolFile>>; MOST_VIEWS],
}

impl RemoteViews {
    /// For frames with headers of this length.
    pub fn new(header_bytes: usize) -> Arc<Self> {
        Arc::new(Self { header_bytes, views: Default::default() })
    }

    /// Adds the other end's pool of this place. Returns false for a place that is taken or does not exist,
    /// and for headers of another length.
    pub fn know(&self, place: usize, file: Arc<PoolFile>) -> bool {
        let fits = file.header_bytes() == self.header_bytes;
        fits && self.views.get(place).is_some_and(|view| view.set(file).is_ok())
    }

    /// Tells whether the other end has not told of a pool of this place yet.
    pub(crate) fn is_awaited(&self, place: u32) -> bool {
        self.views.get(place as usize).is_some_and(|view| view.get().is_none())
    }

    pub(crate) fn get(&self, place: u32) -> Option<&Arc<PoolFile>> {
        self.views.get(place as usize)?.get()
    }

    pub(crate) fn header_bytes(&self) -> usize {
        self.header_bytes
    }
}
