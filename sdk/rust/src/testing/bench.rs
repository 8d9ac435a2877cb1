//! The bench itself: makes a component, ties its ports to cells, and takes it through its life.
//!
//! Invariant: the state row is published after each entry, as a host does it; reads see that row, never the instance.

use super::alloc::{self, Count};
use super::cells::{InCell, OutCell};
use super::fake_host::FakeHost;
use super::history::{History, Kind};
use super::logs::{self, LogLine};
use super::member_cells::{EventCell, FnCell};
use super::services::Replier;
use super::shape::{self, Member, Of, Shape};
use super::wired::Wired;
use crate::component::Class;
use crate::payload::{Payload, as_bytes};
use crate::shims::Export;
use core::ffi::c_void;
use core::fmt::{self, Display};
use core::marker::PhantomData;
use serde_json::{Map, Value as Json};
use std::cell::RefCell;
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi::{
    self, Bytes, ClassTable, ErrBuf, EventSlot, FnSlot, HostTable, InSlot, OutSlot, Ports, Sink, Status,
};
use trocar_plugin_api::manifest::PortType;

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

/// One component on the bench. Failures that a test does not ask for end it with the component's own sentence.
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
    pub(crate) repliers: Vec<Replier>,
    /// Logged since the last asking.
    pub(crate) lines: RefCell<Vec<LogLine>>,
    /// What was configured last, with defaults filled in.
    config: Map<String, Json>,
    made_safe: u64,
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
            repliers: Vec::new(),
            lines: RefCell::default(),
            config: Map::new(),
            made_safe: 0,
            counting: false,
            class: PhantomData,
        };
        bench.describe();
        bench.bind();
        bench.publish();
        bench
    }

    /// Asks a class with changing ports what it has now.
    #[track_caller]
    fn describe(&mut self) {
        let Some(describe) = self.table.describe else { return };
        let mut json: Vec<u8> = Vec::new();
        let sink = Sink { ctx: (&raw mut json).cast(), write: collect };
        // SAFETY: a live instance; the sink lives through the call.
        let status = unsafe { describe(self.this, &sink) };
        assert!(status == abi::STATUS_OK, "describe failed with status {status}");
        self.shape = Shape::read(&json).unwrap_or_else(|why| panic!("{why}"));
    }

    /// Ties every port; what stays by name keeps its cell, and with it what is queued in it.
    #[track_caller]
    fn bind(&mut self) {
        fn slots<Cell, Slot>(wired: &[Wired<Cell, Slot>]) -> Vec<*const Slot> {
            wired.iter().map(Wired::slot).collect()
        }
        let _left_over = self.wire();
        let (inputs, outputs) = (slots(&self.inputs), slots(&self.outputs));
        let (functions, events) = (slots(&self.functions), slots(&self.events));
        let ports = Ports {
            struct_size: size_of::<Ports>() as u32,
            output_count: outputs.len() as u32,
            input_count: inputs.len() as u32,
            function_count: functions.len() as u32,
            event_count: events.len() as u32,
            reserved: 0,
            outputs: outputs.as_ptr(),
            inputs: inputs.as_ptr(),
            functions: functions.as_ptr(),
            events: events.as_ptr(),
        };
        if let Some(bind) = self.table.bind {
            // SAFETY: the slots live until the next bind; the SDK copies the pointers during the call.
            if let Err(e) = self.entry(|this, err| unsafe { bind(this, &ports, err) }) {
                panic!("bind failed: {e}");
            }
        }
    }

    #[allow(clippy::type_complexity)] // Only held until the component is bound.
    fn wire(
        &mut self,
    ) -> (
        Vec<Wired<InCell, InSlot>>,
        Vec<Wired<OutCell, OutSlot>>,
        Vec<Wired<FnCell, FnSlot>>,
        Vec<Wired<EventCell, EventSlot>>,
    ) {
        let class = self.shape.class();
        let max_bytes =
            |ty: &PortType| if let PortType::Frame { max_bytes, .. } = ty { *max_bytes } else { 0 };
        let inputs = class.inputs.iter().map(|i| (key(&i.name, &i.ty), InCell::new(i.fifo)));
        let outputs = class.outputs.iter().map(|o| {
            let size = self.shape.size(shape::header(&o.ty));
            (key(&o.name, &o.ty), OutCell::new(size, max_bytes(&o.ty), matches!(o.ty, PortType::Any(_))))
        });
        let sizes = |m: &Member| (self.shape.size(m.arg.as_ref()), self.shape.size(m.ret.as_ref()));
        let functions = self.shape.members(Of::Functions).into_iter().map(|m| {
            let (arg, ret) = sizes(&m);
            (key(&m.path, &(&m.arg, &m.ret)), FnCell::new(arg, ret, m.any))
        });
        let events = self.shape.members(Of::Events).into_iter().map(|m| {
            let size = self.shape.size(m.arg.as_ref());
            (key(&m.path, &m.arg), EventCell::new(size))
        });
        (
            Wired::rewire(&mut self.inputs, inputs, InCell::slot),
            Wired::rewire(&mut self.outputs, outputs, OutCell::slot),
            Wired::rewire(&mut self.functions, functions, FnCell::slot),
            Wired::rewire(&mut self.events, events, EventCell::slot),
        )
    }

    /// After an entry: a component that asked for other ports gets them between two steps, as from a host.
    fn change_ports(&mut self) {
        if self.host.ports_changed.swap(false, Ordering::Relaxed) {
            self.describe();
            self.bind();
        }
    }

    /// Configures as a host does: of a started component only settings that are `live` may change.
    ///
    /// # Errors
    /// The host's or the component's sentence; its former configuration stays.
    pub fn configure(&mut self, config: impl Display) -> Done {
        let json = config.to_string();
        self.history.note(self.now().ns(), format!("configure {json}"));
        let wanted = whole::<C>(&json);
        if self.is_active()
            && let Some(wanted) = &wanted
            && let Some(fixed) = super::config::fixed_change(C::DESC, &self.config, wanted)
        {
            return Err(Failure { status: abi::STATUS_INVALID, reason: fixed });
        }
        let bytes = Bytes { ptr: json.as_ptr(), len: json.len() };
        let f = self.table.configure;
        // SAFETY: a live instance; the text lives through the call.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, bytes, err) }))?;
        self.config = wanted.unwrap_or_default();
        self.host.ports_changed.store(self.table.describe.is_some(), Ordering::Relaxed);
        self.change_ports();
        Ok(())
    }

    /// # Errors
    /// The component's sentence; it was made safe then, as everywhere below.
    pub fn start(&mut self) -> Done {
        self.cycle = 0;
        self.plain("start", self.table.start).map_err(|e| self.failed(e))?;
        self.set_active(true);
        Ok(())
    }

    /// `stop` and then `make_safe`, as a host does.
    ///
    /// # Errors
    /// The component's sentence.
    pub fn stop(&mut self) -> Done {
        self.set_active(false);
        self.plain("stop", self.table.stop).map_err(|e| self.failed(e))?;
        self.make_safe()
    }

    /// # Errors
    /// The component's sentence.
    pub fn resume(&mut self) -> Done {
        self.plain("resume", self.table.resume).map_err(|e| self.failed(e))?;
        self.set_active(true);
        Ok(())
    }

    /// What a host does with a component whose entry failed.
    pub(crate) fn failed(&mut self, failure: Failure) -> Failure {
        self.set_active(false);
        // The first failure is the one to tell.
        let _ = self.make_safe();
        failure
    }

    /// Stopped without being asked: no step begins any more.
    pub(crate) fn halt(&mut self) -> Done {
        self.set_active(false);
        self.make_safe()
    }

    /// # Errors
    /// The component's sentence.
    pub fn make_safe(&mut self) -> Done {
        self.made_safe += 1;
        self.plain("make_safe", self.table.make_safe)
    }

    /// How often `make_safe` was called: by the test, by `stop` and `lose_peer`, and after an entry that failed.
    pub fn made_safe(&self) -> u64 {
        self.made_safe
    }

    /// Another instance in the place of this one, configured the same, not started: what Reset does. Connections stay.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn reset(&mut self) -> Done {
        self.history.note(self.now().ns(), "reset".to_string());
        let config = std::mem::take(&mut self.config);
        self.destroy();
        self.this = create::<C>(&self.host_table);
        self.set_active(false);
        self.cycle = 0;
        self.describe();
        self.bind();
        self.publish();
        self.configure(Json::Object(config))
    }

    /// What a swap takes along: the bytes of the state row, and the snapshot.
    pub fn snapshot(&mut self) -> (Vec<u8>, Vec<u8>) {
        let mut taken: Vec<u8> = Vec::new();
        if let Some(f) = self.table.snapshot {
            let sink = Sink { ctx: (&raw mut taken).cast(), write: collect };
            // SAFETY: a live instance; the sink lives through the call.
            unsafe { f(self.this, &sink) };
        }
        (as_bytes(&self.row).to_vec(), taken)
    }

    /// Takes what [`Bench::snapshot`] of another bench gave.
    ///
    /// # Errors
    /// The component's sentence.
    pub fn restore(&mut self, state: &[u8], snapshot: &[u8]) -> Done {
        let bytes = |b: &[u8]| Bytes { ptr: b.as_ptr(), len: b.len() };
        let (f, state, snapshot) = (self.table.restore, bytes(state), bytes(snapshot));
        // SAFETY: a live instance; both slices live through the call.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, state, snapshot, err) }))
    }

    /// The row published last: after create, and after each entry.
    pub fn state(&self) -> C::State {
        self.row
    }

    /// Runs `f` and fails the test when the component allocated in one of its entries meanwhile. The test program says
    /// `trocar_sdk::testing::count_allocations!();` once.
    #[track_caller]
    pub fn assert_no_alloc(&mut self, f: impl FnOnce(&mut Self)) {
        assert!(
            alloc::installed(),
            "nothing counts allocations here: put `trocar_sdk::count_allocations!();` into the test module"
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

    fn is_active(&self) -> bool {
        self.host.active.load(Ordering::Relaxed)
    }

    fn set_active(&mut self, active: bool) {
        self.host.active.store(active, Ordering::Relaxed);
    }

    fn plain(
        &mut self,
        name: &str,
        f: Option<unsafe extern "C" fn(*mut c_void, *mut ErrBuf) -> Status>,
    ) -> Done {
        self.history.note(self.now().ns(), name.to_string());
        // SAFETY: a live instance.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, err) }))
    }

    /// One entry of the instance; then the state row is published, and what came out is remembered.
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

    fn destroy(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: the instance's last use; the caller makes another one or drops cells, slots and host after it.
            unsafe { destroy(self.this) };
        }
    }
}

impl<C: Class> Drop for Bench<C> {
    fn drop(&mut self) {
        self.destroy();
    }
}

/// What makes a port the same as before: its name and type.
fn key(name: &str, ty: &impl fmt::Debug) -> String {
    format!("{name} {ty:?}")
}

#[track_caller]
fn create<C: Class>(host: &HostTable) -> *mut c_void {
    let create = Export::<C>::TABLE.create.unwrap_or_else(|| panic!("the class has no create"));
    let name = Bytes { ptr: C::DESC.name.as_ptr(), len: C::DESC.name.len() };
    let mut text = [0u8; 512];
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    // SAFETY: the table is static; the host outlives the instance by the order of the bench's fields and its drop.
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

/// The configuration with defaults filled in; none when it is no object, which the component refuses itself.
fn whole<C: Class>(json: &str) -> Option<Map<String, Json>> {
    let mut given = if json.is_empty() { Map::new() } else { serde_json::from_str(json).ok()? };
    for field in C::DESC.config {
        if let (false, Ok(default)) = (given.contains_key(field.name), serde_json::from_str(field.default)) {
            given.insert(field.name.to_string(), default);
        }
    }
    Some(given)
}

unsafe extern "C" fn collect(ctx: *mut c_void, bytes: Bytes) {
    if bytes.len > 0 {
        // SAFETY: `ctx` is a vector of the bench's, the bytes are the component's.
        unsafe {
            (*ctx.cast::<Vec<u8>>()).extend_from_slice(core::slice::from_raw_parts(bytes.ptr, bytes.len));
        }
    }
}
