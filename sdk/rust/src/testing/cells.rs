//! What stands behind the bench's slots: queues for inputs, records for outputs, functions and events.
//!
//! Invariant: a cell is reached by its raw pointer only, from the bench between entries and from the component in one.

use crate::stubs;
use core::ffi::c_void;
use core::ptr::null_mut;
use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use trocar_plugin_api::abi::*;

/// Bytes at an address that suits every payload.
#[derive(Clone)]
pub(crate) struct Aligned(Vec<u64>);

impl Aligned {
    pub(crate) fn of(bytes: &[u8]) -> Aligned {
        let words = bytes.chunks(8).map(|c| {
            let mut word = [0; 8];
            word[..c.len()].copy_from_slice(c);
            u64::from_ne_bytes(word)
        });
        Aligned(words.collect())
    }

    fn ptr(&self) -> *const c_void {
        self.0.as_ptr().cast()
    }

    /// The first `len` bytes.
    fn bytes(&self, len: usize) -> Vec<u8> {
        self.0.iter().flat_map(|w| w.to_ne_bytes()).take(len).collect()
    }
}

#[derive(Clone)]
pub(crate) struct Pushed {
    pub(crate) header: Aligned,
    pub(crate) bytes: Vec<u8>,
    pub(crate) stamp_ns: u64,
    pub(crate) seq: u64,
}

pub(crate) struct InCell {
    pub(crate) connected: bool,
    pub(crate) stale: bool,
    /// Depth of the queue; 0 = latest value only.
    pub(crate) fifo: usize,
    pub(crate) pushed: u64,
    latest: Option<Pushed>,
    queue: VecDeque<Pushed>,
    held: Option<Pushed>,
    seen: u64,
}

impl InCell {
    pub(crate) fn new(fifo: usize) -> InCell {
        InCell {
            connected: true,
            stale: false,
            fifo,
            pushed: 0,
            latest: None,
            queue: VecDeque::new(),
            held: None,
            seen: 0,
        }
    }

    /// Like a host's queue, a full one drops its oldest.
    pub(crate) fn push(&mut self, header: &[u8], bytes: &[u8], stamp_ns: u64) {
        self.pushed += 1;
        let sample =
            Pushed { header: Aligned::of(header), bytes: bytes.to_vec(), stamp_ns, seq: self.pushed };
        if self.queue.len() >= self.fifo.max(1) {
            self.queue.pop_front();
        }
        self.queue.push_back(sample.clone());
        self.latest = Some(sample);
        self.stale = false;
    }

    fn give(&mut self, view: &mut SampleView, next: bool) -> i32 {
        if !self.connected {
            return IN_UNBOUND;
        }
        let sample = if next { self.queue.pop_front() } else { self.latest.clone() };
        let Some(sample) = sample else { return IN_EMPTY };
        let fresh = sample.seq > self.seen;
        self.seen = self.seen.max(sample.seq);
        let held = self.held.insert(sample);
        view.flags = if fresh { SAMPLE_FRESH } else { 0 } | if self.stale { SAMPLE_STALE } else { 0 };
        view.header = held.header.ptr();
        view.bytes = held.bytes.as_ptr();
        view.len = held.bytes.len() as u64;
        view.stamp_ns = held.stamp_ns;
        view.seq = held.seq;
        IN_SAMPLE
    }

    pub(crate) fn slot(this: *mut InCell) -> InSlot {
        unsafe extern "C" fn latest(ctx: *mut c_void, view: *mut SampleView) -> i32 {
            // SAFETY: the slot's own cell, entered by one thread; the view is the caller's.
            unsafe { (*ctx.cast::<InCell>()).give(&mut *view, false) }
        }
        unsafe extern "C" fn next(ctx: *mut c_void, view: *mut SampleView) -> i32 {
            // SAFETY: as in `latest`.
            unsafe { (*ctx.cast::<InCell>()).give(&mut *view, true) }
        }
        unsafe extern "C" fn release(ctx: *mut c_void) {
            // SAFETY: as in `latest`.
            unsafe { (*ctx.cast::<InCell>()).held = None }
        }
        unsafe extern "C" fn writable(ctx: *mut c_void, _: *mut SampleView) -> *mut u8 {
            // SAFETY: as in `latest`; the held copy is the bench's own, so its only owner is this input.
            match unsafe { &mut (*ctx.cast::<InCell>()).held } {
                Some(held) => held.bytes.as_mut_ptr(),
                None => null_mut(),
            }
        }
        InSlot {
            struct_size: size_of::<InSlot>() as u32,
            flags: 0,
            ctx: this.cast(),
            latest,
            next,
            release,
            writable,
            type_of: stubs::type_of,
        }
    }
}

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
    loans: HashMap<u64, (Aligned, Vec<u8>)>,
    lent: u64,
}

impl OutCell {
    pub(crate) fn new(header_size: usize, max_bytes: usize) -> OutCell {
        OutCell {
            connected: true,
            exhausted: false,
            header_size,
            max_bytes,
            written: Vec::new(),
            loans: HashMap::new(),
            lent: 0,
        }
    }

    fn lend(&mut self, loan: &mut Loan) -> Outcome {
        if self.exhausted || self.max_bytes == 0 {
            return EXHAUSTED;
        }
        self.lent += 1;
        let memory = (Aligned::of(&vec![0; self.header_size]), vec![0; self.max_bytes]);
        let memory = self.loans.entry(self.lent).insert_entry(memory).into_mut();
        loan.header = memory.0.0.as_mut_ptr().cast();
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
        unsafe extern "C" fn write(ctx: *mut c_void, value: *const c_void, stamp_ns: u64) -> Outcome {
            // SAFETY: the slot's own cell; the value has the described size, which the bench took from the class.
            unsafe {
                let cell = &mut *ctx.cast::<OutCell>();
                let header = core::slice::from_raw_parts(value.cast::<u8>(), cell.header_size).to_vec();
                cell.written.push(Written { header, bytes: Vec::new(), stamp_ns });
                cell.answer()
            }
        }
        unsafe extern "C" fn loan(ctx: *mut c_void, loan: *mut Loan) -> Outcome {
            // SAFETY: the slot's own cell; the loan is the caller's.
            unsafe { (*ctx.cast::<OutCell>()).lend(&mut *loan) }
        }
        unsafe extern "C" fn commit(ctx: *mut c_void, loan: *mut Loan, len: u64, stamp_ns: u64) -> Outcome {
            // SAFETY: as in `loan`.
            unsafe { (*ctx.cast::<OutCell>()).commit(&*loan, len, stamp_ns) }
        }
        unsafe extern "C" fn cancel(ctx: *mut c_void, loan: *mut Loan) {
            // SAFETY: as in `loan`.
            unsafe { (*ctx.cast::<OutCell>()).loans.remove(&(*loan).token) };
        }
        unsafe extern "C" fn forward(ctx: *mut c_void, sample: *const SampleView, stamp_ns: u64) -> Outcome {
            // SAFETY: the slot's own cell; the view is held by an input cell of the same described type.
            unsafe {
                let (cell, view) = (&mut *ctx.cast::<OutCell>(), &*sample);
                let header = core::slice::from_raw_parts(view.header.cast::<u8>(), cell.header_size).to_vec();
                let bytes = core::slice::from_raw_parts(view.bytes, view.len as usize).to_vec();
                cell.written.push(Written { header, bytes, stamp_ns });
                cell.answer()
            }
        }
        unsafe extern "C" fn reserve(ctx: *mut c_void, max_bytes: u64, _: u32) -> Outcome {
            // SAFETY: the slot's own cell.
            unsafe { (*ctx.cast::<OutCell>()).max_bytes = max_bytes as usize };
            EXECUTED
        }
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
            type_of: stubs::type_of,
        }
    }
}

/// A fake peer's answer: the bytes of the result, or its outcome and reason.
pub(crate) type Answer = Box<dyn FnMut(&[u8]) -> Result<Vec<u8>, (Outcome, String)>>;

pub(crate) struct FnCell {
    pub(crate) connected: bool,
    arg_size: usize,
    ret_size: usize,
    pub(crate) calls: Vec<Vec<u8>>,
    pub(crate) answer: Option<Answer>,
}

impl FnCell {
    pub(crate) fn new(arg_size: usize, ret_size: usize) -> FnCell {
        FnCell { connected: true, arg_size, ret_size, calls: Vec::new(), answer: None }
    }

    /// # Safety
    /// `arg` and `ret` have the described sizes or are null, `opts` is null or valid.
    unsafe fn call(&mut self, arg: *const c_void, ret: *mut c_void, opts: *mut CallOpts) -> Outcome {
        if !self.connected {
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
            // SAFETY: the slot's own cell; the sizes come from the class's description.
            unsafe { (*ctx.cast::<FnCell>()).call(arg, ret, opts) }
        }
        FnSlot {
            struct_size: size_of::<FnSlot>() as u32,
            flags: 0,
            ctx: this.cast(),
            call,
            type_of: stubs::type_of,
        }
    }
}

pub(crate) struct EventCell {
    size: usize,
    pub(crate) emitted: Vec<Vec<u8>>,
}

impl EventCell {
    pub(crate) fn new(size: usize) -> EventCell {
        EventCell { size, emitted: Vec::new() }
    }

    pub(crate) fn slot(this: *mut EventCell) -> EventSlot {
        unsafe extern "C" fn emit(ctx: *mut c_void, payload: *const c_void) -> Outcome {
            // SAFETY: the slot's own cell; the payload has the described size or is null for an empty one.
            unsafe {
                let cell = &mut *ctx.cast::<EventCell>();
                let size = if payload.is_null() { 0 } else { cell.size };
                let bytes = match size {
                    0 => Vec::new(),
                    size => core::slice::from_raw_parts(payload.cast::<u8>(), size).to_vec(),
                };
                cell.emitted.push(bytes);
            }
            EXECUTED
        }
        EventSlot { struct_size: size_of::<EventSlot>() as u32, flags: 0, ctx: this.cast(), emit }
    }
}
