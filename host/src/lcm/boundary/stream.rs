//! Outputs and inputs: the slots through which samples and frames pass.
//!
//! Invariant: an output never waits for a reader; a sample an input shows stays valid until the next `latest`, `next` or
//! `release` on it, even when the connection is cut meanwhile (the input keeps the link it shows from alive).

use std::cell::UnsafeCell;
use std::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_plugin_api::abi::{
    EXECUTED, EXHAUSTED, FAILED, IN_EMPTY, IN_SAMPLE, IN_UNBOUND, INVALID_ARGUMENT, Loan, Outcome,
    SAMPLE_FRESH, SAMPLE_STALE, STATUS_UNSUPPORTED, SampleView, Sink, Status, UNBOUND, WOULD_BLOCK,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::os;
use trocar_rt::pool::{Frame, FrameMut, FramePool};
use trocar_rt::stream::{Meta, Sample, StreamReader, StreamWriter};
use trocar_rt::timing::Histogram;

use super::super::context;
use super::super::instance::Instance;

/// The producer's end of one connection.
pub(in crate::lcm) struct OutLink {
    /// The connection; 0 for readers from outside.
    pub(in crate::lcm) connection: u64,
    writer: StreamWriter,
    consumer: Option<Arc<Instance>>,
}

impl OutLink {
    pub(in crate::lcm) fn new(
        connection: u64,
        writer: StreamWriter,
        consumer: Option<Arc<Instance>>,
    ) -> Self {
        OutLink { connection, writer, consumer }
    }
}

/// Host cell behind an output slot.
pub(in crate::lcm) struct OutCell {
    pub(in crate::lcm) links: BindingCell<Vec<Arc<OutLink>>>,
    pool: BindingCell<Option<Arc<FramePool>>>,
    /// Bytes of a plain sample or of a frame's header.
    pub(in crate::lcm) bytes: usize,
    pub(in crate::lcm) frame: bool,
    /// Writes so far.
    pub(in crate::lcm) seq: AtomicU64,
    /// Bytes so far, headers included.
    pub(in crate::lcm) total_bytes: AtomicU64,
}

impl OutCell {
    pub(in crate::lcm) fn new(bytes: usize, frame: bool) -> Self {
        OutCell {
            links: BindingCell::new(Box::new(Vec::new())),
            pool: BindingCell::new(Box::new(None)),
            bytes,
            frame,
            seq: AtomicU64::new(0),
            total_bytes: AtomicU64::new(0),
        }
    }

    /// Adds or removes links; managers only.
    pub(in crate::lcm) fn edit(&self, f: impl FnOnce(&mut Vec<Arc<OutLink>>)) {
        let mut links = self.links.enter().clone();
        f(&mut links);
        self.links.swap(Box::new(links));
    }

    /// (Re)makes the pool; not from `step`.
    pub(in crate::lcm) fn reserve(&self, max_bytes: usize, slots: usize) -> Outcome {
        match FramePool::new(slots as u32, self.bytes, max_bytes) {
            Ok(pool) => {
                self.pool.swap(Box::new(Some(pool)));
                EXECUTED
            }
            Err(e) => {
                log::error!("a pool of {slots} frames of {max_bytes} bytes cannot be made: {e}");
                EXHAUSTED
            }
        }
    }

    /// Frames a loan was refused for.
    pub(in crate::lcm) fn exhausted(&self) -> u64 {
        self.pool.enter().as_ref().map_or(0, |p| p.stats().exhausted)
    }

    fn next_meta(&self, stamp_ns: u64, bytes: usize) -> Meta {
        let seq = self.seq.load(Ordering::Relaxed) + 1;
        self.seq.store(seq, Ordering::Relaxed);
        self.total_bytes.store(self.total_bytes.load(Ordering::Relaxed) + bytes as u64, Ordering::Relaxed);
        Meta { stamp_ns: if stamp_ns == 0 { os::now_ns() } else { stamp_ns }, seq }
    }

    fn each_link(&self, f: impl Fn(&StreamWriter)) -> Outcome {
        let links = self.links.enter();
        for link in links.iter() {
            f(&link.writer);
            if let Some(consumer) = &link.consumer {
                consumer.signal();
            }
        }
        if links.is_empty() { UNBOUND } else { EXECUTED }
    }

    fn publish(&self, frame: Frame, stamp_ns: u64) -> Outcome {
        let meta = self.next_meta(stamp_ns, self.bytes + frame.bytes().len());
        self.each_link(|writer| {
            writer.push_frame(frame.clone(), meta);
        })
    }
}

/// SAFETY of all `extern "C"` below: `ctx` is the cell whose slot the function stands in; it lives as long as the
/// instance that owns the slots. Pointers handed over live for the call.
fn out_cell<'a>(ctx: *mut c_void) -> &'a OutCell {
    // SAFETY: see above.
    unsafe { &*ctx.cast::<OutCell>() }
}

pub(super) unsafe extern "C" fn write(ctx: *mut c_void, value: *const c_void, stamp_ns: u64) -> Outcome {
    let cell = out_cell(ctx);
    if cell.frame {
        return INVALID_ARGUMENT;
    }
    // SAFETY: the caller lends a value of the output's type.
    let value = unsafe { std::slice::from_raw_parts(value.cast::<u8>(), cell.bytes) };
    let meta = cell.next_meta(stamp_ns, cell.bytes);
    cell.each_link(|writer| {
        writer.push(value, meta);
    })
}

pub(super) unsafe extern "C" fn loan(ctx: *mut c_void, loan: *mut Loan) -> Outcome {
    let cell = out_cell(ctx);
    let pool = cell.pool.enter();
    let Some(frame) = pool.as_ref().and_then(|p| p.loan()) else { return EXHAUSTED };
    let lent = Loan {
        struct_size: size_of::<Loan>() as u32,
        flags: 0,
        header: frame.header_ptr().cast(),
        bytes: frame.bytes_ptr(),
        capacity: frame.capacity() as u64,
        token: frame.into_raw(),
    };
    // SAFETY: the caller lends room for a Loan.
    unsafe { loan.write(lent) };
    EXECUTED
}

pub(super) unsafe extern "C" fn commit(
    ctx: *mut c_void,
    loan: *mut Loan,
    len: u64,
    stamp_ns: u64,
) -> Outcome {
    // SAFETY: the caller hands back the Loan it got from `loan`.
    let loan = unsafe { &mut *loan };
    if loan.token == 0 {
        return INVALID_ARGUMENT;
    }
    // SAFETY: the token came from `into_raw` in `loan` and is used once: it is cleared here.
    let Some(frame) = (unsafe { FrameMut::from_raw(std::mem::take(&mut loan.token)) }) else {
        return INVALID_ARGUMENT;
    };
    if len > frame.capacity() as u64 {
        return INVALID_ARGUMENT;
    }
    out_cell(ctx).publish(frame.freeze(len as usize), stamp_ns)
}

pub(super) unsafe extern "C" fn cancel(_ctx: *mut c_void, loan: *mut Loan) {
    // SAFETY: as in `commit`.
    let loan = unsafe { &mut *loan };
    if loan.token != 0 {
        // SAFETY: as in `commit`.
        drop(unsafe { FrameMut::from_raw(std::mem::take(&mut loan.token)) });
    }
}

pub(super) unsafe extern "C" fn forward(ctx: *mut c_void, view: *const SampleView, stamp_ns: u64) -> Outcome {
    let cell = out_cell(ctx);
    // SAFETY: the caller lends the view an input filled; its token is the link that input keeps alive.
    let Some(link) = (unsafe { ((*view).token as *const InLink).as_ref() }) else { return INVALID_ARGUMENT };
    // SAFETY: only the component's thread, which holds the view, reads this link.
    let Some(frame) = (unsafe { (*link.reader.get()).frame() }) else { return INVALID_ARGUMENT };
    if !cell.frame || frame.header().len() != cell.bytes {
        return INVALID_ARGUMENT;
    }
    cell.publish(frame.clone(), stamp_ns)
}

pub(super) unsafe extern "C" fn reserve(ctx: *mut c_void, max_bytes: u64, slots: u32) -> Outcome {
    let cell = out_cell(ctx);
    if context::stepping() {
        return WOULD_BLOCK;
    }
    if !cell.frame {
        return FAILED;
    }
    cell.reserve(max_bytes as usize, slots.clamp(2, 4096) as usize)
}

pub(super) unsafe extern "C" fn type_of(_ctx: *mut c_void, _sink: *const Sink) -> Status {
    STATUS_UNSUPPORTED
}

/// The consumer's end of one connection.
pub(in crate::lcm) struct InLink {
    reader: UnsafeCell<StreamReader>,
    /// Older samples are stale, ns; 0 = never.
    max_age_ns: u64,
    /// Age of samples when first shown, ns.
    pub(in crate::lcm) latency: Histogram,
}

// SAFETY: the reader is used only by the consuming component's thread, one at a time; `latency` is lock-free.
unsafe impl Sync for InLink {}
// SAFETY: as above.
unsafe impl Send for InLink {}

impl InLink {
    pub(in crate::lcm) fn new(reader: StreamReader, max_age_ns: u64) -> Self {
        InLink { reader: UnsafeCell::new(reader), max_age_ns, latency: Histogram::new() }
    }
}

/// Host cell behind an input slot.
pub(in crate::lcm) struct InCell {
    pub(in crate::lcm) link: BindingCell<Option<Arc<InLink>>>,
    /// The link the last view came from.
    held: UnsafeCell<Option<Arc<InLink>>>,
}

// SAFETY: `held` is used only by the component's thread, one at a time.
unsafe impl Sync for InCell {}
// SAFETY: as above.
unsafe impl Send for InCell {}

impl InCell {
    pub(in crate::lcm) fn new() -> Self {
        InCell { link: BindingCell::new(Box::new(None)), held: UnsafeCell::new(None) }
    }

    /// Takes the present link and shows what `pick` finds there. Component's thread only.
    fn show(
        &self,
        view: *mut SampleView,
        pick: for<'r> fn(&'r mut StreamReader) -> Option<Sample<'r>>,
    ) -> i32 {
        // SAFETY: component's thread only.
        let held = unsafe { &mut *self.held.get() };
        {
            let now = self.link.enter();
            match &*now {
                None => {
                    *held = None;
                    return IN_UNBOUND;
                }
                Some(link) if !held.as_ref().is_some_and(|h| Arc::ptr_eq(h, link)) => {
                    *held = Some(link.clone())
                }
                Some(_) => {}
            }
        }
        let Some(link) = held.as_ref() else { return IN_UNBOUND };
        // SAFETY: component's thread only.
        let reader = unsafe { &mut *link.reader.get() };
        let Some(sample) = pick(reader) else { return IN_EMPTY };
        let mut flags = 0;
        if sample.fresh || link.max_age_ns > 0 {
            let age = os::now_ns().saturating_sub(sample.meta.stamp_ns);
            if sample.fresh {
                flags |= SAMPLE_FRESH;
                link.latency.record(age);
            }
            if link.max_age_ns > 0 && age > link.max_age_ns {
                flags |= SAMPLE_STALE;
            }
        }
        let shown = SampleView {
            struct_size: size_of::<SampleView>() as u32,
            flags,
            header: sample.data.as_ptr().cast(),
            bytes: sample.bytes.as_ptr(),
            len: sample.bytes.len() as u64,
            stamp_ns: sample.meta.stamp_ns,
            seq: sample.meta.seq,
            token: Arc::as_ptr(link) as u64,
        };
        // SAFETY: the caller lends room for a SampleView.
        unsafe { view.write(shown) };
        IN_SAMPLE
    }
}

fn in_cell<'a>(ctx: *mut c_void) -> &'a InCell {
    // SAFETY: see `out_cell`.
    unsafe { &*ctx.cast::<InCell>() }
}

pub(super) unsafe extern "C" fn latest(ctx: *mut c_void, view: *mut SampleView) -> i32 {
    in_cell(ctx).show(view, StreamReader::latest)
}

pub(super) unsafe extern "C" fn next(ctx: *mut c_void, view: *mut SampleView) -> i32 {
    in_cell(ctx).show(view, StreamReader::next)
}

pub(super) unsafe extern "C" fn release(ctx: *mut c_void) {
    // SAFETY: component's thread only.
    if let Some(link) = unsafe { &*in_cell(ctx).held.get() } {
        // SAFETY: component's thread only.
        unsafe { (*link.reader.get()).release() };
    }
}

pub(super) unsafe extern "C" fn writable(ctx: *mut c_void, _view: *mut SampleView) -> *mut u8 {
    // SAFETY: component's thread only.
    let Some(link) = (unsafe { &*in_cell(ctx).held.get() }) else { return std::ptr::null_mut() };
    // SAFETY: component's thread only.
    match unsafe { (*link.reader.get()).frame() } {
        // The only owner may write: nobody else can take a reference but through us.
        Some(frame) if frame.is_unique() => frame.bytes().as_ptr().cast_mut(),
        _ => std::ptr::null_mut(),
    }
}
