//! One command or handler of a component, run by the thread that is inside it.
//!
//! Invariant: what a call changed of its thread is put back before the caller's code goes on.

use trocar_plugin_api::abi::{EXECUTED, ErrBuf, Outcome, STATUS_OK, STATUS_PANICKED, Status};
use trocar_rt::os;

use super::super::books::Misuse;
use super::super::boundary::{EntryError, inside, outcome_of, plain_outcome, sentence, text_in, write_err};
use super::super::watch::{Entry, Misdeed};
use super::{CALLS_ON_TRIAL, Core, Entered};

/// The rounding mode before one of its calls, while calls are checked.
#[inline]
fn look_at_rounding(entered: &mut Entered<'_>) -> Option<u32> {
    let on_trial = &mut entered.inner().on_trial;
    (*on_trial > 0).then(|| {
        *on_trial -= 1;
        os::rounding()
    })
}

impl Core {
    /// Runs one command.
    #[inline(always)]
    pub(crate) fn command_inside(
        &self,
        entered: &mut Entered<'_>,
        command: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Outcome {
        // The reason of a panic is kept also where the caller wants none.
        let mut own = entered.err_buf();
        let err = if err.is_null() { &raw mut own } else { err };
        let before = inside::swap_component(self);
        let watched = self.watch.begin_command(command);
        let rounding = look_at_rounding(entered);
        let status = entered.command(command, arg, ret, err);
        self.keep_rounding(entered, rounding);
        self.watch.leave(watched);
        inside::swap_component(before);
        self.books.command();
        if let Some(tap) = entered.inner().command_tap.as_ref().filter(|tap| tap.is_listened()) {
            tap.to.tell(command, arg, plain_outcome(status), self.object.is_kept_here());
        }
        if status == STATUS_PANICKED {
            self.command_panicked(entered, command, err);
        } else if !self.owes_row() {
            self.publish_state(entered);
        }
        if status == STATUS_OK { EXECUTED } else { outcome_of(status, err) }
    }

    /// Runs a handler inside the `emit` of another component of the same thread. Real-time.
    #[inline(always)]
    pub(crate) fn handle(&self, entered: &mut Entered<'_>, handler: u32, payload: &[u8]) {
        let before = inside::swap_component(self);
        self.deliver(entered, handler, payload);
        if !self.owes_row() {
            self.publish_state(entered);
        }
        inside::swap_component(before);
    }

    // Always: a third of the time of an event to a handler of the same thread is the call otherwise.
    #[inline(always)]
    pub(super) fn deliver(&self, entered: &mut Entered<'_>, handler: u32, payload: &[u8]) {
        if !self.is_active() {
            return;
        }
        let watched = self.watch.begin(Entry::Event, 0);
        let mut err = entered.err_buf();
        let rounding = look_at_rounding(entered);
        let status = entered.on_event(handler, payload.as_ptr(), &raw mut err);
        self.keep_rounding(entered, rounding);
        self.watch.leave(watched);
        if status != STATUS_OK {
            self.handler_failed(entered, status, &mut err);
        }
    }

    /// Restores the rounding mode from before a command or handler: the code that runs next on this thread
    /// may be its caller's. Real-time, no system call.
    #[inline]
    fn keep_rounding(&self, entered: &mut Entered<'_>, before: Option<u32>) {
        let Some(before) = before else { return };
        if os::rounding() != before {
            os::reset_rounding(before);
            entered.inner().on_trial = CALLS_ON_TRIAL;
            self.watch.misdeed(Misdeed::RoundingInCall);
        }
    }

    #[cold]
    fn command_panicked(&self, entered: &mut Entered<'_>, command: u32, err: *mut ErrBuf) {
        let error = EntryError::new(STATUS_PANICKED, sentence(err));
        let entry = self.name_of(command).map_or_else(|| "command".into(), |name| format!("command {name}"));
        self.fail(entered, &entry, &error);
        // Making it safe may have failed as well, and written its sentence to the same place.
        write_err(err, error.text.as_bytes());
    }

    /// `interface/command` of the command at this position; not for a step.
    pub(crate) fn name_of(&self, command: u32) -> Option<String> {
        self.component()?.command_name(command)
    }

    /// Counts the failure; the watchdog reports it. Real-time unless the handler panicked.
    #[cold]
    fn handler_failed(&self, entered: &mut Entered<'_>, status: Status, err: &mut ErrBuf) {
        if status == STATUS_PANICKED {
            self.fail(entered, "on_event", &EntryError::new(status, sentence(err)));
        } else {
            self.books.failed(Misuse::HandlerFailed, text_in(err));
        }
    }
}
