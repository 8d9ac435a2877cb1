//! Ways to tell a component that data or calls wait for it, and its watchdog that a peer came or went.
//!
//! Invariant: a mark that was set is seen by its thread before that rests; a thread that polls is not woken.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use trocar_model::Wake;
use trocar_rt::wake::Waker;

use super::super::context::{self, ExecutorId};
use super::super::loss::Loss;
use super::Core;

impl Core {
    pub(crate) fn executor_id(&self) -> ExecutorId {
        self.executor
    }

    /// Period of the grid it steps on, ns; 0 without one.
    pub(crate) fn period_ns(&self) -> u64 {
        self.terms.period_ns
    }

    /// Longest stay inside its own running code, ns.
    pub(crate) fn patience_ns(&self) -> u64 {
        self.terms.patience_ns
    }

    /// Wanted time between looks of the watchdog, ns: every period, or often enough within its patience.
    pub(crate) fn pace_ns(&self) -> u64 {
        if self.terms.period_ns > 0 { self.terms.period_ns } else { self.terms.patience_ns / 5 }
    }

    pub(crate) fn is_passive(&self) -> bool {
        self.terms.passive
    }

    /// Tells whether its steps are the calls of its device's own threads.
    pub(crate) fn is_called_back(&self) -> bool {
        self.terms.called_back
    }

    pub(crate) fn is_actuator(&self) -> bool {
        self.terms.actuator
    }

    pub(crate) fn bypasses(&self) -> bool {
        self.terms.bypass
    }

    /// Sentence about its frames after it has failed, if there are any.
    pub(crate) fn on_failure(&self) -> Option<&'static str> {
        match (self.bypasses(), self.terms.filter) {
            (true, _) => Some("frames pass it unchanged until Reset (on_failure bypass)"),
            (false, true) => Some("its branch stands still until Reset (on_failure stop_branch)"),
            (false, false) => None,
        }
    }

    /// Way it is told that data or calls wait for it; empty for a component that runs in the threads of
    /// others.
    pub(crate) fn wake_mode(&self) -> &'static str {
        match self.terms.polled {
            _ if self.terms.passive => "",
            true => Wake::Poll.name(),
            false => Wake::Signal.name(),
        }
    }

    /// True when the calling thread may run this component's commands directly.
    pub(crate) fn runs_here(&self) -> bool {
        let here = context::executor();
        self.is_passive() || (here != 0 && here == self.executor_id())
    }

    /// Tells whether samples need no signal: its steps come by themselves and take the waiting samples, and
    /// no sample makes it step or pass something on.
    pub(crate) fn looks_for_samples(&self) -> bool {
        self.terms.looks
    }

    /// True when signalling from here is one plain store, or the caller has to look at once: then nothing is
    /// deferred.
    pub(crate) fn signals_itself(&self) -> bool {
        self.is_passive() || context::executor() == self.executor_id()
    }

    /// Signals that data or calls wait for this component: marks it and wakes its thread, unless that is
    /// awake or polls.
    pub(crate) fn signal(&self) {
        if context::executor() == self.executor_id() {
            // The thread is awake already. A component in others' threads shares the mark with those threads.
            let shared = self.is_passive() || self.is_called_back();
            if shared {
                self.signalled.set();
            } else {
                self.signalled.set_here();
            }
            return;
        }
        // In one order with the gate: either this thread sees that it steps no more, or its thread, about to
        // rest, sees the mark.
        self.signalled.set();
        if self.is_passive() || (self.terms.polled && self.is_active()) {
            return;
        }
        self.wake();
    }

    /// The thread that will tell it at the end of its turn, or told it last; 0 = none.
    pub(crate) fn teller(&self) -> ExecutorId {
        self.teller.load(Ordering::Relaxed)
    }

    pub(crate) fn set_teller(&self, teller: ExecutorId) {
        self.teller.store(teller, Ordering::Relaxed);
    }

    /// Wakes the watchdog of its process.
    pub(crate) fn watchdog(&self) -> &Arc<Waker> {
        &self.watchdog
    }

    pub(crate) fn wake(&self) {
        if context::executor() == self.executor_id() {
            return;
        }
        context::wake(&self.waker);
    }

    pub(crate) fn has_signal(&self) -> bool {
        self.signalled.is_set()
    }

    /// True once after each signal.
    pub(crate) fn take_signal(&self) -> bool {
        self.signalled.take_if_set()
    }

    /// Leaves the mark for the thread inside; true when no thread is inside any more.
    pub(crate) fn leave_mark(&self) -> bool {
        self.signalled.leave(|| self.object.is_free())
    }

    /// Notes that a required port has a connection, again or for the first time.
    pub(crate) fn connected(&self, port: &str) {
        self.peers.connected(port);
        self.watchdog.notify();
    }

    /// Notes that a required port lost its connection.
    pub(crate) fn disconnected(&self, port: &str, how: Loss) {
        self.peers.disconnected(port, how);
        self.watchdog.notify();
    }

    /// Required ports that lost their connection, and the time from which each counts as lost, ns.
    pub(crate) fn missing(&self) -> Vec<(String, u64)> {
        self.peers.missing()
    }
}
