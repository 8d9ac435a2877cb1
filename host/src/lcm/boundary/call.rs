//! Functions of required interfaces: the slot a plugin calls, and the one way a command reaches its server.
//!
//! Invariant: exactly one outcome per call. An instance is never entered from a foreign thread (a passive one excepted,
//! under its lock) and never re-entered; whoever would, is queued or answered WOULD_BLOCK.

use std::ffi::c_void;
use std::sync::Arc;

use trocar_model::{Arg, Prim, Type};
use trocar_plugin_api::abi::{
    Bytes, CallOpts, DEADLINE, DISABLED, EXECUTED, ErrBuf, FAILED, INVALID_ARGUMENT, MODE_CALL, MODE_SEND,
    NOT_ACTIVE, Outcome, PEER_LOST, QUEUE_FULL, QUEUED, STATUS_OK, STATUS_PANICKED, Sink, Status, UNBOUND,
    WOULD_BLOCK,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::os;
use trocar_rt::reply::Reply;

use super::super::context;
use super::super::convert::MAX_PAYLOAD;
use super::super::inbox::{ENTRY_COMMAND, Inbox, Position};
use super::super::instance::{Entered, Instance, Misuse};
use super::super::pending;
use super::options;

/// Deadline of a blocking call that names none, ns.
pub(in crate::lcm) const DEFAULT_DEADLINE_NS: u64 = 1_000_000_000;

/// What stands behind one function now.
pub(in crate::lcm) enum FnBinding {
    Unbound,
    Command(CommandTarget),
    Read(ReadTarget),
}

/// Host cell behind a function slot.
pub(in crate::lcm) struct FnCell {
    binding: BindingCell<Bound>,
}

struct Bound {
    to: FnBinding,
    /// The command's description as manifest JSON; empty while unbound.
    described: String,
}

impl FnCell {
    pub(super) fn unbound() -> Self {
        let bound = Bound { to: FnBinding::Unbound, described: String::new() };
        FnCell { binding: BindingCell::new(Box::new(bound)) }
    }

    /// Swaps what stands behind the function; managers only.
    pub(in crate::lcm) fn bind(&self, to: FnBinding, described: String) {
        self.binding.swap(Box::new(Bound { to, described }));
    }

    pub(in crate::lcm) fn unbind(&self) {
        self.bind(FnBinding::Unbound, String::new());
    }

    pub(super) fn reclaim(&self) -> usize {
        self.binding.reclaim()
    }

    #[inline(always)]
    fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        self.binding.look(move |bound| match &bound.to {
            FnBinding::Unbound => UNBOUND,
            FnBinding::Command(target) => target.call(arg, ret, opts),
            FnBinding::Read(target) => target.call(arg, ret, opts),
        })
    }
}

/// A command of a server, reached through one connection's inbox.
pub(in crate::lcm) struct CommandTarget {
    pub(in crate::lcm) server: Arc<Instance>,
    pub(in crate::lcm) command: Arc<Position>,
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
    pub(in crate::lcm) from: Reader,
    pub(in crate::lcm) arg_bytes: usize,
    pub(in crate::lcm) ret_bytes: usize,
    pub(in crate::lcm) range: Option<RangeCheck>,
}

/// Who answers a read.
#[derive(Clone)]
pub(in crate::lcm) enum Reader {
    /// The class, from the published row.
    Class(Arc<Position>),
    /// The host: the system interface's read of this number.
    System(usize),
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
        return cell.call(arg.cast(), ret.cast(), None);
    }
    // SAFETY: options the caller lends for the call.
    unsafe { options::with(opts, move |opts| cell.call(arg.cast(), ret.cast(), opts)) }
}

/// As `call`, with the sizes compared with the command that is behind the function now.
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
        match &binding.to {
            FnBinding::Unbound => UNBOUND,
            FnBinding::Command(target) if fits(target.arg_bytes, target.ret_bytes, !waits) => {
                let ret = if ret_len == 0 { std::ptr::null_mut() } else { ret.cast() };
                target.call(arg.ptr, ret, opts)
            }
            FnBinding::Read(target) if fits(target.arg_bytes, target.ret_bytes, false) => {
                target.call(arg.ptr, ret.cast(), opts)
            }
            _ => INVALID_ARGUMENT,
        }
    };
    // SAFETY: null or options the caller lends for the call.
    unsafe { options::with(opts, go) }
}

/// An argument or result the command has, but the caller gave no place for.
fn lacks(place: *const u8, bytes: usize) -> bool {
    place.is_null() && bytes > 0
}

pub(super) unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
    // SAFETY: as in `call`.
    let cell = unsafe { &*ctx.cast::<FnCell>() };
    super::tell(sink, &cell.binding.enter().described)
}

impl ReadTarget {
    fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        // A read that nobody takes the result of does nothing: even when only sent, it needs the place.
        if lacks(arg, self.arg_bytes) || lacks(ret, self.ret_bytes) {
            return INVALID_ARGUMENT;
        }
        if let Some(range) = &self.range
            && !range.holds(arg)
        {
            return INVALID_ARGUMENT;
        }
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        let (outcome, stamp_ns) = match &self.from {
            Reader::System(which) => {
                // SAFETY: not null, and with room for the command's result type, checked when bound.
                let out = unsafe { std::slice::from_raw_parts_mut(ret, self.ret_bytes) };
                (EXECUTED, self.server.system_read(*which, out))
            }
            Reader::Class(command) => match command.get() {
                Some(command) => {
                    pending::publish_of(&self.server);
                    read_row(&self.server, command, arg, ret, err)
                }
                None => (DISABLED, 0),
            },
        };
        if let Some(opts) = opts {
            opts.stamp_ns = stamp_ns;
        }
        outcome
    }
}

/// Words of the stack copies a read chooses from: the smallest that holds the row, so nothing is allocated on a step and
/// little is cleared in vain.
const FEW_WORDS: usize = 8;
const TINY_ROW: usize = 32;
const SMALL_ROW: usize = 128;
const MIDDLE_ROW: usize = 1024;
const LARGEST_ROW: usize = MAX_PAYLOAD / 8;

/// Answers a read from the server's last published row; any thread, never waits.
fn read_row(
    server: &Instance,
    command: u32,
    arg: *const u8,
    ret: *mut u8,
    err: *mut ErrBuf,
) -> (Outcome, u64) {
    let read = match server.state_bytes.div_ceil(8) {
        words if words <= FEW_WORDS => read_copy::<FEW_WORDS>,
        words if words <= TINY_ROW => read_copy::<TINY_ROW>,
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
    let status = server.object.read(row, command, arg, ret, err);
    if status == STATUS_PANICKED {
        panicked(server, command, err);
    }
    (outcome_of(status), info.stamp_ns)
}

/// A read has no instance that could be distrusted: its caller is told, and it is counted; the watchdog tells the world.
#[cold]
fn panicked(server: &Instance, command: u32, err: *mut ErrBuf) {
    let ports = server.ports();
    let name = ports.provided.iter().flat_map(|p| &p.commands).nth(command as usize).map_or("", |c| &c.name);
    let text = format!("{name}: {}", super::sentence(err));
    server.counters.failed(Misuse::ReadPanicked, text.as_bytes());
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
    #[inline(always)]
    pub(in crate::lcm) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        let mode = opts.as_ref().map_or(MODE_SEND, |o| o.mode);
        // What is only sent needs no place for its result.
        if lacks(arg, self.arg_bytes) || (mode == MODE_CALL && lacks(ret, self.ret_bytes)) {
            return INVALID_ARGUMENT;
        }
        if let Some(range) = &self.range
            && !range.holds(arg)
        {
            return INVALID_ARGUMENT;
        }
        if !self.server.is_active() {
            return NOT_ACTIVE;
        }
        // A component this thread runs, in a cycle, with nobody inside: the common way has no other question.
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
        let deadline_ns = match opts.as_ref() {
            Some(o) if o.deadline_ns > 0 => o.deadline_ns,
            _ => self.deadline_ns,
        };
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

    /// Runs it and leaves: pays what is owed, then runs what was queued meanwhile, where nobody else would.
    fn run(&self, mut entered: Entered<'_>, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> Outcome {
        let outcome = self.run_inside(&mut entered, arg, ret, err);
        self.server.leave(entered);
        outcome
    }

    /// Inside the server: its description cannot change under the call.
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

    /// The server is passive and busy: waits for it, unless this thread is the one inside.
    fn wait_inside(&self, arg: *const u8, ret: *mut u8, err: *mut ErrBuf, deadline_ns: u64) -> Outcome {
        if context::stepping() || !self.server.is_passive() {
            return self.would_block();
        }
        let until = os::now_ns().saturating_add(deadline_ns);
        match self.server.object.enter_until(until) {
            Some(entered) => self.run(entered, arg, ret, err),
            None if os::now_ns() < until => WOULD_BLOCK,
            None => DEADLINE,
        }
    }

    /// Counted at both ends.
    #[cold]
    fn would_block(&self) -> Outcome {
        self.server.counters.misuse(Misuse::AskedToWait);
        // SAFETY: null, or the context of the instance that is being called on this very thread.
        let caller = unsafe { context::component().as_ref() }.and_then(|host| host.instance.get());
        if let Some(caller) = caller.and_then(std::sync::Weak::upgrade) {
            caller.counters.misuse(Misuse::CalledFromStep);
        }
        WOULD_BLOCK
    }

    fn queue(
        &self,
        arg: *const u8,
        ret: *mut u8,
        mode: u32,
        deadline_ns: u64,
        opts: Option<&mut CallOpts>,
    ) -> Outcome {
        pending::publish();
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
            Push::Full => {
                // Its thread runs what is there now, not after this step: the step may be one that tries again.
                self.server.signal();
                context::flush_wakes();
                return QUEUE_FULL;
            }
            Push::TooLong => return QUEUE_FULL,
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
    if let Some(err) = unsafe { err.as_mut() }
        && !err.ptr.is_null()
    {
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
        if self.prim == Prim::F64 && self.count == 1 && !self.list {
            // SAFETY: the argument is one f64; it may lie anywhere.
            let value = unsafe { arg.cast::<f64>().read_unaligned() };
            return value >= self.min && value <= self.max;
        }
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
    let len = err.len.min(room.len());
    Answer {
        outcome,
        value: super::as_bytes(&ret)[..ret_bytes].to_vec(),
        text: String::from_utf8_lossy(&room[..len]).into_owned(),
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
