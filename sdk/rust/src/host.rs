//! The host as an instance sees it: clock, services, callbacks.
//!
//! Invariant: the host's table is valid until `destroy` returns, and until the process ends where a handle is
//! left then.

use crate::outcome::Outcome;
use crate::values::Stamp;
use core::ffi::c_void;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use trocar_plugin_api::abi::{Bytes, HostTable, KEEP, Keep, has_entry};

/// First token of [`Host::services`].
const FIRST_TOKEN: u64 = 1 << 32;

/// A handle to the host: a `#[host]` field of a component. Any thread may use it. Your own threads end in
/// `Drop` at the latest: a handle that exists beyond it costs the memory of the component until the process
/// ends, and the host says so.
#[derive(Clone)]
pub struct Host {
    env: Arc<Env>,
}

struct Env {
    table: *const HostTable,
    name: String,
    /// Begin of the step that runs, ns; 0 outside of `step`.
    step_ns: AtomicU64,
    /// Token of the last service asked for; above those an author counts from 0.
    token: AtomicU64,
}

// SAFETY: the host's functions take calls from any thread, and the table outlives the instance.
unsafe impl Send for Env {}
// SAFETY: as above; `step_ns` is atomic.
unsafe impl Sync for Env {}

impl Host {
    /// # Safety
    /// `table` is valid until the instance is destroyed, and longer when the host is asked to keep it.
    pub(crate) unsafe fn new(table: *const HostTable, name: &str) -> Host {
        let (step_ns, token) = (AtomicU64::new(0), AtomicU64::new(FIRST_TOKEN));
        Host { env: Arc::new(Env { table, name: name.to_string(), step_ns, token }) }
    }

    /// The instance is gone; `ports`: none of its ports is left.
    pub(crate) fn end(self, ports: bool) {
        let table = self.env.table;
        if !(Arc::into_inner(self.env).is_some() && ports) {
            // SAFETY: as in `table`; `destroy` has not returned.
            keep(unsafe { &*table });
        }
    }

    /// Makes the host keep what it gave this instance so far until the process ends.
    pub(crate) fn keep(&self) {
        keep(self.table());
    }

    fn table(&self) -> &HostTable {
        // SAFETY: `new` demands a table that outlives the instance, and `end` has it kept for handles that
        // outlive that; create refuses a null one.
        unsafe { &*self.env.table }
    }

    /// The name of this instance.
    pub fn instance_name(&self) -> &str {
        &self.env.name
    }

    /// The host's monotonic clock. About 25 ns; in `step`, prefer `tick.now()`.
    pub fn now(&self) -> Stamp {
        let table = self.table();
        // SAFETY: the clock may be read from any thread.
        Stamp::from_ns(unsafe { (table.now_ns)(table.ctx) })
    }

    /// Begin of the running step, or now.
    #[inline]
    pub(crate) fn stamp(&self) -> u64 {
        match self.env.step_ns.load(Ordering::Relaxed) {
            0 => self.now().ns(),
            ns => ns,
        }
    }

    #[inline]
    pub(crate) fn step_begins(&self, now_ns: u64) {
        self.env.step_ns.store(now_ns, Ordering::Relaxed);
    }

    #[inline]
    pub(crate) fn step_ended(&self) {
        self.env.step_ns.store(0, Ordering::Relaxed);
    }

    pub(crate) fn next_token(&self) -> u64 {
        self.env.token.fetch_add(1, Ordering::Relaxed)
    }

    /// Asks for a dynamic component service as raw JSON, `{"verb":"Create",…}` as in the gRPC request;
    /// [`Host::services`] is the typed way. The reply arrives in [`crate::Component::service_reply`] with the
    /// same token. From `step` the answer is `WouldBlock`.
    pub fn service(&self, token: u64, request: &str) -> Outcome {
        let table = self.table();
        // SAFETY: the text lives through the call.
        Outcome::from(unsafe { (table.service)(table.ctx, token, bytes(request)) })
    }

    /// Tells the host that lists of names ([`crate::Many`], [`crate::Names`]) have changed: between two steps
    /// it asks for them and ties the ports. After `configure` it does so by itself. Any thread; `Disabled`
    /// when the host is older than ABI 1.1.
    pub fn ports_changed(&self) -> Outcome {
        let table = self.table();
        let at = core::mem::offset_of!(HostTable, ports_changed);
        if !has_entry(table.struct_size, at, size_of_val(&table.now_ns)) {
            return Outcome::Disabled;
        }
        // SAFETY: the entry lies inside the table and takes calls from any thread.
        Outcome::from(unsafe { (table.ports_changed)(table.ctx) })
    }

    /// Runs `f` bracketed as a callback: for threads of a device library in an `on_callback` class.
    ///
    /// # Errors
    /// The host's outcome when the component may not be entered now (busy, stopped); `f` has not run.
    pub fn callback<R>(&self, f: impl FnOnce() -> R) -> Result<R, Outcome> {
        let table = self.table();
        // SAFETY: enter and leave may come from any thread of the author's.
        let entered = Outcome::from(unsafe { (table.callback_enter)(table.ctx) });
        if !entered.is_ok() {
            return Err(entered);
        }
        struct Leave<'a>(&'a HostTable);
        impl Drop for Leave<'_> {
            fn drop(&mut self) {
                // SAFETY: pairs with the enter above, on the same thread.
                unsafe { (self.0.callback_leave)(self.0.ctx) }
            }
        }
        let _leave = Leave(table);
        Ok(f())
    }

    /// The table of a host extension such as "trocar.parallel/1"; null when the host has none of that name.
    pub fn extension(&self, id: &str) -> *const c_void {
        let table = self.table();
        // SAFETY: the text lives through the call.
        unsafe { (table.extension)(table.ctx, bytes(id)) }
    }
}

fn keep(table: &HostTable) {
    // SAFETY: the text lives through the call; what is found is the extension of that name, or null.
    let found = unsafe { (table.extension)(table.ctx, bytes(KEEP)).cast::<Keep>().as_ref() };
    match found {
        // SAFETY: the context of the table it came from.
        Some(extension) => unsafe { (extension.keep)(table.ctx) },
        None => log::error!(
            "ports or host handles of a component that is gone are still held, and this host is too old to keep what they \
             point to: end the threads that hold them in Drop, and keep none in a static"
        ),
    }
}

pub(crate) fn bytes(text: &str) -> Bytes {
    Bytes { ptr: text.as_ptr(), len: text.len() }
}
