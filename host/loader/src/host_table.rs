//! The host table a whole plugin gets with `init`: clock and log, no component services.
//!
//! Invariant: lives as long as the process, because a plugin may log from its exit handlers.

use std::ffi::c_void;

use trocar_plugin_api::abi::{Bytes, HostTable, NOT_ACTIVE, Outcome};
use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR, abi};

/// Takes a line a plugin logs outside any instance: plugin name, level (`abi::LOG_*`), target, message. Any
/// thread, also from a `step`, so it must not wait.
pub type LogFn = fn(plugin: &str, level: u32, target: &str, message: &str);

/// Hands plugin lines to the `log` crate.
pub fn log_to_crate(plugin: &str, level: u32, target: &str, message: &str) {
    let level = match level {
        abi::LOG_ERROR => log::Level::Error,
        abi::LOG_WARN => log::Level::Warn,
        abi::LOG_INFO => log::Level::Info,
        abi::LOG_DEBUG => log::Level::Debug,
        _ => log::Level::Trace,
    };
    log::log!(target: "plugin", level, "{plugin}: {target}: {message}");
}

struct Context {
    plugin: String,
    log: LogFn,
}

/// `flags`: 0, or `HOST_LINKED`.
pub(crate) fn for_plugin(plugin: &str, log: LogFn, flags: u32) -> *const HostTable {
    let context = Box::leak(Box::new(Context { plugin: plugin.to_string(), log }));
    Box::leak(Box::new(HostTable {
        struct_size: size_of::<HostTable>() as u32,
        flags,
        abi_major: ABI_MAJOR,
        abi_minor: ABI_MINOR,
        ctx: (&raw mut *context).cast(),
        now_ns,
        log: log_line,
        service,
        callback_enter,
        callback_leave,
        extension,
        ports_changed,
    }))
}

unsafe extern "C" fn now_ns(_ctx: *mut c_void) -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is ours to write; the clock exists on every Linux.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

unsafe extern "C" fn log_line(ctx: *mut c_void, level: u32, target: Bytes, message: Bytes) {
    // SAFETY: `ctx` is the leaked context of this table.
    let context = unsafe { &*ctx.cast::<Context>() };
    // SAFETY: the caller lends both texts for the call.
    let (target, message) = unsafe { (harmless(&target), harmless(&message)) };
    (context.log)(&context.plugin, level, &target, &message);
}

/// # Safety
/// `bytes` is null or readable while it is borrowed.
unsafe fn harmless(bytes: &Bytes) -> String {
    if bytes.ptr.is_null() {
        return String::new();
    }
    // SAFETY: the caller's promise.
    trocar_model::plain::sentence(unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) })
}

/// A plugin without an instance has no identity to ask for services with.
unsafe extern "C" fn service(_ctx: *mut c_void, _token: u64, _request: Bytes) -> Outcome {
    NOT_ACTIVE
}

unsafe extern "C" fn ports_changed(_ctx: *mut c_void) -> Outcome {
    NOT_ACTIVE
}

unsafe extern "C" fn callback_enter(_ctx: *mut c_void) -> Outcome {
    NOT_ACTIVE
}

unsafe extern "C" fn callback_leave(_ctx: *mut c_void) {}

unsafe extern "C" fn extension(_ctx: *mut c_void, _id: Bytes) -> *const c_void {
    std::ptr::null()
}
