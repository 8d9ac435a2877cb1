//! The bench's host table: a virtual clock, recorded log lines and service requests.
//!
//! Invariant: everything is behind atomics or a lock, because a component may use the host from its own threads.

use core::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use trocar_plugin_api::abi::{self, Bytes, HostTable, Outcome};

/// When the virtual clock begins: 1 s, so that no stamp is 0.
const CLOCK_BEGIN_NS: u64 = 1_000_000_000;

pub(crate) struct FakeHost {
    pub(crate) now_ns: AtomicU64,
    pub(crate) in_step: AtomicBool,
    pub(crate) services: Mutex<Vec<(u64, String)>>,
}

impl FakeHost {
    pub(crate) fn new() -> Box<FakeHost> {
        Box::new(FakeHost {
            now_ns: AtomicU64::new(CLOCK_BEGIN_NS),
            in_step: AtomicBool::new(false),
            services: Mutex::new(Vec::new()),
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
    // SAFETY: the table's own context.
    unsafe { fake(ctx) }.now_ns.load(Ordering::Relaxed)
}

unsafe extern "C" fn log(_: *mut c_void, _: u32, _: Bytes, _: Bytes) {}

unsafe extern "C" fn service(ctx: *mut c_void, token: u64, request: Bytes) -> Outcome {
    // SAFETY: the table's own context; the request is readable during the call.
    let (host, text) = unsafe { (fake(ctx), core::slice::from_raw_parts(request.ptr, request.len)) };
    if host.in_step.load(Ordering::Relaxed) {
        return abi::WOULD_BLOCK;
    }
    let text = String::from_utf8_lossy(text).into_owned();
    host.services.lock().unwrap_or_else(PoisonError::into_inner).push((token, text));
    abi::QUEUED
}

unsafe extern "C" fn callback_enter(_: *mut c_void) -> Outcome {
    abi::EXECUTED
}

unsafe extern "C" fn callback_leave(_: *mut c_void) {}

unsafe extern "C" fn ports_changed(_: *mut c_void) -> Outcome {
    abi::QUEUED
}

unsafe extern "C" fn extension(_: *mut c_void, _: Bytes) -> *const c_void {
    core::ptr::null()
}
