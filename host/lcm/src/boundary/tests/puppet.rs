//! A hand-made component class whose entries do what a test says.
//!
//! Invariant: everything goes through the tables a plugin has: class table in, slots and host table out.

use std::collections::HashMap;
use std::ffi::c_void;
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicPtr, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

use serde_json::Value;
use trocar_model::ComponentId;
use trocar_plugin_api::abi::*;

use crate::LoadedClass;

type Act = Box<dyn Fn(&Stage) -> Status + Send + Sync>;
type Told = Box<dyn Fn(&Stage, u32, u64) -> Status + Send + Sync>;
type Asked = Box<dyn Fn(&Stage, u32, u64) -> Result<u64, Status> + Send + Sync>;

/// Actions of one component's entries.
#[derive(Default)]
pub(super) struct Script {
    pub(super) step: Option<Act>,
    pub(super) configure: Option<Act>,
    /// Command id and argument (0 without one) → result.
    pub(super) command: Option<Asked>,
    /// Handler id and payload.
    pub(super) on_event: Option<Told>,
    /// Text that `describe` writes; while it is empty the class offers no description.
    pub(super) described: Mutex<String>,
}

/// One instance: the host's tables for it, and a state of one u64.
pub(super) struct Stage {
    script: Arc<Script>,
    host: AtomicPtr<HostTable>,
    ports: AtomicPtr<Ports>,
    pub(super) state: AtomicU64,
    /// Values that its entries noted.
    pub(super) seen: Mutex<Vec<u64>>,
}

/// State on which a read panics.
pub(super) const READ_PANICS: u64 = 66;

/// Scripts by instance name, then the stages made of them.
static SCRIPTS: LazyLock<Mutex<HashMap<String, Arc<Script>>>> = LazyLock::new(Default::default);
static STAGES: LazyLock<Mutex<HashMap<String, usize>>> = LazyLock::new(Default::default);

fn stage<'a>(this: *mut c_void) -> &'a Stage {
    // SAFETY: made by `create`, and tests end their worlds before they forget a stage.
    unsafe { &*this.cast::<Stage>() }
}

fn text<'a>(bytes: Bytes) -> &'a str {
    // SAFETY: the host lends `len` bytes of UTF-8 for the call.
    std::str::from_utf8(unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) }).unwrap()
}

unsafe extern "C" fn create(host: *const HostTable, name: Bytes, _: *mut ErrBuf) -> *mut c_void {
    let name = text(name).to_owned();
    let script = SCRIPTS.lock().unwrap()[&name].clone();
    let stage = Box::into_raw(Box::new(Stage {
        script,
        host: AtomicPtr::new(host.cast_mut()),
        ports: AtomicPtr::new(null_mut()),
        state: AtomicU64::new(0),
        seen: Mutex::new(Vec::new()),
    }));
    STAGES.lock().unwrap().insert(name, stage as usize);
    stage.cast()
}

/// Stages stay: tests look at them when their component is gone.
unsafe extern "C" fn destroy(_: *mut c_void) {}

unsafe extern "C" fn configure(this: *mut c_void, _: Bytes, _: *mut ErrBuf) -> Status {
    stage(this).script.configure.as_ref().map_or(STATUS_OK, |f| f(stage(this)))
}

unsafe extern "C" fn describe(this: *mut c_void, sink: *const Sink) -> Status {
    let described = stage(this).script.described.lock().unwrap().clone();
    if described.is_empty() {
        return STATUS_UNSUPPORTED;
    }
    for piece in described.as_bytes().chunks(1000) {
        // SAFETY: the host's sink lives for the call.
        unsafe { ((*sink).write)((*sink).ctx, Bytes { ptr: piece.as_ptr(), len: piece.len() }) };
    }
    STATUS_OK
}

unsafe extern "C" fn bind(this: *mut c_void, ports: *const Ports, _: *mut ErrBuf) -> Status {
    stage(this).ports.store(ports.cast_mut(), Ordering::Release);
    STATUS_OK
}

unsafe extern "C" fn plain(_: *mut c_void, _: *mut ErrBuf) -> Status {
    STATUS_OK
}

unsafe extern "C" fn step(this: *mut c_void, _: *const Tick, err: *mut ErrBuf) -> Status {
    let status = stage(this).script.step.as_ref().map_or(STATUS_OK, |f| f(stage(this)));
    say(err, status)
}

/// A sentence for a failure.
fn say(err: *mut ErrBuf, status: Status) -> Status {
    // SAFETY: null or a buffer of the host.
    if let Some(err) = unsafe { err.as_mut() }
        && status < STATUS_OK
    {
        let text = b"as the test wants";
        // SAFETY: the host's buffers have room for a sentence.
        unsafe { err.ptr.copy_from_nonoverlapping(text.as_ptr(), text.len()) };
        err.len = text.len();
    }
    status
}

unsafe extern "C" fn command(
    this: *mut c_void,
    id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: the first command of each interface is void; all others of the tests take one u64.
    let arg = if id.is_multiple_of(4) { 0 } else { unsafe { arg.cast::<u64>().read() } };
    match stage(this).script.command.as_ref().map_or(Ok(0), |f| f(stage(this), id, arg)) {
        Ok(value) => {
            if id % 4 >= 2 {
                // SAFETY: the third and fourth of each interface return a u64.
                unsafe { ret.cast::<u64>().write(value) };
            }
            STATUS_OK
        }
        Err(status) => say(err, status),
    }
}

unsafe extern "C" fn read(
    row: *const c_void,
    _: u32,
    _: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: the state is one u64, and so is the result.
    let value = unsafe { row.cast::<u64>().read() };
    if value == READ_PANICS {
        return say(err, STATUS_PANICKED);
    }
    // SAFETY: as above.
    unsafe { ret.cast::<u64>().write(value) };
    STATUS_OK
}

unsafe extern "C" fn on_event(this: *mut c_void, id: u32, payload: *const c_void, _: *mut ErrBuf) -> Status {
    // SAFETY: events of the tests carry one u64.
    let payload = unsafe { payload.cast::<u64>().read() };
    stage(this).script.on_event.as_ref().map_or(STATUS_OK, |f| f(stage(this), id, payload))
}

unsafe extern "C" fn state_copy(this: *mut c_void, dst: *mut c_void, _: usize) {
    // SAFETY: the state is one u64.
    unsafe { dst.cast::<u64>().write(stage(this).state.load(Ordering::Relaxed)) };
}

static TABLE: Table = Table(ClassTable {
    struct_size: size_of::<ClassTable>() as u32,
    flags: 0,
    name: Bytes { ptr: null(), len: 0 },
    create: Some(create),
    destroy: Some(destroy),
    configure: Some(configure),
    describe: Some(describe),
    bind: Some(bind),
    start: Some(plain),
    stop: Some(plain),
    resume: Some(plain),
    make_safe: Some(plain),
    step: Some(step),
    command: Some(command),
    read: Some(read),
    on_event: Some(on_event),
    on_service: None,
    state_copy: Some(state_copy),
    snapshot: None,
    restore: None,
    extension: None,
});

/// Table of a class with neither ports nor state.
static MUTE_TABLE: Table = Table(ClassTable {
    struct_size: size_of::<ClassTable>() as u32,
    flags: 0,
    name: Bytes { ptr: null(), len: 0 },
    create: Some(create),
    destroy: Some(destroy),
    configure: Some(configure),
    describe: Some(describe),
    bind: None,
    start: Some(plain),
    stop: Some(plain),
    resume: Some(plain),
    make_safe: Some(plain),
    step: Some(step),
    command: None,
    read: None,
    on_event: None,
    on_service: None,
    state_copy: Some(state_copy),
    snapshot: None,
    restore: None,
    extension: None,
});

struct Table(ClassTable);
// SAFETY: immutable; its name points nowhere.
unsafe impl Sync for Table {}

/// The one class of all puppets.
pub(super) fn loaded_class() -> LoadedClass {
    // SAFETY: a static table.
    unsafe { LoadedClass::new(&raw const TABLE.0, Arc::new(())) }
}

/// Name of the class whose table has no entries for ports.
pub(super) const MUTE: &str = "mute";

pub(super) fn mute_class() -> LoadedClass {
    // SAFETY: a static table.
    unsafe { LoadedClass::new(&raw const MUTE_TABLE.0, Arc::new(())) }
}

/// Sets the script of the instance of this name; before it is created.
pub(super) fn enrol(id: &ComponentId, script: Script) {
    SCRIPTS.lock().unwrap().insert(id.to_string(), Arc::new(script));
}

pub(super) fn script_of(id: &ComponentId) -> Arc<Script> {
    SCRIPTS.lock().unwrap()[&id.to_string()].clone()
}

/// The newest instance of this name.
pub(super) fn stage_of(id: &ComponentId) -> &'static Stage {
    let address = STAGES.lock().unwrap()[&id.to_string()];
    stage(address as *mut c_void)
}

/// Result of a call.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Called {
    pub(super) outcome: Outcome,
    pub(super) ret: u64,
    pub(super) text: String,
    pub(super) may_still_run: bool,
}

/// A sample as an input showed it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shown {
    pub(super) header: Vec<u8>,
    pub(super) bytes: Vec<u8>,
    pub(super) address: usize,
    pub(super) seq: u64,
    pub(super) writable: bool,
}

/// Room for a loan, as a plugin prepares it.
pub(super) fn no_loan() -> Loan {
    Loan {
        struct_size: size_of::<Loan>() as u32,
        flags: 0,
        header: null_mut(),
        bytes: null_mut(),
        capacity: 0,
        token: 0,
    }
}

/// Room for a view, as a plugin prepares it.
pub(super) fn no_view() -> SampleView {
    SampleView {
        struct_size: size_of::<SampleView>() as u32,
        flags: 0,
        header: null(),
        bytes: null(),
        len: 0,
        stamp_ns: 0,
        seq: 0,
        token: 0,
    }
}

unsafe extern "C" fn collect(ctx: *mut c_void, bytes: Bytes) {
    // SAFETY: the String of `described`.
    unsafe { &mut *ctx.cast::<String>() }.push_str(text(bytes));
}

impl Stage {
    fn ports(&self) -> &Ports {
        // SAFETY: the table that `bind` gave, valid until the next `bind`.
        unsafe { &*self.ports.load(Ordering::Acquire) }
    }

    pub(super) fn host(&self) -> &HostTable {
        // SAFETY: the host's table outlives the instance.
        unsafe { &*self.host.load(Ordering::Acquire) }
    }

    pub(super) fn function(&self, function: usize) -> &FnSlot {
        // SAFETY: a slot of this instance, valid until the next `bind`; so are those below.
        unsafe { &**self.ports().functions.add(function) }
    }

    pub(super) fn output(&self, output: usize) -> &OutSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().outputs.add(output) }
    }

    pub(super) fn input(&self, input: usize) -> &InSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().inputs.add(input) }
    }

    pub(super) fn event(&self, event: usize) -> &EventSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().events.add(event) }
    }

    pub(super) fn counts(&self) -> [u32; 4] {
        let p = self.ports();
        [p.output_count, p.input_count, p.function_count, p.event_count]
    }

    pub(super) fn call(&self, function: usize, arg: u64, mode: u32, deadline: Duration) -> Called {
        let mut room = [0u8; 128];
        let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
        let mut opts = CallOpts {
            struct_size: size_of::<CallOpts>() as u32,
            mode,
            deadline_ns: deadline.as_nanos() as u64,
            err: &raw mut err,
            stamp_ns: 0,
            may_still_run: 0,
            reserved: 0,
        };
        let mut ret = 0u64;
        // SAFETY: a slot of this instance; argument and result are u64 as the test's descriptions say.
        let outcome = unsafe {
            let slot = &**self.ports().functions.add(function);
            (slot.call)(slot.ctx, (&raw const arg).cast(), (&raw mut ret).cast(), &raw mut opts)
        };
        let text = String::from_utf8_lossy(&room[..err.len]).into_owned();
        Called { outcome, ret, text, may_still_run: opts.may_still_run != 0 }
    }

    pub(super) fn send(&self, function: usize, arg: u64) -> Outcome {
        self.call(function, arg, MODE_SEND, Duration::ZERO).outcome
    }

    pub(super) fn ask(&self, function: usize, arg: u64) -> Called {
        self.call(function, arg, MODE_CALL, Duration::from_secs(30))
    }

    pub(super) fn emit(&self, event: usize, payload: u64) -> Outcome {
        // SAFETY: a slot of this instance; events of the tests carry one u64.
        unsafe {
            let slot = &**self.ports().events.add(event);
            (slot.emit)(slot.ctx, (&raw const payload).cast())
        }
    }

    /// `value` must have the output's size.
    pub(super) fn write(&self, output: usize, value: &[u8]) -> Outcome {
        // SAFETY: a slot of this instance, a value of its size.
        unsafe {
            let slot = &**self.ports().outputs.add(output);
            (slot.write)(slot.ctx, value.as_ptr().cast(), 0)
        }
    }

    /// Loans, fills and commits a frame with a header of one u64.
    pub(super) fn frame(&self, output: usize, header: u64, bytes: &[u8]) -> Outcome {
        let slot = self.output(output);
        let mut loan = no_loan();
        // SAFETY: a slot of this instance; the loan has room for `bytes`.
        unsafe {
            let loan = &mut loan;
            let outcome = (slot.loan)(slot.ctx, loan);
            if outcome != EXECUTED {
                return outcome;
            }
            loan.header.cast::<u64>().write(header);
            loan.bytes.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len());
            (slot.commit)(slot.ctx, loan, bytes.len() as u64, 0)
        }
    }

    /// The next sample, whose header or value has `size` bytes, and the result of `f` for its view.
    pub(super) fn next_with<R>(
        &self,
        input: usize,
        size: usize,
        f: impl FnOnce(&SampleView) -> R,
    ) -> Option<(Shown, R)> {
        let slot = self.input(input);
        let mut view = no_view();
        // SAFETY: a slot of this instance; the view is read only when it was written.
        unsafe {
            let view = &mut view;
            if (slot.next)(slot.ctx, view) != IN_SAMPLE {
                return None;
            }
            let result = f(view);
            let bytes = if view.len == 0 {
                &[][..]
            } else {
                std::slice::from_raw_parts(view.bytes, view.len as usize)
            };
            let shown = Shown {
                header: std::slice::from_raw_parts(view.header.cast::<u8>(), size).to_vec(),
                bytes: bytes.to_vec(),
                address: bytes.as_ptr() as usize,
                seq: view.seq,
                writable: !(slot.writable)(slot.ctx, view).is_null(),
            };
            (slot.release)(slot.ctx);
            Some((shown, result))
        }
    }

    pub(super) fn next(&self, input: usize, size: usize) -> Option<Shown> {
        self.next_with(input, size, |_| ()).map(|(shown, ())| shown)
    }

    pub(super) fn forward(&self, output: usize, view: &SampleView) -> Outcome {
        // SAFETY: a slot of this instance and a view that is held.
        unsafe {
            let slot = &**self.ports().outputs.add(output);
            (slot.forward)(slot.ctx, view, 0)
        }
    }

    /// `type_of` of an output (0), input (1) or function (2).
    pub(super) fn described(&self, kind: usize, index: usize) -> Value {
        let mut text = String::new();
        let sink = Sink { ctx: (&raw mut text).cast(), write: collect };
        // SAFETY: slots of this instance; the sink lives for the call.
        let status = unsafe {
            let ports = self.ports();
            let (f, ctx) = match kind {
                0 => ((**ports.outputs.add(index)).type_of, (**ports.outputs.add(index)).ctx),
                1 => ((**ports.inputs.add(index)).type_of, (**ports.inputs.add(index)).ctx),
                _ => ((**ports.functions.add(index)).type_of, (**ports.functions.add(index)).ctx),
            };
            f(ctx, &raw const sink)
        };
        if status == STATUS_OK { serde_json::from_str(&text).unwrap() } else { Value::Null }
    }

    pub(super) fn ports_changed(&self) -> Outcome {
        // SAFETY: the host's own function and context.
        unsafe { (self.host().ports_changed)(self.host().ctx) }
    }

    pub(super) fn note(&self, value: u64) {
        self.seen.lock().unwrap().push(value);
    }

    pub(super) fn seen(&self) -> Vec<u64> {
        self.seen.lock().unwrap().clone()
    }
}
