//! Cells behind the outputs on the bench: records of what the component wrote.
//!
//! Invariant: only its raw pointer reaches a cell, from the bench between entries and from the component in
//! one.

use super::aligned_bytes::Aligned;
use super::alloc;
use super::carried::{Carried, tell};
use core::ffi::c_void;
use std::collections::HashMap;
use trocar_plugin_api::abi::*;

/// One written sample or committed frame.
pub(crate) struct Written {
    pub(crate) header: Vec<u8>,
    pub(crate) bytes: Vec<u8>,
    pub(crate) stamp_ns: u64,
}

pub(crate) struct OutCell {
    pub(crate) connected: bool,
    pub(crate) exhausted: bool,
    header_size: usize,
    max_bytes: usize,
    pub(crate) written: Vec<Written>,
    /// Number of these that the history knows.
    pub(crate) told: usize,
    loans: HashMap<u64, (Aligned, Vec<u8>)>,
    lent: u64,
    /// The output is untyped: it is connected to nobody while no peer has given it a type.
    untyped: bool,
    carried: Option<Carried>,
}

impl OutCell {
    pub(crate) fn new(header_size: usize, max_bytes: usize, untyped: bool) -> OutCell {
        OutCell {
            connected: true,
            exhausted: false,
            header_size,
            max_bytes,
            written: Vec::new(),
            told: 0,
            loans: HashMap::new(),
            lent: 0,
            untyped,
            carried: None,
        }
    }

    /// The peer of an untyped output takes this from now on.
    pub(crate) fn carry(&mut self, carried: Carried) {
        self.header_size = carried.size;
        self.carried = Some(carried);
    }

    pub(crate) fn carried(&self) -> Option<&Carried> {
        self.carried.as_ref()
    }

    fn alone(&self) -> bool {
        self.untyped && self.carried.is_none()
    }

    fn lend(&mut self, loan: &mut Loan) -> Outcome {
        if self.exhausted || self.max_bytes == 0 {
            return EXHAUSTED;
        }
        self.lent += 1;
        let memory = (Aligned::of(&vec![0; self.header_size]), vec![0; self.max_bytes]);
        let memory = self.loans.entry(self.lent).insert_entry(memory).into_mut();
        loan.header = memory.0.ptr_mut();
        loan.bytes = memory.1.as_mut_ptr();
        loan.capacity = memory.1.len() as u64;
        loan.token = self.lent;
        EXECUTED
    }

    fn commit(&mut self, loan: &Loan, len: u64, stamp_ns: u64) -> Outcome {
        let Some((header, mut bytes)) = self.loans.remove(&loan.token) else { return INVALID_ARGUMENT };
        bytes.truncate(len as usize);
        self.written.push(Written { header: header.bytes(self.header_size), bytes, stamp_ns });
        self.answer()
    }

    fn answer(&self) -> Outcome {
        if self.connected { EXECUTED } else { UNBOUND }
    }

    pub(crate) fn slot(this: *mut OutCell) -> OutSlot {
        OutSlot {
            struct_size: size_of::<OutSlot>() as u32,
            flags: 0,
            ctx: this.cast(),
            write,
            loan,
            commit,
            cancel,
            forward,
            reserve,
            type_of,
            write_bytes,
        }
    }
}

unsafe extern "C" fn write(ctx: *mut c_void, value: *const c_void, stamp_ns: u64) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell; the value has the described size, which the bench took from the
    // class.
    unsafe {
        let cell = &mut *ctx.cast::<OutCell>();
        let header = core::slice::from_raw_parts(value.cast::<u8>(), cell.header_size).to_vec();
        cell.written.push(Written { header, bytes: Vec::new(), stamp_ns });
        cell.answer()
    }
}

unsafe extern "C" fn loan(ctx: *mut c_void, loan: *mut Loan) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell; the loan is the caller's.
    unsafe { (*ctx.cast::<OutCell>()).lend(&mut *loan) }
}

unsafe extern "C" fn commit(ctx: *mut c_void, loan: *mut Loan, len: u64, stamp_ns: u64) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: as in `loan`.
    unsafe { (*ctx.cast::<OutCell>()).commit(&*loan, len, stamp_ns) }
}

unsafe extern "C" fn cancel(ctx: *mut c_void, loan: *mut Loan) {
    let _quiet = alloc::pause();
    // SAFETY: as in `loan`.
    unsafe { (*ctx.cast::<OutCell>()).loans.remove(&(*loan).token) };
}

unsafe extern "C" fn forward(ctx: *mut c_void, sample: *const SampleView, stamp_ns: u64) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell; the view is held by an input cell of the same described type.
    unsafe {
        let (cell, view) = (&mut *ctx.cast::<OutCell>(), &*sample);
        if cell.alone() {
            return UNBOUND;
        }
        if view.token as u32 as usize != cell.header_size {
            return INVALID_ARGUMENT;
        }
        let header = core::slice::from_raw_parts(view.header.cast::<u8>(), cell.header_size).to_vec();
        let bytes = core::slice::from_raw_parts(view.bytes, view.len as usize).to_vec();
        cell.written.push(Written { header, bytes, stamp_ns });
        cell.answer()
    }
}

unsafe extern "C" fn reserve(ctx: *mut c_void, max_bytes: u64, _: u32) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell.
    unsafe { (*ctx.cast::<OutCell>()).max_bytes = max_bytes as usize };
    EXECUTED
}

unsafe extern "C" fn write_bytes(ctx: *mut c_void, value: Bytes, stamp_ns: u64) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell; the value has the size it says.
    unsafe {
        let cell = &*ctx.cast::<OutCell>();
        match value.len {
            _ if cell.alone() => UNBOUND,
            len if len == cell.header_size => write(ctx, value.ptr.cast(), stamp_ns),
            _ => INVALID_ARGUMENT,
        }
    }
}

unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
    let _quiet = alloc::pause();
    // SAFETY: the slot's own cell; the sink is the caller's.
    unsafe {
        let cell = &*ctx.cast::<OutCell>();
        tell(cell.carried.as_ref().filter(|_| cell.connected).map(|c| c.text.as_str()), sink)
    }
}
