//! The list of watched components: those of one LCM with their threads.
//!
//! Invariant: the lock guards the list only; every look works on a copy.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;

use super::super::executor::Executor;
use super::super::instance::Instance;

/// One component and its thread.
#[derive(Clone)]
pub(crate) struct Guarded {
    pub(crate) instance: Arc<Instance>,
    pub(crate) executor: Arc<Executor>,
}

impl Guarded {
    pub(crate) fn new(instance: Arc<Instance>, executor: Arc<Executor>) -> Guarded {
        Guarded { instance, executor }
    }
}

#[derive(Default)]
pub(crate) struct Roster {
    all_guarded: Mutex<Vec<Guarded>>,
    edition: AtomicU64,
}

impl Roster {
    /// Adds a component, or moves it to another thread.
    pub(crate) fn add(&self, guarded: Guarded) {
        let mut all_guarded = self.all_guarded.lock();
        all_guarded.retain(|g| g.instance.number != guarded.instance.number);
        all_guarded.push(guarded);
        self.edition.fetch_add(1, Ordering::Release);
    }

    pub(crate) fn remove(&self, number: u32) {
        self.all_guarded.lock().retain(|g| g.instance.number != number);
        self.edition.fetch_add(1, Ordering::Release);
    }

    /// Tells whether every component on the list now is one of `known`. Components removed since may still be
    /// among those.
    pub(super) fn has_only(&self, known: &[&Guarded]) -> bool {
        let known: HashSet<u32> = known.iter().map(|k| k.instance.number).collect();
        let all_guarded = self.all_guarded.lock();
        all_guarded.iter().all(|g| known.contains(&g.instance.number))
    }

    pub(super) fn all(&self) -> Vec<Guarded> {
        self.all_guarded.lock().clone()
    }

    /// The list, if its edition differs from `seen`, which is brought up to date.
    pub(super) fn news(&self, seen: &mut u64) -> Option<Vec<Guarded>> {
        let edition = self.edition.load(Ordering::Acquire);
        if edition == *seen {
            return None;
        }
        *seen = edition;
        Some(self.all())
    }
}
