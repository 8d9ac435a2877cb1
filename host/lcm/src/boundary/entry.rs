//! One plugin instance and the calls into its class table.
//!
//! Invariant: an instance is entered by one thread at a time and never re-entered: every call goes through
//! [`Entered`], which exists only while the entry lock is held.

use std::cell::{Cell, UnsafeCell};
use std::ffi::c_void;
use std::fmt;
use std::ptr;
use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering};

use trocar_model::Ports as Described;
use trocar_plugin_api::abi::{
    Bytes, ClassTable, ErrBuf, HostTable, Ports, STATUS_FAILED, STATUS_OK, STATUS_PANICKED,
    STATUS_UNSUPPORTED, Sink, Status, Tick,
};
use trocar_rt::os;

use super::super::context;
use super::hot::{Hot, StateCopy, entry};
use super::needs;
use super::no_room::NoRoom;
use super::texts::{bytes, sentence, write_err};

/// Result of an entry: on failure the name of the entry, and why.
pub(crate) type EntryResult = Result<(), (&'static str, EntryError)>;

/// A failed entry: its status and its sentence.
#[derive(Clone, Debug)]
pub(crate) struct EntryError {
    pub(crate) status: Status,
    pub(crate) text: String,
    /// Set when the host could not provide what the entry asked for.
    pub(crate) no_room: Option<Box<NoRoom>>,
}

impl EntryError {
    pub(crate) fn new(status: Status, text: impl Into<String>) -> Self {
        EntryError { status, text: text.into(), no_room: None }
    }

    pub(crate) fn no_room(no_room: NoRoom) -> Self {
        EntryError {
            no_room: Some(Box::new(no_room.clone())),
            ..Self::new(STATUS_FAILED, no_room.to_string())
        }
    }

    pub(crate) fn panicked(&self) -> bool {
        self.status == STATUS_PANICKED
    }

    /// Tells whether the entry refused its argument and goes on as before.
    pub(crate) fn refused(&self) -> bool {
        self.status == trocar_plugin_api::abi::STATUS_INVALID
    }
}

/// Room for one sentence from a plugin, bytes.
pub(crate) const ERR_BYTES: usize = 512;

/// Calls `f` with an error buffer; any status but OK becomes an [`EntryError`].
#[inline]
fn guarded(mut err: ErrBuf, f: impl FnOnce(*mut ErrBuf) -> Status) -> Result<(), EntryError> {
    let status = f(&raw mut err);
    if status == STATUS_OK { Ok(()) } else { Err(failed(status, &raw mut err)) }
}

#[cold]
fn failed(status: Status, err: *mut ErrBuf) -> EntryError {
    let text = sentence(err);
    let text = if text.is_empty() { Unexplained(status).to_string() } else { text };
    EntryError::new(status, text)
}

/// A status that came without a sentence.
pub(super) struct Unexplained(pub(super) Status);

impl fmt::Display for Unexplained {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            status if status > STATUS_OK => write!(f, "status {status}, which this ABI does not have"),
            STATUS_PANICKED => f.write_str("panicked (its words are in the log)"),
            status => write!(f, "status {status} without a reason"),
        }
    }
}

/// Answer of an entry that finds no instance.
const GONE: &str = "there is no instance any more: it was destroyed, and the one after it could not be made";

#[cold]
fn gone(err: *mut ErrBuf) -> Status {
    write_err(err, GONE.as_bytes());
    STATUS_FAILED
}

const FREE: u32 = 0;
const HELD: u32 = 1;
const CONTENDED: u32 = 2;

/// Keeper word of no executor, whether a thread is inside or not.
const NOBODY: u64 = u64::MAX;
const INSIDE: u64 = 1;

/// An instance behind its entry lock, with the state only the holder of that lock may touch.
pub(crate) struct Object<T> {
    table: *const ClassTable,
    hot: Hot,
    lock: AtomicU32,
    /// Thread token of the holder, to tell re-entry from contention.
    holder: AtomicU64,
    /// Twice the number of the executor that holds the lock for a whole cycle, plus [`INSIDE`] while a thread
    /// is inside under that lock; or [`NOBODY`]. Written by that executor's thread alone.
    keeper: AtomicU64,
    /// Null while there is no instance. Used by the holder of the lock, and by visitors.
    this: AtomicPtr<c_void>,
    /// Threads that bring the instance to its safe condition without the lock; it is not destroyed meanwhile.
    visitors: AtomicU32,
    /// For the sentence of an entry that fails.
    room: UnsafeCell<[u8; ERR_BYTES]>,
    inner: UnsafeCell<T>,
}

// SAFETY: `inner` and `room` are reached only through `Entered`, i.e. by the holder of the lock; the table is
// immutable and lives as long as the library, which is never unloaded while classes of it exist. T moves
// between holders: T: Send.
unsafe impl<T: Send> Send for Object<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Sync for Object<T> {}

/// Number of the next thread that enters an instance; never used twice, as an address would be.
static NEXT_THREAD: AtomicU64 = AtomicU64::new(1);

/// Number of this thread: a thread that ended inside is never taken for one that came after it.
#[inline]
fn thread_token() -> u64 {
    thread_local!(static TOKEN: Cell<u64> = const { Cell::new(0) });
    match TOKEN.get() {
        0 => {
            TOKEN.set(NEXT_THREAD.fetch_add(1, Ordering::Relaxed));
            TOKEN.get()
        }
        token => token,
    }
}

impl<T: Send> Object<T> {
    pub(crate) fn new(table: *const ClassTable, inner: T) -> Self {
        Object {
            table,
            hot: Hot::of(table),
            lock: AtomicU32::new(FREE),
            holder: AtomicU64::new(0),
            keeper: AtomicU64::new(NOBODY),
            this: AtomicPtr::new(ptr::null_mut()),
            visitors: AtomicU32::new(0),
            room: UnsafeCell::new([0; ERR_BYTES]),
            inner: UnsafeCell::new(inner),
        }
    }

    /// Enters when no thread is inside.
    #[inline]
    pub(crate) fn try_enter(&self) -> Option<Entered<'_, T>> {
        if self.is_kept_here() {
            return self.enter_kept();
        }
        self.lock.compare_exchange(FREE, HELD, Ordering::Acquire, Ordering::Relaxed).ok()?;
        self.holder.store(thread_token(), Ordering::Relaxed);
        Some(Entered { object: self, kept: false })
    }

    /// Enters under the lock this thread holds for its cycle: a plain word is enough. `None` when a thread is
    /// inside, and when this thread holds no lock.
    #[inline]
    pub(crate) fn enter_kept(&self) -> Option<Entered<'_, T>> {
        let free = context::executor() * 2;
        if self.keeper.load(Ordering::Relaxed) != free {
            return None;
        }
        self.keeper.store(free | INSIDE, Ordering::Relaxed);
        Some(Entered { object: self, kept: true })
    }

    /// Takes the lock for the cycle that begins on this executor, so that entering and leaving within it cost
    /// no atomic operation; not when a thread is inside. The same thread must let go of the lock at the
    /// cycle's end.
    pub(crate) fn keep(&self) {
        if self.lock.compare_exchange(FREE, HELD, Ordering::Acquire, Ordering::Relaxed).is_ok() {
            self.holder.store(thread_token(), Ordering::Relaxed);
            self.keeper.store(context::executor() * 2, Ordering::Relaxed);
        }
    }

    /// Ends [`Object::keep`], on the executor where it began.
    pub(crate) fn let_go(&self) {
        if self.keeper.load(Ordering::Relaxed) == context::executor() * 2 {
            self.keeper.store(NOBODY, Ordering::Relaxed);
            self.unlock();
        }
    }

    /// Tells whether this thread holds the entry lock for its cycle. Only the keeper's own thread ever finds
    /// its own number here.
    #[inline]
    pub(crate) fn is_kept_here(&self) -> bool {
        self.keeper.load(Ordering::Relaxed) | INSIDE == (context::executor() * 2) | INSIDE
    }

    /// Enters, and waits for the thread inside until `deadline_ns`. `None` at the deadline, and at once when
    /// this very thread is inside already. Never from a real-time thread.
    pub(crate) fn enter_until(&self, deadline_ns: u64) -> Option<Entered<'_, T>> {
        if let Some(entered) = self.try_enter() {
            return Some(entered);
        }
        loop {
            if self.holder.load(Ordering::Relaxed) == thread_token() {
                return None;
            }
            if self.lock.swap(CONTENDED, Ordering::Acquire) == FREE {
                self.holder.store(thread_token(), Ordering::Relaxed);
                return Some(Entered { object: self, kept: false });
            }
            if os::now_ns() >= deadline_ns {
                return None;
            }
            os::futex_wait(&self.lock, CONTENDED, Some(deadline_ns), os::Scope::Process);
        }
    }

    /// Tells whether there is an instance.
    pub(crate) fn is_made(&self) -> bool {
        !self.this.load(Ordering::SeqCst).is_null()
    }

    /// Tells whether no thread is inside now.
    pub(crate) fn is_free(&self) -> bool {
        self.lock.load(Ordering::Acquire) == FREE
    }

    /// Brings the device to its safe condition while another thread may be stuck inside: only for classes
    /// that declare this entry callable from any thread.
    pub(crate) fn make_safe_from_outside(&self) -> Result<(), EntryError> {
        let mut room = [0u8; ERR_BYTES];
        let err = ErrBuf { ptr: room.as_mut_ptr(), cap: ERR_BYTES, len: 0 };
        self.visitors.fetch_add(1, Ordering::SeqCst);
        let this = self.this.load(Ordering::SeqCst);
        let done = match entry!(self.table, make_safe) {
            // SAFETY: a live instance: `destroy` clears `this` before it looks for visitors; the class says
            // that this entry may be called from any thread at any time.
            Some(make_safe) if !this.is_null() => guarded(err, |err| unsafe { make_safe(this, err) }),
            _ => Ok(()),
        };
        self.visitors.fetch_sub(1, Ordering::SeqCst);
        done
    }

    /// Takes over an entry this thread made by `callback_enter`; `None` when it made none.
    pub(crate) fn adopt(&self) -> Option<Entered<'_, T>> {
        // Lazily: an `Entered` that is made and dropped would let others in.
        let mine = self.holder.load(Ordering::Relaxed) == thread_token() && !self.is_kept_here();
        mine.then(|| Entered { object: self, kept: false })
    }

    /// A read command as a pure function of `row`; any thread, no instance.
    #[inline]
    pub(crate) fn read(
        &self,
        row: &[u64],
        id: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Status {
        // SAFETY: row, arg and ret have the sizes and alignment of the manifest's types, checked when bound;
        // the entry takes no instance, so no lock is needed.
        unsafe { (self.hot.read)(row.as_ptr().cast(), id, arg.cast(), ret.cast(), err) }
    }
}

/// The right to call into an instance; dropping it leaves.
pub(crate) struct Entered<'a, T> {
    object: &'a Object<T>,
    /// True when entered under the lock its executor keeps for the cycle.
    kept: bool,
}

impl<T> Object<T> {
    fn unlock(&self) {
        self.holder.store(0, Ordering::Relaxed);
        if self.lock.swap(FREE, Ordering::Release) == CONTENDED {
            os::futex_wake(&self.lock, u32::MAX, os::Scope::Process);
        }
    }
}

impl<T> Drop for Entered<'_, T> {
    #[inline]
    fn drop(&mut self) {
        if self.kept {
            let keeper = &self.object.keeper;
            keeper.store(keeper.load(Ordering::Relaxed) & !INSIDE, Ordering::Relaxed);
        } else {
            self.object.unlock();
        }
    }
}

impl<T> Entered<'_, T> {
    /// The data that belong to the holder of the lock.
    pub(crate) fn inner(&mut self) -> &mut T {
        // SAFETY: we hold the lock and `&mut self` keeps this the only reference.
        unsafe { &mut *self.object.inner.get() }
    }

    /// Null between `destroy` and `create`.
    #[inline]
    fn this(&self) -> *mut c_void {
        self.object.this.load(Ordering::Relaxed)
    }

    /// The instance, where there is one.
    fn made(&self) -> Result<*mut c_void, EntryError> {
        let this = self.this();
        if this.is_null() { Err(EntryError::new(STATUS_FAILED, GONE)) } else { Ok(this) }
    }

    /// An empty error buffer, used by one entry at a time: an instance is not re-entered.
    #[inline]
    pub(crate) fn err_buf(&mut self) -> ErrBuf {
        ErrBuf { ptr: self.object.room.get().cast(), cap: ERR_BYTES, len: 0 }
    }

    /// Makes the instance.
    pub(crate) fn create(&mut self, host: *const HostTable, name: &str) -> Result<(), EntryError> {
        let Some(create) = entry!(self.object.table, create) else {
            return Err(EntryError::new(STATUS_UNSUPPORTED, "the class has no create entry"));
        };
        let mut made = ptr::null_mut();
        guarded(self.err_buf(), |err| {
            // SAFETY: host outlives the instance: the `Instance` holds it until `destroy`, and one that is
            // never destroyed is kept. name and err live for the call.
            made = unsafe { create(host, bytes(name.as_bytes()), err) };
            if made.is_null() { STATUS_FAILED } else { STATUS_OK }
        })?;
        self.object.this.store(made, Ordering::SeqCst);
        Ok(())
    }

    /// False where the instance is left to the end of the process.
    pub(crate) fn destroy(&mut self) -> bool {
        let this = self.object.this.swap(ptr::null_mut(), Ordering::SeqCst);
        // A visitor that came before the swap may still be inside.
        if self.object.visitors.load(Ordering::SeqCst) > 0 {
            return this.is_null();
        }
        if let (false, Some(destroy)) = (this.is_null(), entry!(self.object.table, destroy)) {
            // SAFETY: made by `create` of the same table, not destroyed before (the pointer was cleared
            // above), and no visitor has it.
            unsafe { destroy(this) };
        }
        true
    }

    /// Leaves the instance to the end of the process: another thread may still use it.
    pub(crate) fn abandon(&mut self) {
        self.object.this.store(ptr::null_mut(), Ordering::SeqCst);
    }

    pub(crate) fn configure(&mut self, json: &str) -> Result<(), EntryError> {
        let this = self.made()?;
        match entry!(self.object.table, configure) {
            Some(configure) => {
                // SAFETY: a live instance of this table; json and err live for the call.
                guarded(self.err_buf(), |err| unsafe { configure(this, bytes(json.as_bytes()), err) })
            }
            None => Ok(()),
        }
    }

    pub(crate) fn bind(&mut self, ports: *const Ports) -> Result<(), EntryError> {
        let this = self.made()?;
        match entry!(self.object.table, bind) {
            // SAFETY: a live instance; the slot tables outlive it: the `Instance` holds them until `destroy`,
            // and one that is never destroyed is kept.
            Some(bind) => guarded(self.err_buf(), |err| unsafe { bind(this, ports, err) }),
            None => Ok(()),
        }
    }

    /// The class description as it holds now, at most `most` bytes; `None` where the class offers none.
    pub(crate) fn describe(&mut self, most: usize) -> Result<Option<Vec<u8>>, EntryError> {
        let this = self.made()?;
        let Some(describe) = entry!(self.object.table, describe) else { return Ok(None) };
        let mut text = Pieces { bytes: Vec::new(), most, cut: false };
        let sink = Sink { ctx: (&raw mut text).cast(), write: add_piece };
        // SAFETY: a live instance of this table, entered by us alone; the sink lives for the call.
        match unsafe { describe(this, &raw const sink) } {
            STATUS_UNSUPPORTED => Ok(None),
            status if status != STATUS_OK => Err(EntryError::new(status, Unexplained(status).to_string())),
            _ if text.cut => Err(EntryError::new(STATUS_FAILED, format!("it writes more than {most} bytes"))),
            _ => Ok(Some(text.bytes)),
        }
    }

    /// The entry that the class leaves null although these ports need it, and the member that needs it.
    pub(crate) fn lacks(&self, ports: &Described) -> Option<(&'static str, String)> {
        needs::lacking(self.object.table, ports)
    }

    pub(crate) fn start(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, start))
    }

    pub(crate) fn stop(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, stop))
    }

    pub(crate) fn resume(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, resume))
    }

    pub(crate) fn make_safe(&mut self) -> Result<(), EntryError> {
        self.plain(entry!(self.object.table, make_safe))
    }

    fn plain(
        &mut self,
        f: Option<unsafe extern "C" fn(*mut c_void, *mut ErrBuf) -> Status>,
    ) -> Result<(), EntryError> {
        let this = self.this();
        match f {
            // SAFETY: a live instance of this table, entered by us alone.
            Some(f) if !this.is_null() => guarded(self.err_buf(), |err| unsafe { f(this, err) }),
            _ => Ok(()),
        }
    }

    /// Real-time.
    pub(crate) fn step(&mut self, tick: &Tick) -> Result<(), EntryError> {
        let this = self.made()?;
        let step = self.object.hot.step;
        // SAFETY: a live instance of this table, entered by us alone; tick and err live for the call.
        guarded(self.err_buf(), |err| context::as_step(|| unsafe { step(this, tick, err) }))
    }

    /// Runs a command; the sentence of a failure goes to `err`. Real-time.
    #[inline]
    pub(crate) fn command(&mut self, id: u32, arg: *const u8, ret: *mut u8, err: *mut ErrBuf) -> Status {
        let this = self.this();
        if this.is_null() {
            return gone(err);
        }
        // SAFETY: a live instance; arg and ret have the size and alignment of the manifest's types, checked
        // when bound.
        unsafe { (self.object.hot.command)(this, id, arg.cast(), ret.cast(), err) }
    }

    /// Hands over the reply to a service it asked for.
    pub(crate) fn on_service(&mut self, token: u64, reply: &str) -> Result<(), EntryError> {
        let this = self.this();
        match entry!(self.object.table, on_service) {
            Some(f) if !this.is_null() => {
                // SAFETY: a live instance of this table, entered by us alone; the text lives for the call.
                guarded(self.err_buf(), |_| unsafe { f(this, token, bytes(reply.as_bytes())) })
            }
            _ => Ok(()),
        }
    }

    /// Delivers an event; the sentence of a failure goes to `err`. Real-time.
    #[inline]
    pub(crate) fn on_event(&mut self, id: u32, payload: *const u8, err: *mut ErrBuf) -> Status {
        let this = self.this();
        if this.is_null() {
            return gone(err);
        }
        // SAFETY: as for `command`.
        unsafe { (self.object.hot.on_event)(this, id, payload.cast(), err) }
    }

    /// The holder's data, and a way to copy the plain state block. Real-time.
    #[inline]
    pub(crate) fn with_state(&mut self) -> (&mut T, StateBlock) {
        let block = StateBlock { this: self.this(), copy: self.object.hot.state_copy };
        (self.inner(), block)
    }
}

/// The plain state block of an instance, whose entry the holder keeps while it has this.
pub(crate) struct StateBlock {
    this: *mut c_void,
    copy: StateCopy,
}

impl StateBlock {
    /// Copies it to `row`, which has the length of the manifest's state type.
    #[inline]
    pub(crate) fn copy_to(&self, row: &mut [u8]) {
        if !self.this.is_null() {
            // SAFETY: a live instance, entered by us alone; row has the length of the state type.
            unsafe { (self.copy)(self.this, row.as_mut_ptr().cast(), row.len()) }
        }
    }
}

/// Text a sink has taken so far.
struct Pieces {
    bytes: Vec<u8>,
    most: usize,
    /// True when more came than is allowed.
    cut: bool,
}

unsafe extern "C" fn add_piece(ctx: *mut c_void, piece: Bytes) {
    // SAFETY: ctx is the `Pieces` of the call that is under way.
    let text = unsafe { &mut *ctx.cast::<Pieces>() };
    if text.bytes.len().saturating_add(piece.len) > text.most {
        text.cut = true;
    } else if !piece.ptr.is_null() {
        // SAFETY: the plugin lends `len` bytes for the call.
        text.bytes.extend_from_slice(unsafe { std::slice::from_raw_parts(piece.ptr, piece.len) });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::thread_token;

    #[test]
    fn threads_that_come_one_after_the_other_have_numbers_of_their_own() {
        let numbers: BTreeSet<_> =
            (0..8).map(|_| std::thread::spawn(thread_token).join().expect("a number")).collect();
        assert_eq!(numbers.len(), 8);
        assert!(!numbers.contains(&0), "no thread");
        assert_eq!(thread_token(), thread_token());
    }
}
