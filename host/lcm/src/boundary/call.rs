//! Functions of required interfaces: the slot a plugin calls, and the one way a command reaches its server.
//!
//! Invariant: exactly one outcome per call. An instance is never entered from a foreign thread (a passive one
//! excepted, under its lock) and never re-entered; such a call is queued or answered WOULD_BLOCK.

use std::ffi::c_void;
use std::sync::Arc;

use trocar_plugin_api::abi::{
    Bytes, CallOpts, DEADLINE, DISABLED, ErrBuf, INVALID_ARGUMENT, MODE_CALL, MODE_SEND, Outcome, PEER_LOST,
    QUEUE_FULL, Sink, Status, UNBOUND, WOULD_BLOCK,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::Mailbox;
use trocar_rt::os;
use trocar_rt::reply::ReplyPool;

use super::super::books::Misuse;
use super::super::context;
use super::super::core::{Core, Entered};
use super::super::inbox::{Inbox, Position};
use super::host_table::HostContext;
use super::inside::misused;
use super::options;
use super::outcomes::{lacks, within_ns};
use super::queue::{Destination, Lane, queue};
use super::range::RangeCheck;
use super::read::ReadTarget;
use super::remote::{RemoteCommand, RemoteRead};
use super::texts;
use super::told;

/// The present target of one function. The tag is a byte of its own: quicker to test than a niche.
#[repr(u8)]
pub(crate) enum FnBinding {
    Unbound,
    Command(CommandTarget),
    Read(ReadTarget),
    RemoteCommand(RemoteCommand),
    RemoteRead(RemoteRead),
}

/// Host cell behind a function slot.
pub(crate) struct FnCell {
    binding: BindingCell<Bound>,
}

struct Bound {
    to: FnBinding,
    /// The command's description as manifest JSON; empty while unbound.
    described: String,
    /// Set when the component that owned the function is gone.
    gone: Option<Arc<HostContext>>,
}

impl FnCell {
    pub(super) fn unbound() -> Self {
        let bound = Bound { to: FnBinding::Unbound, described: String::new(), gone: None };
        FnCell { binding: BindingCell::new(Box::new(bound)) }
    }

    /// Marks the function's component as gone.
    pub(super) fn retire(&self, gone: &Arc<HostContext>) {
        let bound = Bound { to: FnBinding::Unbound, described: String::new(), gone: Some(gone.clone()) };
        self.binding.swap(Box::new(bound));
    }

    /// Swaps the target of the function; managers only.
    pub(crate) fn bind(&self, to: FnBinding, described: String) {
        self.binding.swap(Box::new(Bound { to, described, gone: None }));
    }

    pub(crate) fn unbind(&self) {
        self.bind(FnBinding::Unbound, String::new());
    }

    pub(super) fn reclaim(&self) -> usize {
        self.binding.reclaim()
    }

    /// Calls without options. In a turn of this thread the binding costs a plain load; the other way is kept
    /// apart here and below, so that this function stays small. `extern "C"`, as nothing unwinds out of it:
    /// then the slot's function needs no frame.
    #[inline(never)]
    extern "C" fn send(&self, arg: *const u8, ret: *mut u8) -> Outcome {
        // SAFETY: the turn is further up this very stack, and the answer is not used after this call.
        match unsafe { self.binding.peek() } {
            Some(bound) => bound.call(arg, ret, None),
            None => self.call_counted(arg, ret, None),
        }
    }

    /// # Safety
    /// As for [`options::with`].
    #[inline(never)]
    unsafe extern "C" fn call_with(&self, arg: *const u8, ret: *mut u8, opts: *mut CallOpts) -> Outcome {
        // SAFETY: not null, and lent by the caller for the call.
        let Some(opts) = (unsafe { options::whole(opts) }) else {
            // SAFETY: the caller's promise.
            return unsafe { options::with(opts, |opts| self.call_counted(arg, ret, opts)) };
        };
        // SAFETY: as in `send`.
        let bound = unsafe { self.binding.peek() };
        match bound.map(|bound| &bound.to) {
            Some(FnBinding::Read(target)) => target.call(arg, ret, Some(opts)),
            Some(FnBinding::Command(target)) => target.call_with(arg, ret, opts),
            Some(FnBinding::RemoteCommand(target)) => target.call(arg, ret, Some(opts)),
            Some(FnBinding::RemoteRead(target)) => target.call(arg, ret, Some(opts)),
            Some(FnBinding::Unbound) => bound.map_or(UNBOUND, Bound::unbound),
            None => self.call_counted(arg, ret, Some(opts)),
        }
    }

    #[inline(never)]
    fn call_counted(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        self.binding.enter().call(arg, ret, opts)
    }
}

impl Bound {
    fn unbound(&self) -> Outcome {
        if let Some(gone) = &self.gone {
            gone.note_late();
        }
        UNBOUND
    }

    #[inline(always)]
    fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        match &self.to {
            FnBinding::Unbound => self.unbound(),
            FnBinding::Command(target) => target.call(arg, ret, opts),
            FnBinding::Read(target) => target.call(arg, ret, opts),
            FnBinding::RemoteCommand(target) => target.call(arg, ret, opts),
            FnBinding::RemoteRead(target) => target.call(arg, ret, opts),
        }
    }
}

/// A command of a server, reached through one connection's inbox.
pub(crate) struct CommandTarget {
    pub(crate) server: Arc<Core>,
    pub(crate) command: Arc<Position>,
    pub(crate) lane: Lane,
    pub(crate) range: Option<RangeCheck>,
    pub(crate) inbox: Arc<Inbox>,
    pub(crate) deadline_ns: u64,
}

pub(super) unsafe extern "C" fn call(
    ctx: *mut c_void,
    arg: *const c_void,
    ret: *mut c_void,
    opts: *mut CallOpts,
) -> Outcome {
    // SAFETY: ctx is the FnCell whose slot this is; it lives as long as the instance that owns the slot.
    let cell = unsafe { &*ctx.cast::<FnCell>() };
    if opts.is_null() {
        return cell.send(arg.cast(), ret.cast());
    }
    // SAFETY: options the caller lends for the call.
    unsafe { cell.call_with(arg.cast(), ret.cast(), opts) }
}

/// As `call`, but compares the sizes with the command that is behind the function now.
pub(super) unsafe extern "C" fn call_bytes(
    ctx: *mut c_void,
    arg: Bytes,
    ret: *mut c_void,
    ret_len: u64,
    opts: *mut CallOpts,
) -> Outcome {
    // SAFETY: as in `call`.
    let cell = unsafe { &*ctx.cast::<FnCell>() };
    let go = |opts: Option<&mut CallOpts>| {
        let binding = cell.binding.enter();
        let waits = opts.as_ref().is_some_and(|o| o.mode == MODE_CALL);
        let fits = |arg_bytes: usize, ret_bytes: usize, may_leave_out: bool| {
            arg.len == arg_bytes && (ret_len == ret_bytes as u64 || (ret_len == 0 && may_leave_out))
        };
        let place = if ret_len == 0 { std::ptr::null_mut() } else { ret.cast() };
        match &binding.to {
            FnBinding::Unbound => binding.unbound(),
            FnBinding::Command(target) if fits(target.lane.arg_bytes, target.lane.ret_bytes, !waits) => {
                target.call(arg.ptr, place, opts)
            }
            FnBinding::RemoteCommand(target)
                if fits(target.lane.arg_bytes, target.lane.ret_bytes, !waits) =>
            {
                target.call(arg.ptr, place, opts)
            }
            FnBinding::Read(target) if fits(target.arg_bytes, target.ret_bytes, false) => {
                target.call(arg.ptr, ret.cast(), opts)
            }
            FnBinding::RemoteRead(target) if fits(target.arg_bytes, target.ret_bytes, false) => {
                target.call(arg.ptr, ret.cast(), opts)
            }
            _ => INVALID_ARGUMENT,
        }
    };
    // SAFETY: null or options the caller lends for the call.
    unsafe { options::with(opts, go) }
}

pub(super) unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
    // SAFETY: as in `call`.
    let cell = unsafe { &*ctx.cast::<FnCell>() };
    texts::tell(sink, &cell.binding.enter().described)
}

impl CommandTarget {
    /// One call, in the mode `opts` asks for. Real-time unless it waits, which `step` may not.
    #[inline(always)]
    pub(crate) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        if lacks(arg, self.lane.arg_bytes) {
            return INVALID_ARGUMENT;
        }
        match &self.range {
            None => self.call_allowed(arg, ret, opts),
            Some(range) => self.call_in_range(range, arg, ret, opts),
        }
    }

    #[inline(never)]
    fn call_with(&self, arg: *const u8, ret: *mut u8, opts: &mut CallOpts) -> Outcome {
        self.call(arg, ret, Some(opts))
    }

    #[inline(never)]
    fn call_in_range(
        &self,
        range: &RangeCheck,
        arg: *const u8,
        ret: *mut u8,
        opts: Option<&mut CallOpts>,
    ) -> Outcome {
        if range.holds(arg) {
            self.call_allowed(arg, ret, opts)
        } else {
            self.turned_away(arg, INVALID_ARGUMENT)
        }
    }

    /// Tells the command's tap that the call is not carried out.
    #[cold]
    fn turned_away(&self, arg: *const u8, outcome: Outcome) -> Outcome {
        if let Some(command) = self.command.get() {
            self.server.tell_turned_away(command, arg, outcome);
        }
        outcome
    }

    /// The argument is there and in range.
    #[inline(always)]
    fn call_allowed(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        let mode = opts.as_ref().map_or(MODE_SEND, |o| o.mode);
        // A command that is only sent needs no place for its result.
        if mode == MODE_CALL && lacks(ret, self.lane.ret_bytes) {
            return INVALID_ARGUMENT;
        }
        if !self.server.is_active() {
            return self.turned_away(arg, self.server.turned_away());
        }
        // The common way asks no other question: this thread runs the component, in a cycle, and nobody is
        // inside.
        match self.server.object.enter_kept() {
            Some(mut entered) => {
                let err = opts.map_or(std::ptr::null_mut(), |o| o.err);
                self.run_inside(&mut entered, arg, ret, err)
            }
            None => self.call_otherwise(arg, ret, mode, opts),
        }
    }

    #[inline(never)]
    fn call_otherwise(
        &self,
        arg: *const u8,
        ret: *mut u8,
        mode: u32,
        opts: Option<&mut CallOpts>,
    ) -> Outcome {
        let server = &*self.server;
        let deadline_ns = within_ns(opts.as_ref().map_or(0, |o| o.deadline_ns), self.deadline_ns);
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        if server.runs_here() {
            if let Some(entered) = server.object.try_enter() {
                return self.run(entered, arg, ret, err);
            }
            if mode == MODE_CALL {
                return self.wait_inside(arg, ret, err, deadline_ns);
            }
        } else if mode == MODE_CALL && context::stepping() {
            return self.would_block();
        }
        self.queue(arg, ret, mode, deadline_ns, opts)
    }

    /// Runs the command and leaves: makes the server safe if that is owed, then runs the calls queued
    /// meanwhile, if no other thread would.
    fn run(&self, mut entered: Entered<'_>, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> Outcome {
        let outcome = self.run_inside(&mut entered, arg, ret, err);
        self.server.leave(entered);
        outcome
    }

    /// Runs inside the server: its description cannot change under the call.
    #[inline(always)]
    fn run_inside(
        &self,
        entered: &mut Entered<'_>,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Outcome {
        let Some(command) = self.command.get() else { return DISABLED };
        let ret = if ret.is_null() { entered.inner().ret.as_mut_ptr().cast() } else { ret };
        self.server.command_inside(entered, command, arg, ret, err)
    }

    /// Waits for the busy server if it is passive, unless this thread is the one inside.
    fn wait_inside(&self, arg: *const u8, ret: *mut u8, err: *mut ErrBuf, deadline_ns: u64) -> Outcome {
        if context::stepping() || !self.server.is_passive() {
            return self.would_block();
        }
        let until = os::now_ns().saturating_add(deadline_ns);
        match self.server.object.enter_until(until) {
            Some(entered) => match self.lost_while_waiting() {
                Some(outcome) => {
                    self.server.leave(entered);
                    outcome
                }
                None => self.run(entered, arg, ret, err),
            },
            None if os::now_ns() < until => WOULD_BLOCK,
            None => DEADLINE,
        }
    }

    /// Reason why the command cannot run any more although it could when the wait began. Called inside the
    /// server.
    fn lost_while_waiting(&self) -> Option<Outcome> {
        if self.command.get().is_none() {
            Some(DISABLED)
        } else if self.inbox.is_closed() || self.server.is_closed() {
            Some(PEER_LOST)
        } else {
            (!self.server.is_active()).then(|| self.server.turned_away())
        }
    }

    /// Counts the misuse at both ends.
    #[cold]
    fn would_block(&self) -> Outcome {
        self.server.books.misuse(Misuse::AskedToWait);
        misused(Misuse::CalledFromStep);
        WOULD_BLOCK
    }

    pub(super) fn queue(
        &self,
        arg: *const u8,
        ret: *mut u8,
        mode: u32,
        deadline_ns: u64,
        opts: Option<&mut CallOpts>,
    ) -> Outcome {
        match queue(self, &self.lane, arg, ret, mode, deadline_ns, opts) {
            QUEUE_FULL => self.turned_away(arg, QUEUE_FULL),
            outcome => outcome,
        }
    }
}

impl Destination for CommandTarget {
    fn mailbox(&self) -> &Mailbox {
        &self.inbox.mailbox
    }

    fn replies(&self) -> &Arc<ReplyPool> {
        &self.inbox.replies
    }

    fn signal(&self) {
        // SAFETY: this target stands behind the function, which was looked at in this turn, if there is one.
        unsafe { told::signal(&self.server) };
    }

    fn signal_now(&self) {
        self.signal();
        // Its thread runs the queued call now, not after this step: the step may be one that tries again.
        told::flush_wakes();
    }

    fn queued(&self) {
        self.server.drain_if_passive();
    }

    fn closed(&self) -> Outcome {
        // Closed together with its description, or with its connection.
        if self.command.get().is_none() { DISABLED } else { PEER_LOST }
    }

    fn away(&self) -> Option<Outcome> {
        let runs = self.server.is_active() && !self.server.is_closed();
        (!runs).then(|| self.server.turned_away())
    }
}
