//! The slots through which a plugin writes to its outputs.
//!
//! Invariant: data that a plugin hands over are not read before they are known to be whole.

use std::ffi::c_void;

use trocar_plugin_api::abi::{
    Bytes, EXECUTED, EXHAUSTED, FAILED, INVALID_ARGUMENT, Loan, Outcome, SampleView, Sink, Status,
    WOULD_BLOCK,
};

use super::super::super::context;
use super::super::input::{self, Shown};
use super::super::{room, texts};
use super::cell::{OutCell, Outs};

/// SAFETY of all `extern "C"` below: `ctx` is the cell whose slot the function stands in; it lives as long as
/// the instance that owns the slots. Pointers handed over live for the call.
fn out_cell<'a>(ctx: *mut c_void) -> &'a OutCell {
    // SAFETY: see above.
    unsafe { &*ctx.cast::<OutCell>() }
}

pub(crate) unsafe extern "C" fn write(ctx: *mut c_void, value: *const c_void, stamp_ns: u64) -> Outcome {
    let cell = out_cell(ctx);
    cell.outs.look(|outs| {
        if outs.shape.unknown {
            return outs.unbound();
        }
        if outs.shape.frame {
            return INVALID_ARGUMENT;
        }
        // SAFETY: the caller lends a value of the output's type; a caller without a type of its own has asked
        // `type_of`.
        match unsafe { lent(value.cast(), outs.shape.bytes) } {
            Some(value) => cell.publish_plain(outs, value, stamp_ns),
            None => INVALID_ARGUMENT,
        }
    })
}

/// As `write`, but compares the size with the type that is behind the output now.
pub(crate) unsafe extern "C" fn write_bytes(ctx: *mut c_void, value: Bytes, stamp_ns: u64) -> Outcome {
    // SAFETY: the caller lends `len` readable bytes.
    match unsafe { lent(value.ptr, value.len) } {
        Some(value) => out_cell(ctx).forward_plain(value, stamp_ns),
        None => INVALID_ARGUMENT,
    }
}

/// The bytes a caller lends; `None` where it lends none although there should be some, or more than possible.
///
/// # Safety
/// `bytes` readable bytes at `ptr`, unless that is null.
unsafe fn lent<'a>(ptr: *const u8, bytes: usize) -> Option<&'a [u8]> {
    match bytes {
        0 => Some(&[]),
        _ if ptr.is_null() || bytes > isize::MAX as usize => None,
        // SAFETY: the caller's promise.
        _ => Some(unsafe { std::slice::from_raw_parts(ptr, bytes) }),
    }
}

pub(crate) unsafe extern "C" fn loan(ctx: *mut c_void, loan: *mut Loan) -> Outcome {
    let cell = out_cell(ctx);
    // SAFETY: null, or lent for the call.
    if !unsafe { room::is_lent(loan) } {
        return INVALID_ARGUMENT;
    }
    // Frames released by readers in other processes are collected only when one is needed.
    let Some(frame) = cell.pools.loan().or_else(|| {
        cell.collect();
        cell.pools.loan()
    }) else {
        cell.pools.refuse();
        return cell.outs.look(|outs| if outs.is_gone() { outs.unbound() } else { EXHAUSTED });
    };
    let lent = Loan {
        struct_size: size_of::<Loan>() as u32,
        flags: 0,
        header: frame.header_ptr().cast(),
        bytes: frame.bytes_ptr(),
        capacity: frame.capacity() as u64,
        token: frame.into_raw(),
    };
    // SAFETY: lent, as seen above.
    unsafe { room::fill(loan, lent) };
    EXECUTED
}

pub(crate) unsafe extern "C" fn commit(
    ctx: *mut c_void,
    loan: *mut Loan,
    len: u64,
    stamp_ns: u64,
) -> Outcome {
    let cell = out_cell(ctx);
    let Some(frame) = cell.pools.take_back(loan) else { return INVALID_ARGUMENT };
    if len > frame.capacity() as u64 {
        return INVALID_ARGUMENT;
    }
    // The frame may have been lent under another type: `forward_frame` checks that.
    cell.forward_frame(frame.freeze(len as usize), stamp_ns)
}

pub(crate) unsafe extern "C" fn cancel(ctx: *mut c_void, loan: *mut Loan) {
    drop(out_cell(ctx).pools.take_back(loan));
}

pub(crate) unsafe extern "C" fn forward(ctx: *mut c_void, view: *const SampleView, stamp_ns: u64) -> Outcome {
    let cell = out_cell(ctx);
    let Some(token) = input::token_of(view) else { return INVALID_ARGUMENT };
    let forward = |shown: Shown<'_>| cell.forward(shown, stamp_ns);
    // SAFETY: only the component's thread, which holds the view, forwards.
    let passed =
        cell.inputs.look(|inputs| inputs.iter().find_map(|input| unsafe { input.pass_on(token, forward) }));
    passed.unwrap_or(INVALID_ARGUMENT)
}

/// Most frames of a pool.
const MOST_SLOTS: u32 = 4096;

pub(crate) unsafe extern "C" fn reserve(ctx: *mut c_void, max_bytes: u64, slots: u32) -> Outcome {
    let cell = out_cell(ctx);
    if context::stepping() {
        return WOULD_BLOCK;
    }
    let shape = cell.shape();
    if !shape.frame && !shape.unknown {
        return FAILED;
    }
    if shape.unknown {
        return cell.outs.look(Outs::unbound);
    }
    let asked = format!("a pool of {slots} frames of {max_bytes} bytes cannot be made");
    if slots > MOST_SLOTS {
        cell.tell_refused(&format!("{asked}: one has at most {MOST_SLOTS} frames"));
        return INVALID_ARGUMENT;
    }
    match cell.make_pool(max_bytes as usize, slots.max(2)) {
        Ok(()) => EXECUTED,
        Err(e) => {
            cell.tell_refused(&format!("{asked}: {e}"));
            EXHAUSTED
        }
    }
}

pub(crate) unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
    texts::tell(sink, &out_cell(ctx).outs.enter().described)
}
