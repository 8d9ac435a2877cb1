//! How a component is run: on which terms, who wakes it, one step, one look at its queues, a callback of its device.
//!
//! Invariant: component code runs only here, in `drain` and in lifecycle jobs, each time for the holder of the entry lock and
//! each time noted in `watch`.

use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, Ordering};

use trocar_model::{Execution, ExecutionModel, OnFailure, Safety, Wake};
use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE, Outcome, Tick, WOULD_BLOCK};
use trocar_rt::os;
use trocar_rt::wake::Waker;

use super::super::boundary::HostContext;
use super::super::boundary::late;
use super::super::context::{self, ExecutorId};
use super::super::executor::{Executor, Pace};
use super::super::pending;
use super::super::supervise::{Entry, Misdeed, Suspicion};
use super::{Entered, Instance, Misuse};

/// Longest stay inside a component's code before it counts as unresponsive, ns; five periods when those are longer.
const PATIENCE_NS: u64 = 50_000_000;

/// On which terms a component runs.
pub(super) struct Terms {
    /// Of the grid it steps on, ns; 0 without one.
    period_ns: u64,
    patience_ns: u64,
    /// Runs in its callers' threads.
    passive: bool,
    /// Runs in threads of its device.
    called_back: bool,
    /// Its executor looks by itself, so nobody needs to wake it.
    polled: bool,
    /// It steps with its thread, which does so, and its steps alone take its samples.
    looks: bool,
    /// Frames pass it unchanged when its step has failed.
    bypass: bool,
    /// Steps on a stream of somebody else.
    filter: bool,
}

impl Terms {
    /// What `execution` means on a thread.
    pub(super) fn of(execution: &Execution, thread: &Executor) -> Terms {
        // A filter steps when something new is there, not on its thread's grid.
        let period_ns = match thread.pace {
            Pace::Grid { period_ns, .. } if execution.stream_of.is_none() => period_ns,
            _ => 0,
        };
        let passive = execution.model == Some(ExecutionModel::None);
        let called_back = execution.model == Some(ExecutionModel::OnCallback);
        let filter = execution.stream_of.is_some();
        let bypass = execution.on_failure == Some(OnFailure::Bypass);
        Terms {
            period_ns,
            patience_ns: match period_ns {
                0 => execution.max_step_ns.unwrap_or(PATIENCE_NS),
                period => PATIENCE_NS.max(5 * period),
            },
            passive,
            called_back,
            polled: thread.polls,
            looks: thread.polls && !passive && !called_back && !filter && !bypass,
            bypass,
            filter,
        }
    }

    pub(super) fn period_ns(&self) -> u64 {
        self.period_ns
    }
}

/// What a thread of a device was doing when it came in; a thread of this LCM, when a component's code is the device.
pub(super) struct Outer {
    component: AtomicPtr<HostContext>,
    stepping: bool,
    /// Of the component it came into.
    watched: u64,
}

impl Outer {
    /// Goes on with it, out of the component of `host`.
    fn resume(self, host: &Arc<HostContext>) {
        // Left in another order than entered: what came before may be gone.
        let mine = std::ptr::eq(context::swap_component(std::ptr::null()), Arc::as_ptr(host));
        let stepping = mine && self.stepping;
        if mine {
            context::swap_component(self.component.into_inner());
        }
        if !stepping {
            pending::publish();
        }
        context::set_stepping(stepping);
        if !stepping {
            context::flush_wakes();
        }
    }
}

/// What became of a step.
pub(crate) struct Stepped {
    /// When it ended, ns.
    pub(crate) end_ns: u64,
    /// Whether the component's own code ran: not where it left ACTIVE while its queues were.
    pub(crate) ran: bool,
}

impl Instance {
    /// Of the grid it steps on, ns; 0 without one.
    pub(crate) fn period_ns(&self) -> u64 {
        self.terms.period_ns()
    }

    /// Longest stay inside its own running code, ns.
    pub(crate) fn patience_ns(&self) -> u64 {
        self.terms.patience_ns
    }

    /// How often it wants to be looked at, ns: every period, or often enough within its patience.
    pub(crate) fn pace_ns(&self) -> u64 {
        if self.terms.period_ns > 0 { self.terms.period_ns } else { self.terms.patience_ns / 5 }
    }

    pub(crate) fn is_passive(&self) -> bool {
        self.terms.passive
    }

    /// Its steps are the calls of its device's own threads.
    pub(crate) fn is_called_back(&self) -> bool {
        self.terms.called_back
    }

    /// How it is told that something has come for it; empty for one that runs in the threads of others.
    pub(crate) fn wake_mode(&self) -> &'static str {
        match self.terms.polled {
            _ if self.terms.passive => "",
            true => Wake::Poll.name(),
            false => Wake::Signal.name(),
        }
    }

    pub(crate) fn bypasses(&self) -> bool {
        self.terms.bypass
    }

    /// What becomes of its frames when it has failed, if there are any.
    pub(super) fn on_failure(&self) -> Option<&'static str> {
        match (self.bypasses(), self.terms.filter) {
            (true, _) => Some("frames pass it unchanged until Reset (on_failure bypass)"),
            (false, true) => Some("its branch stands still until Reset (on_failure stop_branch)"),
            (false, false) => None,
        }
    }

    pub(crate) fn is_actuator(&self) -> bool {
        self.info.safety == Safety::Actuator
    }

    /// True when the calling thread may run this component's commands directly.
    pub(crate) fn runs_here(&self) -> bool {
        let here = context::executor();
        self.is_passive() || (here != 0 && here == self.executor_id())
    }

    /// Something is there for this component: marks it and wakes its thread, unless that is awake or looks by itself.
    pub(crate) fn signal(&self) {
        if context::executor() == self.executor_id() {
            // Awake already. Of one that runs in others' threads it is not the only one that takes the mark.
            let shared = self.is_passive() || self.is_called_back();
            if shared {
                self.signalled.set();
            } else {
                self.signalled.set_here();
            }
            return;
        }
        // In one order with the gate: either this sees that it steps no more, or its thread, on its way to rest, sees the mark.
        self.signalled.set();
        if self.is_passive() || (self.terms.polled && self.is_active()) {
            return;
        }
        self.wake();
    }

    /// No sample makes it step or pass something on: its steps come by themselves and take those that wait, so nobody tells of one.
    pub(crate) fn looks_for_samples(&self) -> bool {
        self.terms.looks
    }

    /// Signalled from here that is one plain store, or has to be looked at by its caller at once: nothing to put off.
    pub(crate) fn signals_itself(&self) -> bool {
        self.is_passive() || context::executor() == self.executor_id()
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
        &self.hub.watch
    }

    pub(super) fn wake(&self) {
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

    /// Marks this component as the one whose code runs on this thread, inside `entry`, while `f` runs.
    pub(crate) fn as_running<R>(&self, entry: Entry, f: impl FnOnce() -> R) -> R {
        let watched = self.watch.begin(entry, if entry.runs() { 0 } else { os::now_ns() });
        let before = context::swap_component(Arc::as_ptr(&self.host));
        let result = f();
        context::swap_component(before);
        self.watch.leave(watched);
        result
    }

    /// One step: first what is queued, then the component's own. Real-time.
    pub(crate) fn step(&self, entered: &mut Entered<'_>, tick: &Tick) -> Stepped {
        let watched = self.watch.begin(Entry::Step, tick.now_ns);
        let before = context::swap_component(Arc::as_ptr(&self.host));
        context::set_step_began(tick.now_ns);
        let suspicion = Suspicion::before(self);
        self.drain(entered);
        let ran = self.is_active();
        let failed = if ran { entered.step(tick).err() } else { None };
        context::set_step_began(0);
        let end_ns = os::now_ns();
        if !context::keep_rounding() {
            self.watch.misdeed(Misdeed::Rounding);
        }
        if let Some(suspicion) = suspicion {
            suspicion.after(self);
        }
        match failed {
            None => self.publish_row(entered, end_ns),
            Some(e) => self.fail(entered, "step", &e),
        }
        context::swap_component(before);
        self.watch.leave(watched);
        self.pay_safe(entered);
        Stepped { end_ns, ran }
    }

    /// Publishes a row of the state table. Real-time.
    pub(crate) fn publish_state(&self, entered: &mut Entered<'_>) {
        if self.state_bytes > 0 {
            self.publish_row(entered, os::now_ns());
        }
    }

    fn publish_row(&self, entered: &mut Entered<'_>, stamp_ns: u64) {
        self.owed.take();
        if self.state_bytes > 0 {
            let (inner, block) = entered.with_state();
            // What was left for the turn's end, while it is still the newest.
            inner.tell_row();
            let published = inner.rows.publish(stamp_ns, inner.cycle, |row| block.copy_to(row));
            self.show_row();
            if inner.row_tap.as_ref().is_some_and(|tap| tap.is_listened()) {
                inner.untold = Some((stamp_ns, published.row + 1));
                if !late::row(self) {
                    inner.tell_row();
                }
            }
        }
    }

    /// Tells the tap of the row that was left for the turn's end. Where this very thread is inside, which has no room to leave more,
    /// its next publication does.
    pub(crate) fn tell_row_of_turn(&self) {
        if let Some(mut entered) = self.object.try_enter() {
            entered.inner().tell_row();
        }
    }

    /// Runs what is queued without a step; answers it unexecuted while the component is not ACTIVE. Real-time.
    pub(crate) fn serve(&self) {
        loop {
            if let Some(mut entered) = self.object.try_enter() {
                let before = context::swap_component(Arc::as_ptr(&self.host));
                let rounding = os::rounding();
                self.drain(&mut entered);
                // No step of its own ends behind it.
                if os::rounding() != rounding {
                    os::reset_rounding(rounding);
                    self.watch.misdeed(Misdeed::RoundingInCall);
                }
                context::swap_component(before);
                self.pay_safe(&mut entered);
                drop(entered);
                self.drain_if_passive();
                return;
            }
            if !self.leave_mark() || !self.take_signal() {
                return;
            }
        }
    }

    /// Leaves it after a control entry: pays what is owed; for a passive one, looks at what its callers queued meanwhile.
    pub(crate) fn leave(&self, mut entered: Entered<'_>) {
        self.pay_safe(&mut entered);
        drop(entered);
        self.drain_if_passive();
    }

    /// Brings it to its safe condition when it was found stuck meanwhile and could not be reached.
    pub(crate) fn pay_safe(&self, entered: &mut Entered<'_>) {
        if self.watch.takes_owed_safe() {
            // Said in there, and there is nothing safer to do.
            let _ = self.make_safe(entered);
            self.publish_state(entered);
        }
    }

    /// A thread of the device comes in; turned away while another one is inside, and while it is inside itself.
    pub(crate) fn callback_enter(&self) -> Outcome {
        if !self.is_active() {
            return NOT_ACTIVE;
        }
        let mut entered = self.object.try_enter();
        let overlaps = || self.watch.busy().is_some_and(|busy| busy.entry == Entry::Callback);
        if entered.is_none() && !overlaps() {
            // A command or a control entry: it ends soon, and what the device brings is not lost for it.
            entered = self.object.enter_until(os::now_ns().saturating_add(self.patience_ns()));
        }
        let Some(mut entered) = entered else {
            self.counters.misuse(Misuse::Overlap);
            return WOULD_BLOCK;
        };
        // It may have been stopped while this thread waited.
        if !self.is_active() {
            drop(entered);
            self.left_by_device();
            return NOT_ACTIVE;
        }
        let now_ns = os::now_ns();
        let inner = entered.inner();
        inner.cycle += 1;
        inner.last_begin_ns = now_ns;
        inner.in_callback = Some(Outer {
            component: AtomicPtr::new(context::swap_component(Arc::as_ptr(&self.host)).cast_mut()),
            stepping: context::stepping(),
            watched: self.watch.begin(Entry::Callback, now_ns),
        });
        // A callback is a step: waiting is not allowed in it, and whom it wakes is woken after it.
        context::set_stepping(true);
        // Left again by `callback_leave`.
        let _stays_inside = std::mem::ManuallyDrop::new(entered);
        EXECUTED
    }

    /// It leaves again: runs what was queued meanwhile, publishes, and wakes whom that concerns. Real-time.
    pub(crate) fn callback_leave(&self) {
        let Some(entered) = self.object.adopt() else { return };
        let mut entered = std::mem::ManuallyDrop::new(entered);
        // Inside by another way: a leave without its enter opens nothing.
        let Some(outer) = entered.inner().in_callback.take() else { return };
        let mut entered = std::mem::ManuallyDrop::into_inner(entered);
        self.take_signal();
        self.drain(&mut entered);
        let end_ns = os::now_ns();
        self.publish_row(&mut entered, end_ns);
        let begin_ns = entered.inner().last_begin_ns;
        self.stats.record(begin_ns, end_ns, 0);
        self.watch.leave(outer.watched);
        self.pay_safe(&mut entered);
        drop(entered);
        self.left_by_device();
        outer.resume(&self.host);
    }

    /// What came after the drain, while its thread found somebody inside, is that thread's again.
    fn left_by_device(&self) {
        // Changed and not only read: see `Mark`.
        if self.signalled.take() {
            self.signal();
        }
    }
}
