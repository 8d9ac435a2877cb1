//! The list of watched components: those of one LCM with their threads.
//!
//! Invariant: the lock guards the list only; every look works on a copy.

use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::super::executor::Executor;
use super::super::instance::Instance;

/// One component and its thread.
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
    /// Adds a component, or moves it to another thread.
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

    /// Tells whether every component on the list now is one of `known`. Components removed since may still be
    /// among those.
    pub(super) fn has_only(&self, known: &[&Ward]) -> bool {
        let known: HashSet<u32> = known.iter().map(|k| k.instance.number).collect();
        let wards = self.wards.lock().unwrap_or_else(PoisonError::into_inner);
        wards.iter().all(|w| known.contains(&w.instance.number))
    }

    pub(super) fn all(&self) -> Vec<Ward> {
        self.wards.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The list, if its edition differs from `seen`, which is brought up to date.
    pub(super) fn news(&self, seen: &mut u64) -> Option<Vec<Ward>> {
        let edition = self.edition.load(Ordering::Acquire);
        if edition == *seen {
            return None;
        }
        *seen = edition;
        Some(self.all())
    }
}
