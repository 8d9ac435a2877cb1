//! Calls from outside a component: with aligned copies, and all results in one value.
//!
//! Invariant: the sizes handed over are those of the command that was looked up.

use trocar_plugin_api::abi::{CallOpts, ErrBuf, MODE_CALL, MODE_SEND, Outcome, UNBOUND};

use super::call::CommandTarget;
use super::read::ReadTarget;
use super::texts::{as_bytes, sentence};

/// Result of a call from outside a component.
pub(crate) struct Answer {
    pub(crate) outcome: Outcome,
    /// Exact bytes of the result.
    pub(crate) value: Vec<u8>,
    pub(crate) text: String,
    pub(crate) stamp_ns: u64,
    pub(crate) may_still_run: bool,
}

impl Answer {
    pub(crate) fn unbound() -> Answer {
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
        value: as_bytes(&ret)[..ret_bytes].to_vec(),
        text: sentence(&raw mut err),
        stamp_ns: opts.stamp_ns,
        may_still_run: opts.may_still_run != 0,
    }
}

impl CommandTarget {
    /// A call from outside; `arg` has the command's argument type. Blocks until the deadline unless `send`.
    pub(crate) fn answer(&self, arg: &[u8], ret_bytes: usize, send: bool, deadline_ns: u64) -> Answer {
        // The time a request may wait for its answer says nothing about a command that is only sent.
        let (mode, deadline_ns) = if send { (MODE_SEND, 0) } else { (MODE_CALL, deadline_ns) };
        answer(arg, ret_bytes, mode, deadline_ns, |arg, ret, opts| self.call(arg, ret, Some(opts)))
    }
}

impl ReadTarget {
    /// A read from outside; `arg` has the command's argument type. Waits for nothing; but a class's own code
    /// may never return.
    pub(crate) fn answer(&self, arg: &[u8], ret_bytes: usize) -> Answer {
        answer(arg, ret_bytes, MODE_CALL, 0, |arg, ret, opts| self.call(arg, ret, Some(opts)))
    }
}
