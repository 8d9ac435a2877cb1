//! One plugin instance and the calls into its class table.
//!
//! Invariant: an instance is entered by one thread at a time and never re-entered: every call goes through [`Entered`],
//! which exists only while the entry lock is held.

use std::cell::UnsafeCell;
use std::ffi::c_void;
use std::ptr;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use trocar_plugin_api::abi::{
    Bytes, ClassTable, ErrBuf, HostTable, Ports, STATUS_FAILED, STATUS_OK, STATUS_UNSUPPORTED, Status, Tick,
};
use trocar_plugin_api::has_entry;
use trocar_rt::os;

/// Reads an entry of a table that may be shorter than ours; `None` when absent or null.
macro_rules! entry {
    ($table:expr, $field:ident) => {{
        let table: *const ClassTable = $table;
        // SAFETY: every table starts with its struct_size; the loader checked that the pointer is a table.
        let size = unsafe { (*table).struct_size };
        if has_entry(size, std::mem::offset_of!(ClassTable, $field), size_of::<usize>()) {
            // SAFETY: the field lies inside the table, by its own word.
            unsafe { (*table).$field }
        } else {
            None
        }
    }};
}

/// A failed entry: its status and its sentence.
#[derive(Clone, Debug)]
pub(in crate::lcm) struct EntryError {
    pub(in crate::lcm) status: Status,
    pub(in crate::lcm) text: String,
}

impl EntryError {
    pub(in crate::lcm) fn panicked(&self) -> bool {
        self.status == trocar_plugin_api::abi::STATUS_PANICKED
    }

    /// The entry said no to what it was given and goes on as before.
    pub(in crate::lcm) fn refused(&self) -> bool {
        self.status == trocar_plugin_api::abi::STATUS_INVALID
    }
}

/// Room for one sentence from a plugin, bytes.
pub(in crate::lcm) const ERR_BYTES: usize = 512;

/// Calls `f` with an error buffer on the stack; a negative status becomes an [`EntryError`].
fn guarded(f: impl FnOnce(*mut ErrBuf) -> Status) -> Result<(), EntryError> {
    let mut room = [0u8; ERR_BYTES];
    let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
    let status = f(&raw mut err);
    if status >= STATUS_OK {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&room[..err.len.min(ERR_BYTES)]).into_owned();
    let text = if text.is_empty() { format!("status {status} without a reason") } else { text };
    Err(EntryError { status, text })
}

const FREE: u32 = 0;
const HELD: u32 = 1;
const CONTENDED: u32 = 2;

/// An instance behind its entry lock, with the state only the holder of that lock may touch.
pub(in crate::lcm) struct Object<T> {
    table: *const ClassTable,
    lock: AtomicU32,
    /// Thread token of the holder, to tell re-entry from contention.
    holder: AtomicU64,
    this: UnsafeCell<*mut c_void>,
    inner: UnsafeCell<T>,
}

// SAFETY: `this` and `inner` are reached only through `Entered`, i.e. by the holder of the lock; the table is immutable
// and lives as long as the library, which is never unloaded while classes of it exist. T moves between holders: T: Send.
unsafe impl<T: Send> Send for Object<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Sync for Object<T> {}

/// Non-zero, unique for each living thread.
fn thread_token() -> u64 {
    thread_local!(static TOKEN: u8 = const { 0 });
    TOKEN.with(|t| ptr::from_ref(t) as u64)
}

impl<T: Send> Object<T> {
    pub(in crate::lcm) fn new(table: *const ClassTable, inner: T) -> Self {
        Object {
            table,
            lock: AtomicU32::new(FREE),
            holder: AtomicU64::new(0),
            this: UnsafeCell::new(ptr::null_mut()),
            inner: UnsafeCell::new(inner),
        }
    }

    /// Enters when nobody is inside.
    pub(in crate::lcm) fn try_enter(&self) -> Option<Entered<'_, T>> {
        self.lock.compare_exchange(FREE, HELD, Ordering::Acquire, Ordering::Relaxed).ok()?;
        self.holder.store(thread_token(), Ordering::Relaxed);
        Some(Entered { object: self })
    }

    /// Enters, waiting for whoever is inside until `deadline_ns`. `None` at the deadline, and at once when this very
    /// thread is inside already. Never from a real-time thread.
    pub(in crate::lcm) fn enter_until(&self, deadline_ns: u64) -> Option<Entered<'_, T>> {
        if let Some(entered) = self.try_enter() {
            return Some(entered);
        }
        loop {
            if self.holder.load(Ordering::Relaxed) == thread_token() {
                return None;
            }
            if self.lock.swap(CONTENDED, Ordering::Acquire) == FREE {
                self.holder.store(thread_token(), Ordering::Relaxed);
                return Some(Entered { object: self });
            }
            if os::now_ns() >= deadline_ns {
                return None;
            }
            os::futex_wait(&self.lock, CONTENDED, Some(deadline_ns));
        }
    }

    /// Takes over an entry this thread made by `callback_enter`; `None` when it made none.
    pub(in crate::lcm) fn adopt(&self) -> Option<Entered<'_, T>> {
        (self.holder.load(Ordering::Relaxed) == thread_token()).then_some(Entered { object: self })
    }

    /// A read command as a pure function of `row`; any thread, no instance.
    pub(in crate::lcm) fn read(
        &self,
        row: &[u64],
        id: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Status {
        match entry!(self.table, read) {
            // SAFETY: row, arg and ret have the sizes and alignment of the manifest's types, checked when bound; the
            // entry takes no instance, so no lock is needed.
            Some(read) => unsafe { read(row.as_ptr().cast(), id, arg.cast(), ret.cast(), err) },
            None => STATUS_UNSUPPORTED,
        }
    }
}

/// The right to call into an instance; dropping it leaves.
pub(in crate::lcm) struct Entered<'a, T> {
    object: &'a Object<T>,
}

impl<T> Drop for Entered<'_, T> {
    fn drop(&mut self) {
        self.object.holder.store(0, Ordering::Relaxed);
        if self.object.lock.swap(FREE, Ordering::Release) == CONTENDED {
            os::futex_wake(&self.object.lock, u32::MAX);
        }
    }
}

impl<T> Entered<'_, T> {
    /// What belongs to the holder of the lock.
    pub(in crate::lcm) fn inner(&mut self) -> &mut T {
        // SAFETY: we hold the lock and `&mut self` keeps this the only reference.
        unsafe { &mut *self.object.inner.get() }
    }

    fn this(&self) -> *mut c_void {
        // SAFETY: we hold the lock.
        unsafe { *self.object.this.get() }
    }

    /// Makes the instance.
    pub(in crate::lcm) fn create(&mut self, host: *const HostTable, name: &str) -> Result<(), EntryError> {
        let Some(create) = entry!(self.object.table, create) else {
            return Err(EntryError {
                status: STATUS_UNSUPPORTED,
                text: "the class has no create entry".into(),
            });
        };
        let mut made = ptr::null_mut();
        guarded(|err| {
            // SAFETY: host outlives the instance (both belong to the same `Instance`); name and err live for the call.
            made = unsafe { create(host, bytes(name.as_bytes()), err) };
            if made.is_null() { STATUS_FAILED } else { STATUS_OK }
        })?;
        // SAFETY: we hold the lock.
        unsafe { *self.object.this.get() = made };
        Ok(())
    }

    pub(in crate::lcm) fn destroy(&mut self) {
        let this = self.this();
        if let (false, Some(destroy)) = (this.is_null(), entry!(self.object.table, destroy)) {
            // SAFETY: made by `create` of the same table, not destroyed before (the pointer is cleared below).
            unsafe { destroy(this) };
        }
        // SAFETY: we hold the lock.
        unsafe { *self.object.this.get() = ptr::null_mut() };
    }

    pub(in crate::lcm) fn configure(&mut self, json: &str) -> Result<(), EntryError> {
        let this = self.this();
        match entry!(self.object.table, configure) {
            // SAFETY: a live instance of this table; json and err live for the call.
            Some(configure) => guarded(|err| unsafe { configure(this, bytes(json.as_bytes()), err) }),
            None => Ok(()),
        }
    }

    pub(in crate::lcm) fn bind(&mut self, ports: *const Ports) -> Result<(), EntryError> {
        let this = self.this();
        match entry!(self.object.table, bind) {
            // SAFETY: a live instance; the slot tables live as long as it (`Slots` of the same `Instance`).
            Some(bind) => guarded(|err| unsafe { bind(this, ports, err) }),
            None => Ok(()),
        }
    }

    pub(in crate::lcm) fn start(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, start))
    }

    pub(in crate::lcm) fn stop(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, stop))
    }

    pub(in crate::lcm) fn resume(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, resume))
    }

    pub(in crate::lcm) fn make_safe(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, make_safe))
    }

    fn plain(
        &mut self,
        f: Option<unsafe extern "C" fn(*mut c_void, *mut ErrBuf) -> Status>,
    ) -> Result<(), EntryError> {
        let this = self.this();
        match f {
            // SAFETY: a live instance of this table, entered by us alone.
            Some(f) if !this.is_null() => guarded(|err| unsafe { f(this, err) }),
            _ => Ok(()),
        }
    }

    /// Real-time.
    pub(in crate::lcm) fn step(&mut self, tick: &Tick) -> Result<(), EntryError> {
        let this = self.this();
        match entry!(self.object.table, step) {
            // SAFETY: a live instance of this table, entered by us alone; tick and err live for the call.
            Some(step) => guarded(|err| unsafe { step(this, tick, err) }),
            None => Ok(()),
        }
    }

    /// Runs a command; the sentence of a failure goes to `err`. Real-time.
    pub(in crate::lcm) fn command(
        &mut self,
        id: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Status {
        match entry!(self.object.table, command) {
            // SAFETY: a live instance; arg and ret have the size and alignment of the manifest's types, checked when bound.
            Some(command) => unsafe { command(self.this(), id, arg.cast(), ret.cast(), err) },
            None => STATUS_UNSUPPORTED,
        }
    }

    /// Delivers an event. Real-time.
    pub(in crate::lcm) fn on_event(&mut self, id: u32, payload: *const u8) -> Result<(), EntryError> {
        let this = self.this();
        match entry!(self.object.table, on_event) {
            // SAFETY: as for `command`.
            Some(on_event) => guarded(|err| unsafe { on_event(this, id, payload.cast(), err) }),
            None => Ok(()),
        }
    }

    /// What belongs to the holder, with a way to copy the plain state block (of the manifest's state type). Real-time.
    pub(in crate::lcm) fn with_state(&mut self, f: impl FnOnce(&mut T, &dyn Fn(&mut [u8]))) {
        let this = self.this();
        let copy = entry!(self.object.table, state_copy);
        let fill = |row: &mut [u8]| match copy {
            // SAFETY: a live instance, entered by us alone; row has the length of the state type.
            Some(copy) if !this.is_null() => unsafe { copy(this, row.as_mut_ptr().cast(), row.len()) },
            _ => {}
        };
        f(self.inner(), &fill);
    }
}

pub(super) fn bytes(text: &[u8]) -> Bytes {
    Bytes { ptr: text.as_ptr(), len: text.len() }
}
