//! Cells behind the inputs on the bench: queues of what the test pushed.
//!
//! Invariant: only its raw pointer reaches a cell, from the bench between entries and from the component in
//! one.

use super::aligned_bytes::Aligned;
use super::alloc;
use super::carried::{Carried, tell};
use core::ffi::c_void;
use core::ptr::null_mut;
use std::collections::VecDeque;
use trocar_plugin_api::abi::*;

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
