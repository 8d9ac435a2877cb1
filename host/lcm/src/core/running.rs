//! Entering a component: what is noted meanwhile, what it owes when left, and callbacks of its device.
//!
//! Invariant: component code runs for the holder of the entry lock alone, each time noted in `watch`.

use std::mem::ManuallyDrop;
use std::sync::atomic::AtomicPtr;

use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE, Outcome, WOULD_BLOCK};
use trocar_rt::os;

use super::super::books::Misuse;
use super::super::boundary::{inside, told};
use super::super::context;
use super::super::pending;
use super::super::watch::{Entry, Misdeed};
use super::{Core, Entered, Outer};

impl Outer {
    /// Resumes that activity, out of the component of `core`.
    fn resume(self, core: &Core) {
        // The callbacks were left in another order than entered: the earlier component may be gone.
        let mine = std::ptr::eq(inside::swap_component(std::ptr::null()), core);
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

impl Core {
    /// Marks this component as the one whose code runs on this thread, inside `entry`, while `f` runs.
    pub(crate) fn as_running<R>(&self, entry: Entry, f: impl FnOnce() -> R) -> R {
        let watched = self.watch.begin(entry, if entry.runs() { 0 } else { os::now_ns() });
        let before = inside::swap_component(self);
        let result = f();
        inside::swap_component(before);
        self.watch.leave(watched);
        result
    }

    /// Runs the queued entries without a step; answers them unexecuted while the component is not ACTIVE.
    /// Real-time.
    pub(crate) fn serve(&self) {
        loop {
            if let Some(mut entered) = self.object.try_enter() {
                let before = inside::swap_component(self);
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
            if let Some(component) = self.component() {
                component.make_safe(entered);
            }
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
            self.books.misuse(Misuse::Overlap);
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
            component: AtomicPtr::new(inside::swap_component(self).cast_mut()),
            stepping: context::stepping(),
            watched: self.watch.begin(Entry::Callback, now_ns),
        });
        // A callback is a step: waiting is not allowed in it, and its wakes are issued after it.
        context::set_stepping(true);
        // Left again by `callback_leave`.
        let _stays_inside = ManuallyDrop::new(entered);
        EXECUTED
    }

    /// Lets the device's thread leave: runs the entries queued meanwhile, publishes, and issues the wakes.
    /// Real-time.
    pub(crate) fn callback_leave(&self) {
        let Some(entered) = self.object.adopt() else { return };
        let mut entered = ManuallyDrop::new(entered);
        // The thread is inside by another way: a leave without its enter opens nothing.
        let Some(outer) = entered.inner().in_callback.take() else { return };
        let mut entered = ManuallyDrop::into_inner(entered);
        self.take_signal();
        self.drain(&mut entered);
        let end_ns = os::now_ns();
        self.publish_row(&mut entered, end_ns);
        let begin_ns = entered.inner().last_begin_ns;
        self.books.steps.record(begin_ns, end_ns, 0);
        self.watch.leave(outer.watched);
        self.pay_safe(&mut entered);
        drop(entered);
        self.left_by_device();
        outer.resume(self);
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
