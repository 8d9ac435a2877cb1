//! Cells behind the bench's inputs and outputs: queues and records.
//!
//! Invariant: only its raw pointer reaches a cell, from the bench between entries and from the component in
//! one.

use super::alloc;
use super::untyped::{Carried, tell};
use core::ffi::c_void;
use core::ptr::null_mut;
use std::collections::{HashMap, VecDeque};
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
    /// Bytes of the header that count.
    pub(crate) header_len: usize,
    pub(crate) bytes: Vec<u8>,
    pub(crate) stamp_ns: u64,
    pub(crate) seq: u64,
}

pub(crate) struct InCell {
    pub(crate) connected: bool,
    pub(crate) stale: bool,
    /// Another reader has the frames, too.
    pub(crate) shared: bool,
    /// Depth of the queue; 0 = latest value only.
    pub(crate) fifo: usize,
    pub(crate) pushed: u64,
    latest: Option<Pushed>,
    queue: VecDeque<Pushed>,
    held: Option<Pushed>,
    seen: u64,
    /// The type of the peer of an untyped input.
    carried: Option<Carried>,
    /// Counts the peers an untyped input had.
    peers: u32,
}

impl InCell {
    pub(crate) fn new(fifo: usize) -> InCell {
        InCell {
            connected: true,
            stale: false,
            shared: false,
            fifo,
            pushed: 0,
            latest: None,
            queue: VecDeque::new(),
            held: None,
            seen: 0,
            carried: None,
            peers: 0,
        }
    }

    /// Sets the type that the peer of an untyped input writes from now on. Samples of an earlier peer's type
    /// are gone.
    pub(crate) fn carry(&mut self, carried: Carried) {
        if self.carried.as_ref() != Some(&carried) {
            self.peers += 1;
            self.latest = None;
            self.queue.clear();
            self.carried = Some(carried);
        }
    }

    /// Like a host's queue, a full one drops its oldest.
    pub(crate) fn push(&mut self, header: &[u8], bytes: &[u8], stamp_ns: u64) {
        self.pushed += 1;
        let sample = Pushed {
            header: Aligned::of(header),
            header_len: header.len(),
            bytes: bytes.to_vec(),
            stamp_ns,
            seq: self.pushed,
        };
        if self.queue.len() >= self.fifo.max(1) {
            self.queue.pop_front();
        }
        self.queue.push_back(sample.clone());
        self.latest = Some(sample);
        self.stale = false;
    }

    /// Gives the sample pushed last another stamp.
    pub(crate) fn stamp_last(&mut self, stamp_ns: u64) {
        let queued = self.queue.back_mut();
        queued.into_iter().chain(self.latest.as_mut()).for_each(|sample| sample.stamp_ns = stamp_ns);
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
        view.token = token(self.peers, held.header_len);
        IN_SAMPLE
    }

    pub(crate) fn slot(this: *mut InCell) -> InSlot {
        unsafe extern "C" fn latest(ctx: *mut c_void, view: *mut SampleView) -> i32 {
            let _quiet = alloc::pause();
            // SAFETY: the slot's own cell, entered by one thread; the view is the caller's.
            unsafe { (*ctx.cast::<InCell>()).give(&mut *view, false) }
        }
        unsafe extern "C" fn next(ctx: *mut c_void, view: *mut SampleView) -> i32 {
            let _quiet = alloc::pause();
            // SAFETY: as in `latest`.
            unsafe { (*ctx.cast::<InCell>()).give(&mut *view, true) }
        }
        unsafe extern "C" fn release(ctx: *mut c_void) {
            let _quiet = alloc::pause();
            // SAFETY: as in `latest`.
            unsafe { (*ctx.cast::<InCell>()).held = None }
        }
        unsafe extern "C" fn writable(ctx: *mut c_void, _: *mut SampleView) -> *mut u8 {
            let _quiet = alloc::pause();
            // SAFETY: as in `latest`; the held copy is the bench's own, so its only owner is this input.
            let cell = unsafe { &mut *ctx.cast::<InCell>() };
            match &mut cell.held {
                Some(held) if !cell.shared => held.bytes.as_mut_ptr(),
                _ => null_mut(),
            }
        }
        unsafe extern "C" fn header_len(ctx: *mut c_void) -> u64 {
            let _quiet = alloc::pause();
            // SAFETY: as in `latest`.
            unsafe { &(*ctx.cast::<InCell>()).held }.as_ref().map_or(0, |held| held.header_len as u64)
        }
        unsafe extern "C" fn hold(ctx: *mut c_void, held: *mut Held) -> i32 {
            unsafe extern "C" fn release(token: u64) {
                let _quiet = alloc::pause();
                // SAFETY: the copy below, which comes back once.
                drop(unsafe { Box::from_raw(token as *mut Vec<u8>) });
            }
            let _quiet = alloc::pause();
            // SAFETY: as in `latest`; the room is the caller's.
            let (cell, held) = unsafe { (&*ctx.cast::<InCell>(), &mut *held) };
            let Some(frame) = cell.held.as_ref().filter(|held| !held.bytes.is_empty()) else {
                return IN_EMPTY;
            };
            let kept = Box::new(frame.bytes.clone());
            held.bytes = kept.as_ptr();
            held.len = kept.len() as u64;
            held.release = release;
            held.token = Box::into_raw(kept) as u64;
            IN_SAMPLE
        }
        unsafe extern "C" fn type_of(ctx: *mut c_void, sink: *const Sink) -> Status {
            // SAFETY: as in `latest`; the sink is the caller's.
            unsafe {
                let cell = &*ctx.cast::<InCell>();
                tell(cell.carried.as_ref().filter(|_| cell.connected).map(|c| c.text.as_str()), sink)
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
            type_of,
            header_len,
            hold,
        }
    }
}

/// Stands for the peer a sample came from; below it the size of its header, which `forward` compares.
fn token(peers: u32, header_len: usize) -> u64 {
    u64::from(peers + 1) << 32 | header_len as u64
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
