//! Reads of a server: answered from its last published row in the caller's thread, or by the host.
//!
//! Invariant: a read never enters an instance and never waits; the row it sees is whole.

use std::sync::Arc;

use trocar_plugin_api::abi::{
    CallOpts, DISABLED, EXECUTED, ErrBuf, INVALID_ARGUMENT, NOT_ACTIVE, Outcome, STATUS_PANICKED,
};

use super::super::books::Misuse;
use super::super::core::Core;
use super::super::inbox::Position;
use super::outcomes::{lacks, outcome_of};
use super::range::RangeCheck;
use super::row::{FEW_WORDS, LARGEST_ROW, MIDDLE_ROW, SMALL_ROW, TINY_ROW, bytes_of, with_row};
use super::texts::sentence;

/// A read of a server: the class's own or one of the system interface.
pub(crate) struct ReadTarget {
    pub(crate) server: Arc<Core>,
    pub(crate) from: Reader,
    pub(crate) arg_bytes: usize,
    pub(crate) ret_bytes: usize,
    pub(crate) range: Option<RangeCheck>,
}

/// Responder of a read.
#[derive(Clone)]
pub(crate) enum Reader {
    /// The class, from the published row.
    Class(Arc<Position>),
    /// The host: the system interface's read of this number.
    System(usize),
}

impl ReadTarget {
    #[inline(never)]
    pub(super) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        // A read whose result nobody takes does nothing: even when only sent, it needs the place.
        if lacks(arg, self.arg_bytes) || lacks(ret, self.ret_bytes) {
            return INVALID_ARGUMENT;
        }
        if self.range.is_some() && !self.is_in_range(arg) {
            return INVALID_ARGUMENT;
        }
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        let (outcome, stamp_ns) = match &self.from {
            Reader::System(which) => (EXECUTED, self.read_system(*which, ret)),
            Reader::Class(command) => match command.get() {
                Some(command) => {
                    self.server.publish_if_owed();
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

    // Kept apart, so that the common way stays small.
    #[inline(never)]
    fn is_in_range(&self, arg: *const u8) -> bool {
        self.range.as_ref().is_none_or(|range| range.holds(arg))
    }

    /// Answers a read of the system interface. `ret` is the place for the result, and not null where the read
    /// has one.
    #[inline(never)]
    fn read_system(&self, which: usize, ret: *mut u8) -> u64 {
        // SAFETY: not null, and with room for the command's result type, checked when bound.
        let out = unsafe { std::slice::from_raw_parts_mut(ret, self.ret_bytes) };
        self.server.system_read(which, out)
    }
}

/// Outcome of a read for a caller in another process.
pub(crate) struct Published {
    pub(crate) outcome: Outcome,
    /// True when the read panicked.
    pub(crate) panicked: bool,
    /// Stamp of the row, ns.
    pub(crate) stamp_ns: u64,
    /// Bytes of the sentence.
    pub(crate) text_bytes: usize,
}

/// Answers a read, with as much of the sentence as there is room for. `arg` and `out` have the sizes of the
/// command. `again`: the read panicked last time too, which was counted. Any thread, never waits.
pub(crate) fn read_published(
    server: &Core,
    from: &Reader,
    arg: &[u8],
    out: &mut [u8],
    text: &mut [u8],
    again: bool,
) -> Published {
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    let mut panicked = false;
    let (outcome, stamp_ns) = match from {
        Reader::System(which) => (EXECUTED, server.system_read(*which, out)),
        Reader::Class(command) => match command.get() {
            Some(command) => with_row(server.state_bytes, |row| {
                let Some(info) = server.rows.latest(bytes_of(row, server.state_bytes)) else {
                    return (NOT_ACTIVE, 0);
                };
                let err = &raw mut err;
                let status = server.object.read(row, command, arg.as_ptr(), out.as_mut_ptr(), err);
                panicked = status == STATUS_PANICKED;
                if panicked && !again {
                    self::panicked(server, command, err);
                }
                (outcome_of(status, err), info.stamp_ns)
            }),
            None => (DISABLED, 0),
        },
    };
    Published { outcome, panicked, stamp_ns, text_bytes: err.len.min(text.len()) }
}

/// Answers a read from the server's last published row; any thread, never waits.
#[inline]
fn read_row(server: &Core, command: u32, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> (Outcome, u64) {
    let read = match server.state_bytes.div_ceil(8) {
        words if words <= FEW_WORDS => return read_copy::<FEW_WORDS>(server, command, arg, ret, err),
        words if words <= TINY_ROW => read_apart::<TINY_ROW>,
        words if words <= SMALL_ROW => read_apart::<SMALL_ROW>,
        words if words <= MIDDLE_ROW => read_apart::<MIDDLE_ROW>,
        _ => read_apart::<LARGEST_ROW>,
    };
    read(server, command, arg, ret, err)
}

/// As `read_copy`, with its copy in a stack frame of its own.
#[inline(never)]
fn read_apart<const N: usize>(
    server: &Core,
    command: u32,
    arg: *const u8,
    ret: *mut u8,
    err: *mut ErrBuf,
) -> (Outcome, u64) {
    read_copy::<N>(server, command, arg, ret, err)
}

/// Answers the read from a copy of the newest row in `N` words of the stack; the row fits, by `convert`'s
/// limit.
#[inline]
fn read_copy<const N: usize>(
    server: &Core,
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
    (outcome_of(status, err), info.stamp_ns)
}

/// Counts a read that panicked. A read has no instance that could be distrusted: its caller is told, and the
/// watchdog tells the world.
#[cold]
fn panicked(server: &Core, command: u32, err: *mut ErrBuf) {
    let name = server.name_of(command).unwrap_or_default();
    let name = name.rsplit('/').next().unwrap_or_default();
    let text = format!("{name}: {}", sentence(err));
    server.books.failed(Misuse::ReadPanicked, text.as_bytes());
}
