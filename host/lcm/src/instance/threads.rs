//! The threads of a component: what the machine gave its own one, and those its code may have started.
//!
//! Invariant: a thread from before its code first ran is never counted as its own.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use parking_lot::{Mutex, MutexGuard};

use super::super::realtime::Settings;
use super::super::supervise::Moment;

/// Threads of one component.
#[derive(Default)]
pub(crate) struct Threads {
    /// Settings of its thread that the machine granted or refused; set once.
    settings: OnceLock<Arc<Settings>>,
    /// Threads its own code may have started: their names, and whether they may live until `destroy`.
    children: Mutex<BTreeMap<i32, (String, bool)>>,
    /// The moment before its code first ran.
    made: OnceLock<Moment>,
}

impl Threads {
    /// Sets the settings of its thread; once.
    pub(crate) fn set_settings(&self, settings: Arc<Settings>) {
        let _ = self.settings.set(settings);
    }

    /// What the machine refused its thread. Read each time: helping threads may still be settling.
    pub(crate) fn warnings(&self) -> Vec<String> {
        self.settings.get().map_or_else(Vec::new, |settings| settings.warnings())
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<i32, (String, bool)>> {
        self.children.lock()
    }

    /// Notes threads, with their names, that appeared during one of its entries; `lasts`: they may live until
    /// `destroy`.
    pub(crate) fn note(&self, threads: impl Iterator<Item = (i32, String)>, lasts: bool) {
        self.all().extend(threads.map(|(tid, name)| (tid, (name, lasts))));
    }

    pub(crate) fn noted(&self) -> BTreeMap<i32, String> {
        self.all().iter().map(|(tid, (name, _))| (*tid, name.clone())).collect()
    }

    /// Tells whether this is a thread of its own that may live until `destroy`.
    pub(crate) fn lasts(&self, tid: i32) -> bool {
        self.all().get(&tid).is_some_and(|(_, lasts)| *lasts)
    }

    /// Sets the moment before its code first ran: threads from before cannot be its own. Only the first call
    /// counts.
    pub(crate) fn set_made(&self, before: Moment) {
        self.made.get_or_init(|| before);
    }

    /// The moment before its code first ran.
    pub(crate) fn made(&self) -> Option<Moment> {
        self.made.get().copied()
    }
}
