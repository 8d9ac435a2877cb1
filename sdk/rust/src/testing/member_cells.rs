//! Cells behind the bench's functions and events: fake peers and records.
//!
//! Invariant: only its raw pointer reaches a cell, from the bench between entries and from the component in
//! one.

use super::alloc;
use super::carried::{CarriedCommand, tell};
use core::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use trocar_plugin_api::abi::*;

/// A fake peer's answer: the bytes of the result, or its outcome and reason.
pub(crate) type Answer = Box<dyn FnMut(&[u8]) -> Result<Vec<u8>, (Outcome, String)>>;

pub(crate) struct FnCell {
    pub(crate) connected: bool,
    arg_size: usize,
    ret_size: usize,
    pub(crate) calls: Vec<Vec<u8>>,
    /// Number of these that the history knows.
    pub(crate) told: usize,
    pub(crate) answer: Option<Answer>,
    /// The function is untyped: it is connected to nobody while no peer has given it a command.
    untyped: bool,
    command: Option<CarriedCommand>,
}

impl FnCell {
    pub(crate) fn new(arg_size: usize, ret_size: usize, untyped: bool) -> FnCell {
        FnCell {
            connected: true,
            arg_size,
            ret_size,
            calls: Vec::new(),
            told: 0,
            answer: None,
            untyped,
            command: None,
        }
    }

    /// The peer of an untyped function is this command from now on.
    pub(crate) fn carry(&mut self, command: CarriedCommand) {
        (self.arg_size, self.ret_size) = (command.arg_size, command.ret_size);
        self.command = Some(command);
    }

    pub(crate) fn command(&self) -> Option<&CarriedCommand> {
        self.command.as_ref()
    }

    /// # Safety
    /// `arg` and `ret` have the described sizes or are null, `opts` is null or valid.
    unsafe fn call(&mut self, arg: *const c_void, ret: *mut c_void, opts: *mut CallOpts) -> Outcome {
        if !self.connected || (self.untyped && self.command.is_none()) {
            return UNBOUND;
        }
        let given = if arg.is_null() { 0 } else { self.arg_size };
        let arg = match given {
            0 => &[],
            // SAFETY: not null, and readable by the caller's promise.
            len => unsafe { core::slice::from_raw_parts(arg.cast::<u8>(), len) },
        };
        self.calls.push(arg.to_vec());
        let answer = match &mut self.answer {
            // A failed assertion of the test's answer must not unwind through the component.
            Some(answer) => catch_unwind(AssertUnwindSafe(|| answer(arg)))
                .unwrap_or_else(|_| Err((FAILED, "the bench's answer panicked".to_string()))),
            None if opts.is_null() => return QUEUED,
            None if self.ret_size == 0 => return EXECUTED,
            None => Err((FAILED, "the bench has no answer here: give one with `answer`".to_string())),
        };
        match answer {
            Ok(bytes) => {
                if !ret.is_null() {
                    let len = bytes.len().min(self.ret_size);
                    // SAFETY: writable by the caller's promise.
                    unsafe { core::ptr::copy_nonoverlapping(bytes.as_ptr(), ret.cast(), len) };
                }
                EXECUTED
            }
            Err((outcome, reason)) => {
                // SAFETY: options are null or valid for the call.
                if let Some(opts) = unsafe { opts.as_mut() } {
                    opts.may_still_run = u32::from(outcome == DEADLINE);
                }
                // SAFETY: options and error buffer are null or valid for the call.
                if let Some(err) = unsafe { opts.as_ref().and_then(|o| o.err.as_mut()) } {
                    err.len = reason.len().min(err.cap);
                    // SAFETY: the buffer has `cap` writable bytes.
                    unsafe { core::ptr::copy_nonoverlapping(reason.as_ptr(), err.ptr, err.len) };
                }
                outcome
            }
        }
    }

    pub(crate) fn slot(this: *mut FnCell) -> FnSlot {
        unsafe extern "C" fn call(
            ctx: *mut c_void,
            arg: *const c_void,
            ret: *mut c_void,
            opts: *mut CallOpts,
        ) -> Outcome {
            let _quiet = alloc::pause();
            // SAFETY: the slot's own cell; the sizes come from the class's description.
            unsafe { (*ctx.cast::<FnCell>()).call(arg, ret, opts) }
        }
        unsafe extern "C" fn call_bytes(
            ctx: *mut c_void,
            arg: Bytes,
            ret: *mut c_void,
            ret_len: u64,
            opts: *mut CallOpts,
        ) -> Outcome {
            let _quiet = alloc::pause();
            // SAFETY: the slot's own cell; the sizes are compared with the description before the call.
            unsafe {
                let cell = &mut *ctx.cast::<FnCell>();
                let fits = arg.len == cell.arg_size && [0, cell.ret_size as u64].contains(&ret_len);
                let alone = cell.untyped && cell.command.is_none();
                if fits || alone { cell.call(arg.ptr.cast(), ret, opts) } else { INVALID_ARGUMENT }
            }
        }
        unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
            let _quiet = alloc::pause();
            // SAFETY: the slot's own cell; the sink is the caller's.
            unsafe {
                let cell = &*ctx.cast::<FnCell>();
                tell(cell.command.as_ref().filter(|_| cell.connected).map(|c| c.text.as_str()), sink)
            }
        }
        FnSlot {
            struct_size: size_of::<FnSlot>() as u32,
            flags: 0,
            ctx: this.cast(),
            call,
            type_of,
            call_bytes,
        }
    }
}

pub(crate) struct EventCell {
    size: usize,
    pub(crate) emitted: Vec<Vec<u8>>,
    /// Number of these that the history knows.
    pub(crate) told: usize,
    /// An observer has no room.
    pub(crate) full: bool,
}

impl EventCell {
    pub(crate) fn new(size: usize) -> EventCell {
        EventCell { size, emitted: Vec::new(), told: 0, full: false }
    }

    pub(crate) fn slot(this: *mut EventCell) -> EventSlot {
        unsafe extern "C" fn emit(ctx: *mut c_void, payload: *const c_void) -> Outcome {
            let _quiet = alloc::pause();
            // SAFETY: the slot's own cell; the payload has the described size or is null for an empty one.
            unsafe {
                let cell = &mut *ctx.cast::<EventCell>();
                let size = if payload.is_null() { 0 } else { cell.size };
                let bytes = match size {
                    0 => Vec::new(),
                    size => core::slice::from_raw_parts(payload.cast::<u8>(), size).to_vec(),
                };
                cell.emitted.push(bytes);
                if cell.full { QUEUE_FULL } else { EXECUTED }
            }
        }
        EventSlot { struct_size: size_of::<EventSlot>() as u32, flags: 0, ctx: this.cast(), emit }
    }
}
