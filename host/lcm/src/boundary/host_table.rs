//! The host table each instance is created with: clock, log, services, callbacks.
//!
//! Invariant: every function here may be called from any thread of the plugin and never waits.

use std::ffi::c_void;
use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use trocar_model::ComponentId;

use trocar_plugin_api::abi::{
    ABI_MAJOR, ABI_MINOR, Bytes, HostTable, INVALID_ARGUMENT, KEEP, Keep, LOG_WARN, NOT_ACTIVE, Outcome,
    PARALLEL, QUEUED, WOULD_BLOCK,
};
use trocar_rt::os;

use super::super::books::Misuse;
use super::super::context;
use super::super::core::{Component, Core};
use super::super::logs::{self, LogRing};
use super::super::request_queue::{Account, RequestQueue};
use super::inside::running;
use super::parallel;

/// The data behind `HostTable::ctx` of one instance.
pub(crate) struct HostContext {
    /// The component's number.
    number: u32,
    id: ComponentId,
    logs: Arc<LogRing>,
    core: Weak<Core>,
    pub(crate) account: Account,
    request_queue: Arc<RequestQueue>,
    /// True when the component's code keeps a handle that the host gave it, for an unknown time.
    held: AtomicBool,
    /// Uses of host handles by the component's code after the component was gone.
    late: AtomicU64,
}

impl HostContext {
    pub(crate) fn new(core: &Arc<Core>, logs: &Arc<LogRing>, request_queue: &Arc<RequestQueue>) -> Arc<Self> {
        Arc::new(Self {
            number: core.number,
            id: core.id.clone(),
            logs: logs.clone(),
            core: Arc::downgrade(core),
            account: Account::default(),
            request_queue: request_queue.clone(),
            held: AtomicBool::new(false),
            late: AtomicU64::new(0),
        })
    }

    /// Tells whether everything the instance was given must stay until the process ends.
    pub(crate) fn is_held(&self) -> bool {
        self.held.load(Ordering::Acquire)
    }

    /// Tells the queue of requests that the component is gone.
    pub(crate) fn leave(&self) {
        self.request_queue.leave(self.number);
    }

    /// Counts a use of a host handle by code of a component that is gone, and logs the first, the tenth, the
    /// hundredth. Any thread; real-time.
    #[cold]
    #[inline(never)]
    pub(super) fn note_late(&self) {
        let times = self.late.fetch_add(1, Ordering::Relaxed) + 1;
        if times != 10u64.pow(times.ilog10()) {
            return;
        }
        let mut said = [0; 400];
        let room = said.len();
        let mut rest = said.as_mut_slice();
        // A longer text is cut.
        let _ = write!(
            rest,
            "{} is removed, and its code still uses its ports or its host handle: refused, {times} so far; end its threads in \
             stop or destroy, and keep no handle in a static",
            self.id
        );
        let len = room - rest.len();
        self.logs.push(self.number, log::Level::Warn as u32, logs::HOST.as_bytes(), &said[..len]);
    }

    /// The core of the component; `None`, and that is noted, when the component is gone.
    fn core(&self) -> Option<Arc<Core>> {
        let core = self.core.upgrade().filter(|core| core.has_component());
        if core.is_none() {
            self.note_late();
        }
        core
    }

    /// The component; `None`, and that is noted, when it is gone.
    fn component(&self) -> Option<Arc<dyn Component>> {
        self.core()?.component()
    }

    /// Asks for a service. Any thread of its code. Never waits, locks or allocates.
    fn ask_service(&self, core: &Core, token: u64, request: &[u8]) -> Outcome {
        if context::in_step() {
            core.books.misuse(Misuse::ServiceFromStep);
            return WOULD_BLOCK;
        }
        self.request_queue.ask(&self.account, self.number, token, request).unwrap_or_else(|why| {
            core.log(LOG_WARN, b"services", why.as_bytes());
            INVALID_ARGUMENT
        })
    }

    /// The table for this context; the table keeps the context.
    pub(crate) fn shared_table(self: &Arc<Self>) -> Arc<SharedTable> {
        let table = HostTable {
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
        };
        Arc::new(SharedTable(table, self.clone()))
    }
}

/// A host table, with the context it points to.
pub(crate) struct SharedTable(HostTable, #[expect(dead_code, reason = "held")] Arc<HostContext>);

// SAFETY: the table is immutable and its context is a `HostContext`, which is Sync.
unsafe impl Send for SharedTable {}
// SAFETY: as above.
unsafe impl Sync for SharedTable {}

impl SharedTable {
    pub(crate) fn pointer(&self) -> *const HostTable {
        &raw const self.0
    }
}

/// Gives the `HostContext` behind `ctx`, whose table the function stands in.
fn context_of<'a>(ctx: *mut c_void) -> &'a HostContext {
    // SAFETY: the context lives as long as its table, and the table as long as the host takes calls of its
    // component.
    unsafe { &*ctx.cast::<HostContext>() }
}

unsafe extern "C" fn now_ns(_ctx: *mut c_void) -> u64 {
    os::now_ns()
}

fn text<'a>(bytes: &Bytes) -> &'a [u8] {
    // No block of memory is longer than that, so it is not a length.
    if bytes.ptr.is_null() || bytes.len > isize::MAX as usize {
        return &[];
    }
    // SAFETY: the plugin lends `len` bytes for the call.
    unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) }
}

unsafe extern "C" fn log(ctx: *mut c_void, level: u32, target: Bytes, message: Bytes) {
    let host = context_of(ctx);
    host.logs.push(host.number, level, text(&target), text(&message));
}

/// Logs a line of a plugin that does not say for which instance: to the component whose code runs on this
/// thread, else to the host's own log. Never waits when a component runs.
pub fn plugin_log(plugin: &str, level: u32, target: &str, message: &str) {
    if running(|core| core.log(level, target.as_bytes(), message.as_bytes())).is_none() {
        trocar_loader::log_to_crate(plugin, level, target, message);
    }
}

/// A dynamic component service; see `services.rs`.
unsafe extern "C" fn service(ctx: *mut c_void, token: u64, request: Bytes) -> Outcome {
    let host = context_of(ctx);
    host.core().map_or(NOT_ACTIVE, |core| host.ask_service(&core, token, text(&request)))
}

unsafe extern "C" fn callback_enter(ctx: *mut c_void) -> Outcome {
    context_of(ctx).core().map_or(NOT_ACTIVE, |core| core.callback_enter())
}

unsafe extern "C" fn callback_leave(ctx: *mut c_void) {
    if let Some(core) = context_of(ctx).core.upgrade() {
        core.callback_leave();
    }
}

/// Asks for other ports: the component is described and bound again on its own thread, between two steps.
unsafe extern "C" fn ports_changed(ctx: *mut c_void) -> Outcome {
    match context_of(ctx).component() {
        Some(component) => {
            component.wish_ports();
            QUEUED
        }
        None => NOT_ACTIVE,
    }
}

unsafe extern "C" fn extension(_ctx: *mut c_void, id: Bytes) -> *const c_void {
    match text(&id) {
        id if id == PARALLEL.as_bytes() => parallel::table().cast(),
        id if id == KEEP.as_bytes() => (&raw const KEEPER).cast(),
        _ => std::ptr::null(),
    }
}

static KEEPER: Keep = Keep { struct_size: size_of::<Keep>() as u32, flags: 0, keep };

unsafe extern "C" fn keep(ctx: *mut c_void) {
    context_of(ctx).held.store(true, Ordering::Release);
}
