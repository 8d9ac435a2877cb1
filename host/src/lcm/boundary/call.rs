//! Functions of required interfaces: the slot a plugin calls, and the one way a command reaches its server.
//!
//! Invariant: exactly one outcome per call. An instance is never entered from a foreign thread (a passive one excepted,
//! under its lock) and never re-entered; whoever would, is queued or answered WOULD_BLOCK.

use std::ffi::c_void;
use std::sync::Arc;

use trocar_model::{Arg, Prim, Type};
use trocar_plugin_api::abi::{
    CallOpts, DEADLINE, EXECUTED, ErrBuf, FAILED, INVALID_ARGUMENT, MODE_CALL, MODE_SEND, NOT_ACTIVE,
    Outcome, PEER_LOST, QUEUE_FULL, QUEUED, STATUS_OK, STATUS_UNSUPPORTED, Sink, Status, UNBOUND,
    WOULD_BLOCK,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::os;
use trocar_rt::reply::Reply;

use super::super::context;
use super::super::convert::MAX_PAYLOAD;
use super::super::inbox::{ENTRY_COMMAND, Inbox};
use super::super::instance::Instance;

/// Deadline of a blocking call that names none, ns.
pub(in crate::lcm) const DEFAULT_DEADLINE_NS: u64 = 1_000_000_000;

/// What stands behind one function now.
pub(in crate::lcm) enum FnBinding {
    Unbound,
    Command(CommandTarget),
    Read(ReadTarget),
}

/// Host cell behind a function slot.
pub(super) struct FnCell {
    pub(super) binding: BindingCell<FnBinding>,
}

/// A command of a server, reached through one connection's inbox.
pub(in crate::lcm) struct CommandTarget {
    pub(in crate::lcm) server: Arc<Instance>,
    /// The class's own command id.
    pub(in crate::lcm) command: u32,
    pub(in crate::lcm) arg_bytes: usize,
    pub(in crate::lcm) ret_bytes: usize,
    pub(in crate::lcm) range: Option<RangeCheck>,
    pub(in crate::lcm) overflow: Overflow,
    pub(in crate::lcm) inbox: Arc<Inbox>,
    /// Position in the inbox's table.
    pub(in crate::lcm) index: u32,
    pub(in crate::lcm) deadline_ns: u64,
}

/// A read of a server: the class's own or one of the system interface.
pub(in crate::lcm) struct ReadTarget {
    pub(in crate::lcm) server: Arc<Instance>,
    pub(in crate::lcm) command: u32,
    pub(in crate::lcm) ret_bytes: usize,
    pub(in crate::lcm) range: Option<RangeCheck>,
}

pub(super) unsafe extern "C" fn call(
    ctx: *mut c_void,
    arg: *const c_void,
    ret: *mut c_void,
    opts: *mut CallOpts,
) -> Outcome {
    // SAFETY: ctx is the FnCell whose slot this is; it lives as long as the instance that owns the slot.
    let cell = unsafe { &*ctx.cast::<FnCell>() };
    // SAFETY: null or a CallOpts the caller lends for the call.
    let opts = unsafe { opts.as_mut() };
    let binding = cell.binding.enter();
    match &*binding {
        FnBinding::Unbound => UNBOUND,
        FnBinding::Command(target) => target.call(arg.cast(), ret.cast(), opts),
        FnBinding::Read(target) => target.call(arg.cast(), ret.cast(), opts),
    }
}

pub(super) unsafe extern "C" fn type_of(_ctx: *mut c_void, _sink: *const Sink) -> Status {
    STATUS_UNSUPPORTED
}

impl ReadTarget {
    fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        if let Some(range) = &self.range
            && !range.holds(arg)
        {
            return INVALID_ARGUMENT;
        }
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        let (outcome, stamp_ns) = read_row(&self.server, self.command, arg, ret, self.ret_bytes, err);
        if let Some(opts) = opts {
            opts.stamp_ns = stamp_ns;
        }
        outcome
    }
}

/// Words of the stack copies a read chooses from: the smallest that holds the row, so nothing is allocated on a step.
const SMALL_ROW: usize = 128;
const MIDDLE_ROW: usize = 1024;
const LARGEST_ROW: usize = MAX_PAYLOAD / 8;

/// Answers a read from the server's last published row; any thread, never waits.
pub(in crate::lcm) fn read_row(
    server: &Instance,
    command: u32,
    arg: *const u8,
    ret: *mut u8,
    ret_bytes: usize,
    err: *mut ErrBuf,
) -> (Outcome, u64) {
    if let Some(which) = server.system_command(command) {
        // SAFETY: `ret` has room for the command's result type, checked when bound.
        let out = unsafe { std::slice::from_raw_parts_mut(ret, ret_bytes) };
        return (EXECUTED, server.system_read(which, out));
    }
    let read = match server.state_bytes.div_ceil(8) {
        words if words <= SMALL_ROW => read_copy::<SMALL_ROW>,
        words if words <= MIDDLE_ROW => read_copy::<MIDDLE_ROW>,
        _ => read_copy::<LARGEST_ROW>,
    };
    read(server, command, arg, ret, err)
}

/// The read on a copy of the newest row in `N` words of the stack; the row fits, by `convert`'s limit.
#[inline(never)]
fn read_copy<const N: usize>(
    server: &Instance,
    command: u32,
    arg: *const u8,
    ret: *mut u8,
    err: *mut ErrBuf,
) -> (Outcome, u64) {
    let mut copy = [0u64; N];
    let row = &mut copy[..server.state_bytes.div_ceil(8)];
    // SAFETY: a u64 slice viewed as its first `state_bytes` bytes.
    let bytes = unsafe { std::slice::from_raw_parts_mut(row.as_mut_ptr().cast::<u8>(), server.state_bytes) };
    let Some(info) = server.rows.latest(bytes) else {
        return (NOT_ACTIVE, 0);
    };
    (outcome_of(server.object.read(row, command, arg, ret, err)), info.stamp_ns)
}

/// The outcome a status of `command` or `read` means to the caller.
pub(in crate::lcm) fn outcome_of(status: Status) -> Outcome {
    match status {
        s if s >= STATUS_OK => EXECUTED,
        trocar_plugin_api::abi::STATUS_INVALID => INVALID_ARGUMENT,
        _ => FAILED,
    }
}

impl CommandTarget {
    /// One call, in the mode `opts` asks for. Real-time unless it waits, which `step` may not.
    pub(in crate::lcm) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        if let Some(range) = &self.range
            && !range.holds(arg)
        {
            return INVALID_ARGUMENT;
        }
        let server = &*self.server;
        if !server.is_active() {
            return NOT_ACTIVE;
        }
        let mode = opts.as_ref().map_or(MODE_SEND, |o| o.mode);
        let deadline_ns = match opts.as_ref() {
            Some(o) if o.deadline_ns > 0 => o.deadline_ns,
            _ => self.deadline_ns,
        };
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        if server.runs_here() {
            if let Some(entered) = server.object.try_enter() {
                return server.run_command(entered, self.command, arg, ret, err);
            }
            if mode == MODE_CALL {
                return self.wait_inside(arg, ret, err, deadline_ns);
            }
        } else if mode == MODE_CALL && context::stepping() {
            server.counters.would_block();
            return WOULD_BLOCK;
        }
        self.queue(arg, ret, mode, deadline_ns, opts)
    }

    /// The server is passive and busy: waits for it, unless this thread is the one inside.
    fn wait_inside(&self, arg: *const u8, ret: *mut u8, err: *mut ErrBuf, deadline_ns: u64) -> Outcome {
        if context::stepping() || !self.server.is_passive() {
            self.server.counters.would_block();
            return WOULD_BLOCK;
        }
        let until = os::now_ns().saturating_add(deadline_ns);
        match self.server.object.enter_until(until) {
            Some(entered) => self.server.run_command(entered, self.command, arg, ret, err),
            None if os::now_ns() < until => WOULD_BLOCK,
            None => DEADLINE,
        }
    }

    fn queue(
        &self,
        arg: *const u8,
        ret: *mut u8,
        mode: u32,
        deadline_ns: u64,
        opts: Option<&mut CallOpts>,
    ) -> Outcome {
        let ticket = if mode == MODE_CALL {
            match self.inbox.replies.acquire() {
                Some(ticket) => Some(ticket),
                None => return QUEUE_FULL,
            }
        } else {
            None
        };
        let head = EntryHead {
            kind: ENTRY_COMMAND,
            index: self.index,
            reply: ticket.as_ref().map_or(0, |t| t.token()),
            stamp_ns: 0,
        };
        let payload: &[u8] = if self.arg_bytes == 0 {
            &[]
        } else {
            // SAFETY: the caller lends an argument of the command's type, whose size was fixed when bound.
            unsafe { std::slice::from_raw_parts(arg, self.arg_bytes) }
        };
        match self.inbox.mailbox.push(head, payload, self.overflow) {
            Push::Queued => {}
            Push::Full | Push::TooLong => return QUEUE_FULL,
            Push::Closed => return PEER_LOST,
            Push::DroppedOldest(old) => {
                self.inbox.replies.fail(old.reply, QUEUE_FULL);
            }
        }
        self.server.signal();
        self.server.drain_if_passive();
        let Some(ticket) = ticket else { return QUEUED };
        let ret_bytes = self.ret_bytes;
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        let reply = ticket.wait(os::now_ns().saturating_add(deadline_ns), |value, text| {
            if ret_bytes > 0 {
                // SAFETY: `ret` has room for the result type; reply cells are made at least that large.
                unsafe { std::ptr::copy_nonoverlapping(value.as_ptr(), ret, ret_bytes.min(value.len())) };
            }
            write_err(err, text);
        });
        match reply {
            Reply::Done(outcome) => outcome,
            Reply::DeadlineNotStarted => DEADLINE,
            Reply::DeadlineMayRun => {
                if let Some(opts) = opts {
                    opts.may_still_run = 1;
                }
                DEADLINE
            }
        }
    }
}

/// Puts a sentence into a caller's error buffer, cut to its room.
pub(in crate::lcm) fn write_err(err: *mut ErrBuf, text: &[u8]) {
    // SAFETY: null or a buffer the caller lends for the call.
    if let Some(err) = unsafe { err.as_mut() } {
        let n = text.len().min(err.cap);
        // SAFETY: `ptr` has room for `cap` bytes.
        unsafe { std::ptr::copy_nonoverlapping(text.as_ptr(), err.ptr, n) };
        err.len = n;
    }
}

/// The declared range of a numeric argument, checked on the bytes before the component sees them.
#[derive(Clone, Debug)]
pub(in crate::lcm) struct RangeCheck {
    prim: Prim,
    count: usize,
    /// The count stands in a u64 before the items.
    list: bool,
    min: f64,
    max: f64,
}

impl RangeCheck {
    /// `None` when the argument has no declared range or is not made of numbers.
    pub(in crate::lcm) fn of(arg: &Arg) -> Option<RangeCheck> {
        if arg.min.is_none() && arg.max.is_none() {
            return None;
        }
        let (item, count, list) = match &arg.ty {
            Type::Prim(p) => (*p, 1, false),
            Type::Array { item, n } => match &**item {
                Type::Prim(p) => (*p, *n, false),
                _ => return None,
            },
            Type::List { item, n } => match &**item {
                Type::Prim(p) => (*p, *n, true),
                _ => return None,
            },
            _ => return None,
        };
        Some(RangeCheck {
            prim: item,
            count,
            list,
            min: arg.min.unwrap_or(f64::NEG_INFINITY),
            max: arg.max.unwrap_or(f64::INFINITY),
        })
    }

    fn holds(&self, arg: *const u8) -> bool {
        let size = Type::Prim(self.prim).size();
        let skip = if self.list { 8 } else { 0 };
        // SAFETY: the argument has the command's type: an optional length, then room for `count` items.
        let bytes = unsafe { std::slice::from_raw_parts(arg, skip + size * self.count) };
        let count = if self.list { (word(bytes, 8) as usize).min(self.count) } else { self.count };
        bytes[skip..].chunks_exact(size).take(count).all(|item| {
            let value = self.number(item);
            value >= self.min && value <= self.max
        })
    }

    fn number(&self, item: &[u8]) -> f64 {
        let raw = word(item, item.len());
        match self.prim {
            Prim::F64 => f64::from_bits(raw),
            Prim::F32 => f64::from(f32::from_bits(raw as u32)),
            Prim::I8 => f64::from(raw as i8),
            Prim::I16 => f64::from(raw as i16),
            Prim::I32 => f64::from(raw as i32),
            Prim::I64 => raw as i64 as f64,
            Prim::Bool | Prim::U8 | Prim::U16 | Prim::U32 | Prim::U64 | Prim::Stamp => raw as f64,
        }
    }
}

/// The first `n` (at most 8) bytes as a little-endian number.
fn word(bytes: &[u8], n: usize) -> u64 {
    bytes.iter().take(n).rev().fold(0, |acc, b| acc << 8 | u64::from(*b))
}

/// What a call from outside a component came to.
pub(in crate::lcm) struct Answer {
    pub(in crate::lcm) outcome: Outcome,
    /// Exact bytes of the result.
    pub(in crate::lcm) value: Vec<u8>,
    pub(in crate::lcm) text: String,
    pub(in crate::lcm) stamp_ns: u64,
    pub(in crate::lcm) may_still_run: bool,
}

impl Answer {
    pub(in crate::lcm) fn unbound() -> Answer {
        Answer { outcome: UNBOUND, value: Vec::new(), text: String::new(), stamp_ns: 0, may_still_run: false }
    }
}

/// Calls with aligned copies of the argument and room for the result.
fn answer(
    arg: &[u8],
    ret_bytes: usize,
    mode: u32,
    deadline_ns: u64,
    call: impl FnOnce(*const u8, *mut u8, &mut CallOpts) -> Outcome,
) -> Answer {
    let mut words: Vec<u64> = vec![0; arg.len().div_ceil(8)];
    for (word, bytes) in words.iter_mut().zip(arg.chunks(8)) {
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        *word = u64::from_ne_bytes(raw);
    }
    let mut ret: Vec<u64> = vec![0; ret_bytes.div_ceil(8)];
    let mut room = [0u8; super::ERR_BYTES];
    let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
    let mut opts = CallOpts {
        struct_size: size_of::<CallOpts>() as u32,
        mode,
        deadline_ns,
        err: &raw mut err,
        stamp_ns: 0,
        may_still_run: 0,
        reserved: 0,
    };
    let outcome = call(words.as_ptr().cast(), ret.as_mut_ptr().cast(), &mut opts);
    Answer {
        outcome,
        value: super::as_bytes(&ret)[..ret_bytes].to_vec(),
        text: super::sentence(&raw mut err),
        stamp_ns: opts.stamp_ns,
        may_still_run: opts.may_still_run != 0,
    }
}

impl CommandTarget {
    /// A call from outside; `arg` has the command's argument type. Blocks until the deadline unless `send`.
    pub(in crate::lcm) fn answer(
        &self,
        arg: &[u8],
        ret_bytes: usize,
        send: bool,
        deadline_ns: u64,
    ) -> Answer {
        let mode = if send { MODE_SEND } else { MODE_CALL };
        answer(arg, ret_bytes, mode, deadline_ns, |arg, ret, opts| self.call(arg, ret, Some(opts)))
    }
}

impl ReadTarget {
    /// A read from outside; `arg` has the command's argument type. Never waits.
    pub(in crate::lcm) fn answer(&self, arg: &[u8], ret_bytes: usize) -> Answer {
        answer(arg, ret_bytes, MODE_CALL, 0, |arg, ret, opts| self.call(arg, ret, Some(opts)))
    }
}
