//! Loom models: every interleaving of two or three threads over the lock-free cores, within loom's bounds.
//!
//! Run with `RUSTFLAGS="--cfg loom" cargo test -p trocar-rt --release --lib loom_`. A model that needs
//! private parts of a module lies in that module. Invariant: each of them fails when one of the orders it is
//! about is weakened.
#![allow(clippy::unwrap_used)]

mod calls;
mod mailbox;
mod pool;
mod remote;
mod stream;
mod team;
mod turn;

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Runs the model, and fails when loom found nothing to interleave: such a model shows nothing. (loom
/// compares an access with the last one of the same atomic only, so a thread's own load can hide a conflict
/// from it.)
fn model(f: impl Fn() + Sync + Send + 'static) {
    model_within(3, f);
}

/// As [`model`], with at most this many switches away from a thread that could go on.
pub(crate) fn model_within(preemptions: usize, f: impl Fn() + Sync + Send + 'static) {
    let runs = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&runs);
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(preemptions);
    builder.check(move || {
        counted.fetch_add(1, Ordering::Relaxed);
        f();
    });
    assert!(runs.load(Ordering::Relaxed) > 1, "loom tried one interleaving only");
}

/// A value whose accesses loom checks: each must be ordered after those that conflict with it.
pub(crate) struct Plain(loom::cell::UnsafeCell<u64>);

// SAFETY: loom checks the order of all accesses, which is what the models are about.
unsafe impl Sync for Plain {}

impl Plain {
    pub(crate) fn new() -> Self {
        Self(loom::cell::UnsafeCell::new(0))
    }

    pub(crate) fn get(&self) -> u64 {
        // SAFETY: as for the `Sync` above.
        self.0.with(|value| unsafe { *value })
    }

    pub(crate) fn set(&self, n: u64) {
        // SAFETY: as for the `Sync` above.
        self.0.with_mut(|value| unsafe { *value = n });
    }
}
