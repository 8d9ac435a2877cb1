//! The host table each instance is created with: clock, log, services, callbacks.
//!
//! Invariant: every function here may be called from any thread of the plugin and never waits.

use std::ffi::c_void;
use std::sync::{Arc, OnceLock, Weak};

use trocar_plugin_api::abi::{
    ABI_MAJOR, ABI_MINOR, Bytes, DISABLED, EXECUTED, HostTable, NOT_ACTIVE, Outcome, WOULD_BLOCK,
};
use trocar_rt::os;

use super::super::context;
use super::super::instance::Instance;
use super::super::logs::LogRing;

/// What stands behind `HostTable::ctx` of one instance.
pub(in crate::lcm) struct HostContext {
    /// The component's number.
    pub(in crate::lcm) number: u32,
    pub(in crate::lcm) logs: Arc<LogRing>,
    pub(in crate::lcm) instance: OnceLock<Weak<Instance>>,
}

impl HostContext {
    /// The table for this context, which must outlive it.
    pub(in crate::lcm) fn shared_table(self: &Arc<Self>) -> SharedTable {
        SharedTable(HostTable {
            struct_size: size_of::<HostTable>() as u32,
            flags: 0,
            abi_major: ABI_MAJOR,
            abi_minor: ABI_MINOR,
            ctx: Arc::as_ptr(self).cast_mut().cast(),
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

/// A host table kept beside the context it points to.
pub(in crate::lcm) struct SharedTable(HostTable);

// SAFETY: the table is immutable and its context is a `HostContext`, which is Sync.
unsafe impl Send for SharedTable {}
// SAFETY: as above.
unsafe impl Sync for SharedTable {}

impl SharedTable {
    pub(in crate::lcm) fn pointer(&self) -> *const HostTable {
        &raw const self.0
    }
}

/// `ctx` is the `HostContext` whose table the function stands in.
fn context_of<'a>(ctx: *mut c_void) -> &'a HostContext {
    // SAFETY: the context lives as long as its instance.
    unsafe { &*ctx.cast::<HostContext>() }
}

unsafe extern "C" fn now_ns(_ctx: *mut c_void) -> u64 {
    os::now_ns()
}

fn text<'a>(bytes: &Bytes) -> &'a [u8] {
    if bytes.ptr.is_null() {
        return &[];
    }
    // SAFETY: the plugin lends `len` bytes for the call.
    unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) }
}

unsafe extern "C" fn log(ctx: *mut c_void, level: u32, target: Bytes, message: Bytes) {
    let host = context_of(ctx);
    host.logs.push(host.number, level, text(&target), text(&message));
}

/// A line a plugin logs without saying for which instance: goes to the component whose code runs on this thread, else to
/// the host's own log. Never waits when a component runs.
pub fn plugin_log(plugin: &str, level: u32, target: &str, message: &str) {
    // SAFETY: null, or the context of the instance that is being called on this very thread.
    match unsafe { context::component().as_ref() } {
        Some(host) => host.logs.push(host.number, level, target.as_bytes(), message.as_bytes()),
        None => crate::loader::log_to_crate(plugin, level, target, message),
    }
}

/// Dynamic component services are answered DISABLED until this host offers them to components.
unsafe extern "C" fn service(_ctx: *mut c_void, _token: u64, _request: Bytes) -> Outcome {
    if context::stepping() { WOULD_BLOCK } else { DISABLED }
}

unsafe extern "C" fn callback_enter(ctx: *mut c_void) -> Outcome {
    let Some(instance) = context_of(ctx).instance.get().and_then(Weak::upgrade) else { return NOT_ACTIVE };
    if !instance.is_active() {
        return NOT_ACTIVE;
    }
    match instance.object.try_enter() {
        Some(entered) => {
            // Left again by `callback_leave`.
            let _stays_inside = std::mem::ManuallyDrop::new(entered);
            EXECUTED
        }
        None => {
            instance.counters.overlap();
            WOULD_BLOCK
        }
    }
}

unsafe extern "C" fn callback_leave(ctx: *mut c_void) {
    if let Some(instance) = context_of(ctx).instance.get().and_then(Weak::upgrade) {
        instance.after_callback();
    }
}

/// Ports that change while a component lives come with `describe`.
unsafe extern "C" fn ports_changed(_ctx: *mut c_void) -> Outcome {
    DISABLED
}

unsafe extern "C" fn extension(_ctx: *mut c_void, _id: Bytes) -> *const c_void {
    std::ptr::null()
}
