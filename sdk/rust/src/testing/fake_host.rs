//! The bench's host table: a virtual clock, recorded service requests, wishes for other ports, threads for
//! slices.
//!
//! Invariant: everything is behind atomics or a lock, because a component may use the host from its own
//! threads.

use super::callbacks::Callbacks;
use super::{alloc, parallel};
use core::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use trocar_plugin_api::abi::{self, Bytes, HostTable, Keep, Outcome, Parallel};

/// When the virtual clock begins: 1 s, so that no stamp is 0.
const CLOCK_BEGIN_NS: u64 = 1_000_000_000;

/// The table of `trocar.parallel/1`; its context is the host it lies in.
struct Pool(Parallel);

// SAFETY: never written after it was made; its context is a `FakeHost`, which is Sync.
unsafe impl Sync for Pool {}
// SAFETY: as above.
unsafe impl Send for Pool {}

pub(crate) struct FakeHost {
    pub(crate) now_ns: AtomicU64,
    /// Deadline of the latest step.
    pub(crate) deadline_ns: AtomicU64,
    /// When the latest step began.
    pub(crate) stepped_ns: AtomicU64,
    /// The component asked for `describe` and `bind`.
    pub(crate) ports_changed: AtomicBool,
    /// Threads that share slices; 1 = the extension is not there.
    pub(crate) threads: AtomicU32,
    parallel: OnceLock<Box<Pool>>,
    pub(crate) in_step: AtomicBool,
    /// Started and not stopped since.
    pub(crate) active: AtomicBool,
    pub(crate) callbacks: Callbacks,
    pub(crate) services: Mutex<Vec<(u64, String)>>,
    /// The component asked to keep what it was given: handles are left.
    pub(crate) held: AtomicBool,
}

impl FakeHost {
    pub(crate) fn new() -> Box<FakeHost> {
        Box::new(FakeHost {
            now_ns: AtomicU64::new(CLOCK_BEGIN_NS),
            deadline_ns: AtomicU64::new(CLOCK_BEGIN_NS),
            stepped_ns: AtomicU64::new(CLOCK_BEGIN_NS),
            ports_changed: AtomicBool::new(false),
            threads: AtomicU32::new(1),
            parallel: OnceLock::new(),
            in_step: AtomicBool::new(false),
            active: AtomicBool::new(false),
            callbacks: Callbacks::new(),
            services: Mutex::new(Vec::new()),
            held: AtomicBool::new(false),
        })
    }

    /// A table whose context is this host.
    pub(crate) fn table(&self) -> Box<HostTable> {
        Box::new(HostTable {
            struct_size: size_of::<HostTable>() as u32,
            flags: 0,
            abi_major: abi::ABI_MAJOR,
            abi_minor: abi::ABI_MINOR,
            ctx: (self as *const FakeHost).cast_mut().cast(),
            now_ns,
            log,
            service,
            callback_enter,
            callback_leave,
            extension,
            ports_changed,
        })
    }
}

/// # Safety
/// `ctx` is the context of a table of a live `FakeHost`.
unsafe fn fake<'a>(ctx: *mut c_void) -> &'a FakeHost {
    // SAFETY: by the caller's promise.
    unsafe { &*ctx.cast::<FakeHost>() }
}

unsafe extern "C" fn now_ns(ctx: *mut c_void) -> u64 {
    let _quiet = alloc::pause();
    // SAFETY: the table's own context.
    unsafe { fake(ctx) }.now_ns.load(Ordering::Relaxed)
}

unsafe extern "C" fn log(_: *mut c_void, _: u32, _: Bytes, _: Bytes) {}

unsafe extern "C" fn service(ctx: *mut c_void, token: u64, request: Bytes) -> Outcome {
    let _quiet = alloc::pause();
    // SAFETY: the table's own context; the request is readable during the call.
    let (host, text) = unsafe { (fake(ctx), core::slice::from_raw_parts(request.ptr, request.len)) };
    if host.in_step.load(Ordering::Relaxed) {
        return abi::WOULD_BLOCK;
    }
    let text = String::from_utf8_lossy(text).into_owned();
    host.services.lock().unwrap_or_else(PoisonError::into_inner).push((token, text));
    abi::QUEUED
}

unsafe extern "C" fn callback_enter(ctx: *mut c_void) -> Outcome {
    // SAFETY: the table's own context.
    let host = unsafe { fake(ctx) };
    host.callbacks.enter(host.active.load(Ordering::Relaxed))
}

unsafe extern "C" fn callback_leave(ctx: *mut c_void) {
    // SAFETY: the table's own context.
    unsafe { fake(ctx) }.callbacks.leave();
}

unsafe extern "C" fn ports_changed(ctx: *mut c_void) -> Outcome {
    // SAFETY: the table's own context.
    unsafe { fake(ctx) }.ports_changed.store(true, Ordering::Relaxed);
    abi::QUEUED
}

unsafe extern "C" fn extension(ctx: *mut c_void, id: Bytes) -> *const c_void {
    let _quiet = alloc::pause();
    // SAFETY: the table's own context; the id is readable during the call.
    let (host, id) = unsafe { (fake(ctx), core::slice::from_raw_parts(id.ptr, id.len)) };
    if id == abi::KEEP.as_bytes() {
        return (&raw const KEEPER).cast();
    }
    if id != abi::PARALLEL.as_bytes() || host.threads.load(Ordering::Relaxed) < 2 {
        return core::ptr::null();
    }
    let pool = host.parallel.get_or_init(|| Box::new(Pool(parallel::table(host))));
    (&raw const pool.0).cast()
}

static KEEPER: Keep = Keep { struct_size: size_of::<Keep>() as u32, flags: 0, keep };

unsafe extern "C" fn keep(ctx: *mut c_void) {
    // SAFETY: the table's own context.
    unsafe { fake(ctx) }.held.store(true, Ordering::Relaxed);
}
