//! Execution of a component: its terms, its wakes, one step, one look at its queues, a callback of its
//! device.
//!
//! Invariant: component code runs only here, in `drain` and in lifecycle jobs, each time for the holder of
//! the entry lock and each time noted in `watch`.

use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, Ordering};

use trocar_model::{Execution, ExecutionModel, OnFailure, Safety, Wake};
use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE, Outcome, Tick, WOULD_BLOCK};
use trocar_rt::executor::Pace;
use trocar_rt::os;
use trocar_rt::wake::Waker;

use super::super::boundary::{HostContext, inside, late, told};
use super::super::context::{self, ExecutorId};
use super::super::pending::{self, Owed, Owes};
use super::super::supervise::{Entry, Misdeed, Suspicion};
use super::super::thread::Thread;
use super::{Entered, Instance, Misuse};

/// Longest stay inside a component's code before it counts as unresponsive, ns; five periods when those are
/// longer.
const PATIENCE_NS: u64 = 50_000_000;

/// Terms on which a component runs.
pub(super) struct Terms {
    /// Period of its grid, ns; 0 without one.
    period_ns: u64,
    patience_ns: u64,
    /// True when it runs in its callers' threads.
    passive: bool,
    /// True when it runs in threads of its device.
    called_back: bool,
    /// True when its executor polls and needs no wake.
    polled: bool,
    /// True when it steps with its polling thread, and only its steps take its samples.
    looks: bool,
    /// True when frames pass it unchanged after its step has failed.
    bypass: bool,
    /// True when it steps on another component's stream.
    filter: bool,
}

impl Terms {
    /// Terms of `execution` on a thread.
    pub(super) fn of(execution: &Execution, thread: &Thread) -> Terms {
        // A filter steps when new data have come, not on its thread's grid.
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

/// Activity of a device's thread before it came in; or of a thread of this LCM, when a component's code is
/// the device.
pub(super) struct Outer {
    component: AtomicPtr<HostContext>,
    stepping: bool,
    /// Former note in the watch of the component it came into.
    watched: u64,
}

impl Outer {
    /// Resumes that activity, out of the component of `host`.
    fn resume(self, host: &Arc<HostContext>) {
        // The callbacks were left in another order than entered: the earlier component may be gone.
        let mine = std::ptr::eq(inside::swap_component(std::ptr::null()), Arc::as_ptr(host));
        let stepping = mine && self.stepping;
        if mine {
            inside::swap_component(self.component.into_inner());
        }
        if !stepping {
            pending::publish();
        }
        context::set_stepping(stepping);
        if !stepping {
            told::flush_wakes();
        }
    }
}

/// Result of a step.
pub(crate) struct Stepped {
    /// Its end, ns.
    pub(crate) end_ns: u64,
    /// Whether the component's own code ran: not when it left ACTIVE while its queues ran.
    pub(crate) ran: bool,
}

impl Instance {
    /// Period of the grid it steps on, ns; 0 without one.
    pub(crate) fn period_ns(&self) -> u64 {
        self.terms.period_ns()
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

    /// Way it is told that data or calls wait for it; empty for a component that runs in the threads of
    /// others.
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

    /// Sentence about its frames after it has failed, if there are any.
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
        let before = inside::swap_component(Arc::as_ptr(&self.host));
        let result = f();
        inside::swap_component(before);
        self.watch.leave(watched);
        result
    }

    /// Makes one step: first the queued entries, then the component's own step. Real-time.
    pub(crate) fn step(&self, entered: &mut Entered<'_>, tick: &Tick) -> Stepped {
        let watched = self.watch.begin(Entry::Step, tick.now_ns);
        let before = inside::swap_component(Arc::as_ptr(&self.host));
        context::set_step_began(tick.now_ns);
        let suspicion = Suspicion::before(&self.watch);
        self.drain(entered);
        let ran = self.is_active();
        let failed = if ran { entered.step(tick).err() } else { None };
        context::set_step_began(0);
        let end_ns = os::now_ns();
        if !context::keep_rounding() {
            self.watch.misdeed(Misdeed::Rounding);
        }
        if let Some(suspicion) = suspicion {
            suspicion.after(&self.watch);
        }
        match failed {
            None => self.publish_row(entered, end_ns),
            Some(e) => self.fail(entered, "step", &e),
        }
        inside::swap_component(before);
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

    /// Defers its row; false where it has to be published now. For the thread that is inside.
    #[inline]
    pub(super) fn owes_row(&self) -> bool {
        // Set only by the thread that runs it: a thread that is inside and finds it set is that thread.
        self.state_bytes == 0 || self.owed.get() || self.comes_to_owe()
    }

    #[inline(never)]
    fn comes_to_owe(&self) -> bool {
        let own_thread_only = !self.is_passive() && !self.is_called_back();
        if !context::stepping() || !own_thread_only || context::executor() != self.executor_id() {
            return false;
        }
        let Some(me) = self.me() else { return false };
        pending::enlist(me);
        true
    }

    /// Publishes its row, and all others this thread owes, if this thread owes it.
    #[inline]
    pub(crate) fn publish_if_owed(&self) {
        if self.owed.get() && context::executor() == self.executor_id() {
            pending::publish();
        }
    }

    fn publish_row(&self, entered: &mut Entered<'_>, stamp_ns: u64) {
        self.owed.take();
        if self.state_bytes > 0 {
            let (inner, block) = entered.with_state();
            // The row left for the turn's end is told while it is still the newest.
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

    /// Tells the tap of the row that was left for the turn's end. If this very thread is inside, without room
    /// to leave more, its next publication tells it.
    pub(crate) fn tell_row_of_turn(&self) {
        if let Some(mut entered) = self.object.try_enter() {
            entered.inner().tell_row();
        }
    }

    /// Runs the queued entries without a step; answers them unexecuted while the component is not ACTIVE.
    /// Real-time.
    pub(crate) fn serve(&self) {
        loop {
            if let Some(mut entered) = self.object.try_enter() {
                let before = inside::swap_component(Arc::as_ptr(&self.host));
                let rounding = os::rounding();
                self.drain(&mut entered);
                // No step of its own follows to check the mode.
                if os::rounding() != rounding {
                    os::reset_rounding(rounding);
                    self.watch.misdeed(Misdeed::RoundingInCall);
                }
                inside::swap_component(before);
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

    /// Leaves it after a control entry: makes it safe if that is owed; for a passive one, looks at the calls
    /// queued meanwhile.
    pub(crate) fn leave(&self, mut entered: Entered<'_>) {
        self.pay_safe(&mut entered);
        drop(entered);
        self.drain_if_passive();
    }

    /// Brings it to its safe condition if it was found stuck meanwhile and could not be reached.
    pub(crate) fn pay_safe(&self, entered: &mut Entered<'_>) {
        if self.watch.takes_owed_safe() {
            // A failure is reported in there, and there is nothing safer to do.
            let _ = self.make_safe(entered);
            self.publish_state(entered);
        }
    }

    /// Lets a thread of the device in; refused while another one is inside, and while this one is inside
    /// itself.
    pub(crate) fn callback_enter(&self) -> Outcome {
        if !self.is_active() {
            return NOT_ACTIVE;
        }
        let mut entered = self.object.try_enter();
        let overlaps = || self.watch.busy().is_some_and(|busy| busy.entry == Entry::Callback);
        if entered.is_none() && !overlaps() {
            // A command or a control entry is inside: it ends soon, and the device's data need not be lost
            // for it.
            entered = self.object.enter_until(os::now_ns().saturating_add(self.patience_ns()));
        }
        let Some(mut entered) = entered else {
            self.counters.misuse(Misuse::Overlap);
            return WOULD_BLOCK;
        };
        // The component may have been stopped while this thread waited.
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
            component: AtomicPtr::new(inside::swap_component(Arc::as_ptr(&self.host)).cast_mut()),
            stepping: context::stepping(),
            watched: self.watch.begin(Entry::Callback, now_ns),
        });
        // A callback is a step: waiting is not allowed in it, and its wakes are issued after it.
        context::set_stepping(true);
        // Left again by `callback_leave`.
        let _stays_inside = std::mem::ManuallyDrop::new(entered);
        EXECUTED
    }

    /// Lets the device's thread leave: runs the entries queued meanwhile, publishes, and issues the wakes.
    /// Real-time.
    pub(crate) fn callback_leave(&self) {
        let Some(entered) = self.object.adopt() else { return };
        let mut entered = std::mem::ManuallyDrop::new(entered);
        // The thread is inside by another way: a leave without its enter opens nothing.
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

    /// Signals entries that came after the drain, while the component's thread found the device's thread
    /// inside.
    fn left_by_device(&self) {
        // Changed and not only read: see `Mark`.
        if self.signalled.take() {
            self.signal();
        }
    }
}

impl Owes for Instance {
    fn owed(&self) -> &Owed {
        &self.owed
    }

    fn publish_owed(&self) {
        if let Some(mut entered) = self.object.try_enter() {
            self.publish_state(&mut entered);
        }
    }
}
