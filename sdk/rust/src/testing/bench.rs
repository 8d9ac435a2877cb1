//! The bench itself: life cycle, time, and everything a test pushes in or asks for.
//!
//! Invariant: the state row is published after each entry, as a host does it; reads see that row, never the instance.

use super::cells::{EventCell, FnCell, InCell, OutCell};
use super::fake_host::FakeHost;
use super::lookup::{self, Member};
use crate::call::Value;
use crate::component::Class;
use crate::payload::{Payload, as_bytes, from_bytes};
use crate::shims::Export;
use crate::values::Stamp;
use core::ffi::c_void;
use core::fmt::{self, Display};
use core::marker::PhantomData;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi::{
    self, Bytes, ClassTable, ErrBuf, EventSlot, FnSlot, HostTable, InSlot, OutSlot, Ports, Sink, Status,
};
use trocar_plugin_api::desc::PortType;

/// Period of a class that names none, ns.
const DEFAULT_PERIOD_NS: u64 = 1_000_000;

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

type Done = Result<(), Failure>;

/// One component on the bench. Failures that a test does not ask for end it with the component's own sentence.
pub struct Bench<C: Class> {
    table: &'static ClassTable,
    this: *mut c_void,
    host: Box<FakeHost>,
    _host_table: Box<HostTable>,
    inputs: Vec<Wired<InCell, InSlot>>,
    outputs: Vec<Wired<OutCell, OutSlot>>,
    functions: Vec<Wired<FnCell, FnSlot>>,
    events: Vec<Wired<EventCell, EventSlot>>,
    row: C::State,
    cycle: u64,
    class: PhantomData<C>,
}

/// A cell and the slot in front of it, both at fixed addresses.
struct Wired<Cell, Slot> {
    cell: *mut Cell,
    slot: Box<Slot>,
}

impl<Cell, Slot> Wired<Cell, Slot> {
    fn new(cell: Cell, slot: fn(*mut Cell) -> Slot) -> Self {
        let cell = Box::into_raw(Box::new(cell));
        Wired { cell, slot: Box::new(slot(cell)) }
    }

    fn get(&mut self) -> &mut Cell {
        // SAFETY: made in `new`, freed in drop; the component uses it only inside an entry, when the bench does not.
        unsafe { &mut *self.cell }
    }
}

impl<Cell, Slot> Drop for Wired<Cell, Slot> {
    fn drop(&mut self) {
        // SAFETY: made by `Box::into_raw` in `new`; the bench destroyed the component before.
        drop(unsafe { Box::from_raw(self.cell) });
    }
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
        crate::forward::install_hook();
        let class = C::DESC;
        let host = FakeHost::new();
        let host_table = host.table();
        let table = Export::<C>::TABLE;
        let create = table.create.unwrap_or_else(|| panic!("the class has no create"));
        let mut this = core::ptr::null_mut();
        let name = Bytes { ptr: class.name.as_ptr(), len: class.name.len() };
        let made = entry(|err| {
            // SAFETY: the table and the host live as long as the bench.
            this = unsafe { create(&*host_table, name, err) };
            if this.is_null() { abi::STATUS_FAILED } else { abi::STATUS_OK }
        });
        if let Err(e) = made {
            panic!("create failed: {e}");
        }
        let header = |ty| lookup::size(lookup::header(ty));
        let max_bytes = |ty| if let PortType::Frame { max_bytes, .. } = ty { max_bytes } else { 0 };
        let cell_of = |m: Member| (lookup::size(m.arg), lookup::size(m.ret));
        let mut bench = Bench {
            table,
            this,
            host,
            _host_table: host_table,
            inputs: class.inputs.iter().map(|i| Wired::new(InCell::new(i.fifo), InCell::slot)).collect(),
            outputs: class
                .outputs
                .iter()
                .map(|o| Wired::new(OutCell::new(header(o.ty), max_bytes(o.ty)), OutCell::slot))
                .collect(),
            functions: lookup::functions(class)
                .into_iter()
                .map(cell_of)
                .map(|(arg, ret)| Wired::new(FnCell::new(arg, ret), FnCell::slot))
                .collect(),
            events: lookup::events(class)
                .into_iter()
                .map(|m| Wired::new(EventCell::new(lookup::size(m.arg)), EventCell::slot))
                .collect(),
            row: C::State::zeroed(),
            cycle: 0,
            class: PhantomData,
        };
        bench.bind();
        bench.publish();
        bench
    }

    #[track_caller]
    fn bind(&mut self) {
        fn slots<Cell, Slot>(wired: &[Wired<Cell, Slot>]) -> Vec<*const Slot> {
            wired.iter().map(|w| &raw const *w.slot).collect()
        }
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
            // SAFETY: the slots live as long as the bench; the SDK copies the pointers during the call.
            if let Err(e) = entry(|err| unsafe { bind(self.this, &ports, err) }) {
                panic!("bind failed: {e}");
            }
        }
    }

    /// # Errors
    /// The component's sentence; its former configuration stays.
    pub fn configure(&mut self, config: impl Display) -> Done {
        let json = config.to_string();
        let bytes = Bytes { ptr: json.as_ptr(), len: json.len() };
        let f = self.table.configure;
        // SAFETY: a live instance; the text lives through the call.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, bytes, err) }))
    }

    /// # Errors
    /// The component's sentence.
    pub fn start(&mut self) -> Done {
        self.cycle = 0;
        self.plain(self.table.start)
    }

    /// # Errors
    /// The component's sentence.
    pub fn stop(&mut self) -> Done {
        self.plain(self.table.stop)
    }

    /// # Errors
    /// The component's sentence.
    pub fn resume(&mut self) -> Done {
        self.plain(self.table.resume)
    }

    /// # Errors
    /// The component's sentence.
    pub fn make_safe(&mut self) -> Done {
        self.plain(self.table.make_safe)
    }

    /// `cycles` steps, each one period of virtual time after the other.
    #[track_caller]
    pub fn step(&mut self, cycles: u64) {
        for _ in 0..cycles {
            if let Err(e) = self.try_step() {
                panic!("step {} failed: {e}", self.cycle);
            }
        }
    }

    /// # Errors
    /// The component's sentence; in a host it would be in FAULT now.
    pub fn try_step(&mut self) -> Done {
        let class = C::DESC;
        let elapsed_ns = if class.period_ns > 0 { class.period_ns } else { DEFAULT_PERIOD_NS };
        let now_ns = self.host.now_ns.fetch_add(elapsed_ns, Ordering::Relaxed) + elapsed_ns;
        let tick = abi::Tick {
            struct_size: size_of::<abi::Tick>() as u32,
            flags: 0,
            cycle: self.cycle,
            now_ns,
            deadline_ns: now_ns,
            period_ns: class.period_ns,
            elapsed_ns,
        };
        self.cycle += 1;
        let f = self.table.step;
        self.host.in_step.store(true, Ordering::Relaxed);
        // SAFETY: a live instance; the tick lives through the call.
        let done = self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, &tick, err) }));
        self.host.in_step.store(false, Ordering::Relaxed);
        done
    }

    /// Now on the virtual clock.
    pub fn now(&self) -> Stamp {
        Stamp::from_ns(self.host.now_ns.load(Ordering::Relaxed))
    }

    /// Lets `ns` of virtual time pass without a step.
    pub fn advance(&mut self, ns: u64) {
        self.host.now_ns.fetch_add(ns, Ordering::Relaxed);
    }

    /// Writes a plain sample to an input, stamped now unless it has its own stamp.
    #[track_caller]
    pub fn push<T: Payload>(&mut self, input: &str, value: T) {
        self.push_bytes::<T>(input, &value, &[], false);
    }

    /// Writes a frame to an input.
    #[track_caller]
    pub fn push_frame<H: Payload>(&mut self, input: &str, header: H, bytes: &[u8]) {
        self.push_bytes::<H>(input, &header, bytes, true);
    }

    #[track_caller]
    fn push_bytes<T: Payload>(&mut self, input: &str, header: &T, bytes: &[u8], frame: bool) {
        let at = input_at::<C>(input);
        let ty = C::DESC.inputs[at].ty;
        let fits = match ty {
            PortType::Plain(_) => !frame,
            PortType::Frame { .. } => frame,
            PortType::Any => true,
        };
        assert!(fits, "input `{input}`: plain samples go in with `push`, frames with `push_frame`");
        if let Some(have) = lookup::header(ty) {
            lookup::expect_type("input", input, Some(have), Some(T::DESC));
        }
        let own = header.stamp_ns();
        let stamp = if own != 0 { own } else { self.now().ns() };
        self.inputs[at].get().push(as_bytes(header), bytes, stamp);
    }

    /// Makes an input's newest sample older than its connection's `max_age`, until the next push.
    #[track_caller]
    pub fn make_stale(&mut self, input: &str) {
        self.inputs[input_at::<C>(input)].get().stale = true;
    }

    /// Cuts or restores the connection of an input.
    #[track_caller]
    pub fn connect_input(&mut self, input: &str, connected: bool) {
        self.inputs[input_at::<C>(input)].get().connected = connected;
    }

    /// Cuts or restores the connection of a function.
    #[track_caller]
    pub fn connect_function(&mut self, function: &str, connected: bool) {
        let at = lookup::member("function", function, lookup::functions(C::DESC)).id;
        self.functions[at].get().connected = connected;
    }

    /// Lets an output have no free frame (or has it again).
    #[track_caller]
    pub fn exhaust(&mut self, output: &str, exhausted: bool) {
        self.outputs[output_at::<C>(output)].get().exhausted = exhausted;
    }

    /// Everything an output wrote since the last asking.
    #[track_caller]
    pub fn outputs<T: Payload>(&mut self, output: &str) -> Vec<T> {
        self.samples(output).into_iter().map(|(value, _)| value).collect()
    }

    /// Like `outputs`, with stamps.
    #[track_caller]
    pub fn samples<T: Payload>(&mut self, output: &str) -> Vec<(T, Stamp)> {
        self.frames::<T>(output).into_iter().map(|(value, _, stamp)| (value, stamp)).collect()
    }

    /// Everything an output committed since the last asking: header, bytes, stamp.
    #[track_caller]
    pub fn frames<H: Payload>(&mut self, output: &str) -> Vec<(H, Vec<u8>, Stamp)> {
        let at = output_at::<C>(output);
        lookup::expect_type("output", output, lookup::header(C::DESC.outputs[at].ty), Some(H::DESC));
        let written = std::mem::take(&mut self.outputs[at].get().written);
        let typed = written.into_iter().map(|w| (typed::<H>(&w.header), w.bytes, Stamp::from_ns(w.stamp_ns)));
        typed.collect()
    }

    /// Everything an event emitted since the last asking; `event` or `interface/event`.
    #[track_caller]
    pub fn events<T: Value>(&mut self, event: &str) -> Vec<T> {
        let m = lookup::member("event", event, lookup::events(C::DESC));
        lookup::expect_type("event", event, m.arg, T::DESC);
        let emitted = std::mem::take(&mut self.events[m.id].get().emitted);
        emitted.iter().map(|bytes| value(bytes)).collect()
    }

    /// The arguments a function was called with since the last asking; `function` or `interface/function`.
    #[track_caller]
    pub fn calls<A: Value>(&mut self, function: &str) -> Vec<A> {
        let m = lookup::member("function", function, lookup::functions(C::DESC));
        lookup::expect_type("function", function, m.arg, A::DESC);
        let calls = std::mem::take(&mut self.functions[m.id].get().calls);
        calls.iter().map(|bytes| value(bytes)).collect()
    }

    /// Lets a fake peer answer a function, inline. An error text becomes the outcome FAILED.
    #[track_caller]
    pub fn answer<A: Value, R: Value>(
        &mut self,
        function: &str,
        mut f: impl FnMut(A) -> Result<R, String> + 'static,
    ) {
        let m = lookup::member("function", function, lookup::functions(C::DESC));
        lookup::expect_type("function", function, m.arg, A::DESC);
        lookup::expect_type("result of function", function, m.ret, R::DESC);
        self.functions[m.id].get().answer = Some(Box::new(move |arg| match f(value(arg)) {
            Ok(ret) => Ok(value_bytes(&ret)),
            Err(reason) => Err((abi::FAILED, reason)),
        }));
    }

    /// Executes a command; `command` or `interface/command`. `()` stands for no argument and for no result.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn command<A: Value, R: Value>(&mut self, command: &str, arg: A) -> Result<R, Failure> {
        let m = self.command_of::<A, R>(command, false);
        let (f, mut ret) = (self.table.command, R::blank());
        let (id, result) = (m.id as u32, ret.ptr_mut());
        self.enter(|this, err| match f {
            // SAFETY: a live instance; argument and result have the types of the description, checked above.
            Some(f) => unsafe { f(this, id, arg.ptr(), result, err) },
            None => abi::STATUS_UNSUPPORTED,
        })?;
        Ok(ret)
    }

    /// Executes a read on the row published last.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn read<A: Value, R: Value>(&self, read: &str, arg: A) -> Result<R, Failure> {
        let m = self.command_of::<A, R>(read, true);
        let mut ret = R::blank();
        let (row, result) = ((&raw const self.row).cast(), ret.ptr_mut());
        entry(|err| match self.table.read {
            // SAFETY: the row is this class's; argument and result have the types of the description, checked above.
            Some(f) => unsafe { f(row, m.id as u32, arg.ptr(), result, err) },
            None => abi::STATUS_UNSUPPORTED,
        })?;
        Ok(ret)
    }

    #[track_caller]
    fn command_of<A: Value, R: Value>(&self, name: &str, is_read: bool) -> Member {
        let m = lookup::member("command", name, lookup::commands(C::DESC));
        assert!(m.is_read == is_read, "`{name}`: reads go with `read`, the other kinds with `command`");
        lookup::expect_type("argument of", name, m.arg, A::DESC);
        lookup::expect_type("result of", name, m.ret, R::DESC);
        m
    }

    /// Lets the connected peer emit an event of a required interface; `event` or `interface/event`.
    ///
    /// # Errors
    /// The component's sentence.
    #[track_caller]
    pub fn emit<T: Value>(&mut self, event: &str, payload: T) -> Done {
        let m = lookup::member("handler", event, lookup::handlers(C::DESC));
        lookup::expect_type("handler", event, m.arg, T::DESC);
        let (f, id) = (self.table.on_event, m.id as u32);
        self.enter(|this, err| match f {
            // SAFETY: a live instance; the payload has the type of the description, checked above.
            Some(f) => unsafe { f(this, id, payload.ptr(), err) },
            None => abi::STATUS_UNSUPPORTED,
        })
    }

    /// The row published last: after create, and after each entry.
    pub fn state(&self) -> C::State {
        self.row
    }

    /// Services asked for since the last asking: token and JSON.
    pub fn services(&mut self) -> Vec<(u64, String)> {
        std::mem::take(&mut self.host.services.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Answers a service.
    ///
    /// # Errors
    /// The component refused the reply.
    pub fn reply(&mut self, token: u64, reply: &str) -> Done {
        let (f, bytes) = (self.table.on_service, Bytes { ptr: reply.as_ptr(), len: reply.len() });
        // SAFETY: a live instance; the text lives through the call.
        self.enter(|this, _| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, token, bytes) }))
    }

    /// What a swap takes along: the bytes of the state row, and the snapshot.
    pub fn snapshot(&mut self) -> (Vec<u8>, Vec<u8>) {
        unsafe extern "C" fn write(ctx: *mut c_void, bytes: Bytes) {
            // SAFETY: `ctx` is the vector below, the bytes are the component's.
            unsafe {
                (*ctx.cast::<Vec<u8>>()).extend_from_slice(core::slice::from_raw_parts(bytes.ptr, bytes.len));
            }
        }
        let mut taken: Vec<u8> = Vec::new();
        if let Some(f) = self.table.snapshot {
            let sink = Sink { ctx: (&raw mut taken).cast(), write };
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

    fn plain(&mut self, f: Option<unsafe extern "C" fn(*mut c_void, *mut ErrBuf) -> Status>) -> Done {
        // SAFETY: a live instance.
        self.enter(|this, err| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, err) }))
    }

    /// One entry of the instance, then the state row is published.
    fn enter(&mut self, f: impl FnOnce(*mut c_void, *mut ErrBuf) -> Status) -> Done {
        let this = self.this;
        let done = entry(|err| f(this, err));
        self.publish();
        done
    }

    fn publish(&mut self) {
        if let Some(copy) = self.table.state_copy {
            // SAFETY: a live instance; the row is this class's and has its size.
            unsafe { copy(self.this, (&raw mut self.row).cast(), size_of::<C::State>()) };
        }
    }
}

impl<C: Class> Drop for Bench<C> {
    fn drop(&mut self) {
        if let Some(destroy) = self.table.destroy {
            // SAFETY: the instance's last use; cells, slots and host are dropped after it.
            unsafe { destroy(self.this) };
        }
    }
}

/// Calls one entry with a buffer for its reason.
fn entry(f: impl FnOnce(*mut ErrBuf) -> Status) -> Done {
    let mut text = [0u8; 512];
    let mut err = ErrBuf { ptr: text.as_mut_ptr(), cap: text.len(), len: 0 };
    let status = f(&mut err);
    if status == abi::STATUS_OK {
        return Ok(());
    }
    Err(Failure { status, reason: String::from_utf8_lossy(&text[..err.len]).into_owned() })
}

#[track_caller]
fn input_at<C: Class>(name: &str) -> usize {
    let names: Vec<&str> = C::DESC.inputs.iter().map(|i| i.name).collect();
    lookup::port("input", name, &names)
}

#[track_caller]
fn output_at<C: Class>(name: &str) -> usize {
    let names: Vec<&str> = C::DESC.outputs.iter().map(|o| o.name).collect();
    lookup::port("output", name, &names)
}

fn typed<T: Payload>(bytes: &[u8]) -> T {
    from_bytes(bytes).unwrap_or_else(T::zeroed)
}

/// A value from recorded bytes; none are recorded for `()`.
fn value<T: Value>(bytes: &[u8]) -> T {
    let mut value = T::blank();
    if bytes.len() == size_of::<T>() && !bytes.is_empty() {
        // SAFETY: the length is the value's, and `ptr_mut` points to it.
        unsafe { core::ptr::copy_nonoverlapping(bytes.as_ptr(), value.ptr_mut().cast(), bytes.len()) };
    }
    value
}

fn value_bytes<T: Value>(value: &T) -> Vec<u8> {
    if size_of::<T>() == 0 {
        return Vec::new();
    }
    // SAFETY: a value is a payload, whose bytes are all initialised.
    unsafe { core::slice::from_raw_parts(value.ptr().cast::<u8>(), size_of::<T>()).to_vec() }
}
