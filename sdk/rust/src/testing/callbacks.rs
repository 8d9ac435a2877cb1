//! Callbacks of a device library, and the rule for their entry.
//!
//! Invariant: as with a host, a callback enters only a started component, and never while an entry or another
//! callback is inside.

use super::bench::Bench;
use super::peers::code;
use crate::class::Class;
use crate::outcome::Outcome;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use trocar_plugin_api::abi;

/// The fake host's state of callbacks.
pub(crate) struct Callbacks {
    /// Answered instead of entering; EXECUTED lets them in.
    refuse: AtomicI32,
    /// An entry or a callback is inside.
    inside: AtomicBool,
    entered: AtomicU64,
    refused: AtomicU64,
}

impl Callbacks {
    pub(crate) fn new() -> Callbacks {
        Callbacks {
            refuse: AtomicI32::new(abi::EXECUTED),
            inside: AtomicBool::new(false),
            entered: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        }
    }

    pub(crate) fn enter(&self, active: bool) -> abi::Outcome {
        let outcome = match self.refuse.load(Ordering::Acquire) {
            abi::EXECUTED if !active => abi::NOT_ACTIVE,
            abi::EXECUTED if self.inside.swap(true, Ordering::AcqRel) => abi::WOULD_BLOCK,
            outcome => outcome,
        };
        let count = if outcome == abi::EXECUTED { &self.entered } else { &self.refused };
        count.fetch_add(1, Ordering::Relaxed);
        outcome
    }

    pub(crate) fn leave(&self) {
        self.inside.store(false, Ordering::Release);
    }

    /// Waits until no callback is inside, and keeps them out until the guard is dropped.
    pub(crate) fn keep_out(&self) -> KeptOut<'_> {
        while self.inside.swap(true, Ordering::AcqRel) {
            std::thread::yield_now();
        }
        KeptOut(self)
    }
}

/// An entry runs.
pub(crate) struct KeptOut<'a>(&'a Callbacks);

impl Drop for KeptOut<'_> {
    fn drop(&mut self) {
        self.0.leave();
    }
}

impl<C: Class> Bench<C> {
    /// Lets `Host::callback` be refused with `outcome`: NOT_ACTIVE as after a stop, WOULD_BLOCK as when two
    /// overlap. `Outcome::Executed` lets them in again.
    pub fn refuse_callbacks(&mut self, outcome: Outcome) {
        let outcome = if outcome.is_ok() { abi::EXECUTED } else { code(outcome) };
        self.host.callbacks.refuse.store(outcome, Ordering::Release);
    }

    /// Returns how many callbacks came in, and how many were refused, since the bench was made. Look at what
    /// they wrote after a `stop` has ended the component's own threads.
    pub fn callbacks(&self) -> (u64, u64) {
        let callbacks = &self.host.callbacks;
        (callbacks.entered.load(Ordering::Relaxed), callbacks.refused.load(Ordering::Relaxed))
    }
}
