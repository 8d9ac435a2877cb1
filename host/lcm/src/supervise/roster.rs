//! Who is to be watched: the components of one LCM with their threads.
//!
//! Invariant: the lock guards the list only; whoever looks works on a copy.

use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::super::executor::Executor;
use super::super::instance::Instance;

/// One component and the thread it runs on.
#[derive(Clone)]
pub(crate) struct Ward {
    pub(crate) instance: Arc<Instance>,
    pub(crate) executor: Arc<Executor>,
}

impl Ward {
    pub(crate) fn new(instance: Arc<Instance>, executor: Arc<Executor>) -> Ward {
        Ward { instance, executor }
    }
}

#[derive(Default)]
pub(crate) struct Roster {
    wards: Mutex<Vec<Ward>>,
    edition: AtomicU64,
}

impl Roster {
    /// Adds a component, or puts it on another thread.
    pub(crate) fn add(&self, ward: Ward) {
        let mut wards = self.wards.lock().unwrap_or_else(PoisonError::into_inner);
        wards.retain(|w| w.instance.number != ward.instance.number);
        wards.push(ward);
        self.edition.fetch_add(1, Ordering::Release);
    }

    pub(crate) fn remove(&self, number: u32) {
        self.wards.lock().unwrap_or_else(PoisonError::into_inner).retain(|w| w.instance.number != number);
        self.edition.fetch_add(1, Ordering::Release);
    }

    /// Every component that is on the list now is one of those. Who has gone since may still be among them.
    pub(super) fn has_only(&self, known: &[&Ward]) -> bool {
        let known: HashSet<u32> = known.iter().map(|k| k.instance.number).collect();
        let wards = self.wards.lock().unwrap_or_else(PoisonError::into_inner);
        wards.iter().all(|w| known.contains(&w.instance.number))
    }

    pub(super) fn all(&self) -> Vec<Ward> {
        self.wards.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The list, when it is another edition than `seen`, which is brought up to date.
    pub(super) fn news(&self, seen: &mut u64) -> Option<Vec<Ward>> {
        let edition = self.edition.load(Ordering::Acquire);
        if edition == *seen {
            return None;
        }
        *seen = edition;
        Some(self.all())
    }
}
