//! The bench itself: makes a component, ties its ports to cells, and takes it through its life.
//!
//! Invariant: the state row is published after each entry, as a host does it; reads see that row, never the
//! instance.

mod life;
mod ports;

use super::alloc::{self, Count};
use super::fake_host::FakeHost;
use super::fake_system::FakeSystem;
use super::history::{History, Kind};
use super::input_cells::InCell;
use super::logs::{self, LogLine};
use super::member_cells::{EventCell, FnCell};
use super::output_cells::OutCell;
use super::shape::Shape;
use super::wired::Wired;
use crate::class::Class;
use crate::payload::Payload;
use crate::shims::Export;
use core::ffi::c_void;
use core::fmt::{self, Display};
use core::marker::PhantomData;
use serde_json::{Map, Value as Json};
use std::cell::RefCell;
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi::{
    self, Bytes, ClassTable, ErrBuf, EventSlot, FnSlot, HostTable, InSlot, OutSlot, Status,
};

/// An entry that did not succeed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// `trocar_plugin_api::abi::STATUS_*`.
    pub status: Status,
    /// The component's sentence.
    pub reason: String,
}

impl Failure {
    /// True when the entry panicked.
    pub fn panicked(&self) -> bool {
        self.status == abi::STATUS_PANICKED
    }
}

impl Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (status {})", self.reason, self.status)
    }
}

impl std::error::Error for Failure {}

pub(crate) type Done = Result<(), Failure>;

/// State of the component, as `trocar ls` would say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Life {
    /// Made and not configured.
    Created,
    /// Configured, not started.
    Ready,
    /// Started: it steps.
    Active,
    /// Stopped; `resume` and `start` lead on.
    Stopped,
    /// An entry failed or panicked; only `reset` leads on.
    Fault,
}

impl Display for Life {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Life::Created => "CREATED",
            Life::Ready => "READY",
            Life::Active => "ACTIVE",
            Life::Stopped => "STOPPED",
            Life::Fault => "FAULT",
        })
    }
}

/// One component on the bench. Failures that a test does not ask for end it with the component's own
/// sentence.
pub struct Bench<C: Class> {
    pub(crate) table: &'static ClassTable,
    this: *mut c_void,
    pub(crate) host: Box<FakeHost>,
    host_table: Box<HostTable>,
    pub(crate) shape: Shape,
    pub(crate) inputs: Vec<Wired<InCell, InSlot>>,
    pub(crate) outputs: Vec<Wired<OutCell, OutSlot>>,
    pub(crate) functions: Vec<Wired<FnCell, FnSlot>>,
    pub(crate) events: Vec<Wired<EventCell, EventSlot>>,
    pub(crate) row: C::State,
    pub(crate) cycle: u64,
    pub(crate) history: History,
    pub(crate) system: FakeSystem,
    /// Logged since the last asking.
    pub(crate) lines: RefCell<Vec<LogLine>>,
    /// Last configuration, with defaults filled in.
    config: Map<String, Json>,
    made_safe: u64,
    life: Life,
    /// Which entry put it in FAULT, and why.
    fault: String,
    /// Each `make_safe` that refused.
    warnings: Vec<String>,
    counting: bool,
    class: PhantomData<C>,
}

impl<C: Class> Bench<C> {
    /// Creates, binds, configures with `config` (JSON) and starts.
    #[track_caller]
    pub fn new(config: impl Display) -> Self {
        let mut bench = Self::ready(config);
        if let Err(e) = bench.start() {
            panic!("start failed: {e}");
        }
        bench
    }

    /// Like `new`, without the start.
    #[track_caller]
    pub fn ready(config: impl Display) -> Self {
        let mut bench = Self::created();
        if let Err(e) = bench.configure(config) {
            panic!("configure failed: {e}");
        }
        bench
    }

    /// Creates and binds only.
    #[track_caller]
    pub fn created() -> Self {
        crate::forward::install_for_tests();
        let host = FakeHost::new();
        let host_table = host.table();
        let this = create::<C>(&host_table);
        let mut bench = Bench {
            table: Export::<C>::TABLE,
            this,
            host,
            host_table,
            shape: Shape::of::<C>(),
            inputs: Vec::new(),
            outputs: Vec::new(),
            functions: Vec::new(),
            events: Vec::new(),
            row: C::State::zeroed(),
            cycle: 0,
            history: History::default(),
            system: FakeSystem::default(),
            lines: RefCell::default(),
            config: Map::new(),
            made_safe: 0,
            life: Life::Created,
            fault: String::new(),
            warnings: Vec::new(),
            counting: false,
            class: PhantomData,
        };
        bench.describe();
        bench.bind();
        bench.publish();
        bench
    }

    /// The row published last: after create, and after each entry.
    pub fn state(&self) -> C::State {
        self.row
    }

    /// The lines logged in entries since the last asking, of the levels a host takes (`info` and above).
    pub fn logs(&mut self) -> Vec<LogLine> {
        self.lines.take()
    }

    /// Runs `f` and fails the test when the component allocated in one of its entries meanwhile. The test
    /// program says `trocar_sdk::testing::count_allocations!();` once.
    #[track_caller]
    pub fn assert_no_alloc(&mut self, f: impl FnOnce(&mut Self)) {
        assert!(
            alloc::installed(),
            "nothing counts allocations here: put `trocar_sdk::testing::count_allocations!();` into the test module"
        );
        alloc::take();
        self.counting = true;
        f(self);
        self.counting = false;
        let Count { times, first_bytes } = alloc::take();
        if times > 0 {
            let history = &self.history.text(&self.shape);
            panic!(
                "the component allocated {times} times, first {first_bytes} B: what `step` needs is made in \
                 `configure` or `start`{history}"
            );
        }
    }

    /// Threads that share the slices of `Host::parallel`, this one included: more than one shakes out races.
    pub fn threads(&mut self, threads: u32) {
        self.host.threads.store(threads.max(1), Ordering::Relaxed);
    }

    /// Runs one entry of the instance; then publishes the state row and remembers the outputs.
    pub(crate) fn enter(&mut self, f: impl FnOnce(*mut c_void, *mut ErrBuf) -> Status) -> Done {
        let logged = self.lines.borrow().len();
        let done = self.entry(f);
        self.publish();
        self.remember();
        for line in &self.lines.borrow()[logged..] {
            self.history.note(self.now().ns(), format!("{} {}", line.level, line.message));
        }
        if let Err(failure) = &done {
            self.history.note(self.now().ns(), format!("failed: {failure}"));
        }
        self.change_ports();
        done
    }

    /// Calls one entry with a buffer for its reason.
    pub(crate) fn entry(&self, f: impl FnOnce(*mut c_void, *mut ErrBuf) -> Status) -> Done {
        let mut text = [0u8; 512];
        let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
        let _inside = self.host.callbacks.keep_out();
        let logged = logs::begin();
        let armed = alloc::arm(self.counting);
        let status = f(self.this, &mut err);
        drop(armed);
        self.lines.borrow_mut().append(&mut logged.end());
        outcome(status, &text, &err)
    }

    fn publish(&mut self) {
        if let Some(copy) = self.table.state_copy {
            // SAFETY: a live instance; the row is this class's and has its size.
            unsafe { copy(self.this, (&raw mut self.row).cast(), size_of::<C::State>()) };
        }
    }

    fn remember(&mut self) {
        let now = self.now().ns();
        for (at, wired) in self.outputs.iter_mut().enumerate() {
            let cell = wired.get();
            for w in &cell.written[cell.told.min(cell.written.len())..] {
                self.history.value(now, Kind::Output, at, &w.header);
            }
            cell.told = cell.written.len();
        }
        for (at, wired) in self.events.iter_mut().enumerate() {
            let cell = wired.get();
            for bytes in &cell.emitted[cell.told.min(cell.emitted.len())..] {
                self.history.value(now, Kind::Event, at, bytes);
            }
            cell.told = cell.emitted.len();
        }
        for (at, wired) in self.functions.iter_mut().enumerate() {
            let cell = wired.get();
            for bytes in &cell.calls[cell.told.min(cell.calls.len())..] {
                self.history.value(now, Kind::Call, at, bytes);
            }
            cell.told = cell.calls.len();
        }
    }
}

impl<C: Class> Drop for Bench<C> {
    fn drop(&mut self) {
        self.destroy();
        if self.host.held.load(Ordering::Relaxed) {
            self.leave_all();
        }
    }
}

impl<C: Class> Bench<C> {
    /// Handles are left: the memory they point to stays until the process ends.
    fn leave_all(&mut self) {
        std::mem::take(&mut self.inputs).leak();
        std::mem::take(&mut self.outputs).leak();
        std::mem::take(&mut self.functions).leak();
        std::mem::take(&mut self.events).leak();
        let host = std::mem::replace(&mut self.host, FakeHost::new());
        Box::leak(std::mem::replace(&mut self.host_table, self.host.table()));
        Box::leak(host);
    }
}

#[track_caller]
fn create<C: Class>(host: &HostTable) -> *mut c_void {
    let create = Export::<C>::TABLE.create.unwrap_or_else(|| panic!("the class has no create"));
    let name = Bytes { ptr: C::DESC.name.as_ptr(), len: C::DESC.name.len() };
    let mut text = [0u8; 512];
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    // SAFETY: the table is static; the host outlives the instance by the order of the bench's fields and its
    // drop.
    let this = unsafe { create(host, name, &mut err) };
    if this.is_null()
        && let Err(e) = outcome(abi::STATUS_FAILED, &text, &err)
    {
        panic!("create failed: {e}");
    }
    this
}

fn outcome(status: Status, text: &[u8], err: &ErrBuf) -> Done {
    if status == abi::STATUS_OK {
        return Ok(());
    }
    Err(Failure { status, reason: String::from_utf8_lossy(&text[..err.len]).into_owned() })
}

unsafe extern "C" fn collect(ctx: *mut c_void, bytes: Bytes) {
    if bytes.len > 0 {
        // SAFETY: `ctx` is a vector of the bench's, the bytes are the component's.
        unsafe {
            (*ctx.cast::<Vec<u8>>()).extend_from_slice(core::slice::from_raw_parts(bytes.ptr, bytes.len));
        }
    }
}
