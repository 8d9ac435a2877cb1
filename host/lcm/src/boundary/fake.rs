//! A class for tests whose entries do what a test's own object says, called through a table as any class is.
//!
//! Invariant: a panic never crosses the table; it becomes STATUS_PANICKED, as the SDK does it.

mod frames;

use std::collections::HashMap;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use trocar_model::{ClassInfo, Execution, ExecutionLimits, Programs, Refusal, Safety};
use trocar_plugin_api::abi::{
    Bytes, ClassTable, ErrBuf, HostTable, IN_SAMPLE, KEEP, Keep, Outcome, PARALLEL, Parallel, Ports,
    STATUS_FAILED, STATUS_OK, STATUS_PANICKED, STATUS_UNSUPPORTED, SampleView, Sink, SliceBody, Status, Tick,
};

use super::LoadedClass;
use crate::{Classes, PluginInfo};

/// Actions of a fake component; each does nothing unless overridden.
pub(crate) trait Behaviour: Send + Sync {
    fn configure(&self, _json: &str) -> Result<(), String> {
        Ok(())
    }
    fn start(&self) -> Result<(), String> {
        Ok(())
    }
    fn stop(&self) -> Result<(), String> {
        Ok(())
    }
    fn resume(&self) -> Result<(), String> {
        Ok(())
    }
    fn make_safe(&self) -> Result<(), String> {
        Ok(())
    }
    fn step(&self, _tick: &Tick, _own: &Own) -> Result<(), String> {
        Ok(())
    }
    fn command(&self, _id: u32, _own: &Own) -> Result<(), String> {
        Ok(())
    }
    fn on_service(&self, _token: u64, _reply: &str) -> Result<(), String> {
        Ok(())
    }
    fn on_event(&self) -> Result<(), String> {
        Ok(())
    }
    fn destroyed(&self) {}
}

/// Sets the umask of this process, as a library may.
pub(crate) fn set_umask(mask: u32) {
    // SAFETY: any mask is one.
    unsafe { libc::umask(mask) };
}

/// Bytes of a row of GetState.
const ROW: usize = trocar_loader::system::MAX_BYTES;

/// Pointers an instance got from the host.
#[derive(Clone, Copy)]
pub(crate) struct Own {
    host: *const HostTable,
    ports: *const Ports,
}

// SAFETY: slots and table may be called from any thread, also after the instance is gone, as by code in C
// that keeps them in a static.
unsafe impl Send for Own {}

impl Own {
    /// Writes a plain value to an output.
    pub(crate) fn write(&self, output: usize, value: &u64) -> Outcome {
        // SAFETY: the tests' classes have that output, of type u64, and are bound before they run.
        unsafe {
            let slot = *(*self.ports).outputs.add(output);
            ((*slot).write)((*slot).ctx, std::ptr::from_ref(value).cast(), 0)
        }
    }

    /// The next sample of an input of u64, or of frames with such a header: its value and its number.
    pub(crate) fn take(&self, input: usize) -> Option<(u64, u64)> {
        self.take_words(input).map(|([value], seq)| (value, seq))
    }

    /// The next sample of an input of so many words, and its number.
    pub(crate) fn take_words<const N: usize>(&self, input: usize) -> Option<([u64; N], u64)> {
        let mut view = SampleView::EMPTY;
        // SAFETY: the tests' classes have that input, of that size or of frames with such a header, and are
        // bound before they run.
        unsafe {
            let slot = *(*self.ports).inputs.add(input);
            if ((*slot).next)((*slot).ctx, &raw mut view) != IN_SAMPLE {
                return None;
            }
            Some((view.header.cast::<[u64; N]>().read(), view.seq))
        }
    }

    /// Writes a plain value of so many words to an output.
    pub(crate) fn write_words<const N: usize>(&self, output: usize, value: &[u64; N]) -> Outcome {
        // SAFETY: as in `write`, for an output of that size.
        unsafe {
            let slot = *(*self.ports).outputs.add(output);
            ((*slot).write)((*slot).ctx, std::ptr::from_ref(value).cast(), 0)
        }
    }

    /// Says, as the SDK does, that handles of the component are left.
    pub(crate) fn keep(&self) {
        let id = Bytes { ptr: KEEP.as_ptr(), len: KEEP.len() };
        // SAFETY: the host's table lives as long as the instance, and answers with the extension of that
        // name.
        unsafe {
            let host = &*self.host;
            let found = (host.extension)(host.ctx, id).cast::<Keep>();
            ((*found).keep)(host.ctx);
        }
    }

    pub(crate) fn has_output(&self) -> bool {
        // SAFETY: bound before it runs.
        unsafe { (*self.ports).output_count > 0 }
    }

    /// Runs eight slices that do nothing on the threads of its stream; returns the number of threads.
    pub(crate) fn slices(&self) -> u32 {
        unsafe extern "C" fn nothing(_: *mut c_void, _: u32) -> Status {
            STATUS_OK
        }
        let body = SliceBody { data: std::ptr::null_mut(), run: nothing };
        // SAFETY: the host's own table and extension; the body lives through the call.
        unsafe {
            let id = super::texts::bytes(PARALLEL.as_bytes());
            let parallel = ((*self.host).extension)((*self.host).ctx, id).cast::<Parallel>();
            let status = ((*parallel).run)((*parallel).ctx, 8, &raw const body);
            if status == STATUS_OK { ((*parallel).threads)((*parallel).ctx) } else { 0 }
        }
    }

    /// Calls a function without argument and result; does not wait.
    pub(crate) fn send(&self, function: usize) -> Outcome {
        // SAFETY: the tests' classes have that function.
        unsafe {
            let slot = *(*self.ports).functions.add(function);
            ((*slot).call)((*slot).ctx, std::ptr::null(), std::ptr::null_mut(), std::ptr::null_mut())
        }
    }

    /// Calls a function that is bound to GetState; the row as bytes.
    pub(crate) fn ask(&self, function: usize) -> (Outcome, [u8; ROW]) {
        let mut row = [0u64; ROW / 8];
        // SAFETY: the tests' classes have that function, and the row has the size of its result.
        let outcome = unsafe {
            let slot = *(*self.ports).functions.add(function);
            ((*slot).call)((*slot).ctx, std::ptr::null(), row.as_mut_ptr().cast(), std::ptr::null_mut())
        };
        let mut bytes = [0; ROW];
        bytes.copy_from_slice(super::as_bytes(&row));
        (outcome, bytes)
    }

    /// Calls a function that is bound to a qualified read.
    pub(crate) fn read(&self, function: usize, arg: u64) -> (Outcome, u64) {
        let mut ret = 0u64;
        // SAFETY: the tests' classes have that function, from u64 to u64.
        let outcome = unsafe {
            let slot = *(*self.ports).functions.add(function);
            let (arg, ret) = ((&raw const arg).cast(), (&raw mut ret).cast());
            ((*slot).call)((*slot).ctx, arg, ret, std::ptr::null_mut())
        };
        (outcome, ret)
    }

    /// Asks for a dynamic component service.
    pub(crate) fn service(&self, token: u64, request: &str) -> Outcome {
        let request = super::texts::bytes(request.as_bytes());
        // SAFETY: the table lives as long as the instance, the text through the call.
        unsafe { ((*self.host).service)((*self.host).ctx, token, request) }
    }

    /// The host table, for a thread of the device.
    pub(crate) fn device(&self) -> Device {
        Device(self.host)
    }
}

/// A thread of the device itself as it calls in.
#[derive(Clone, Copy)]
pub(crate) struct Device(*const HostTable);

// SAFETY: the table's functions may be called from any thread, as long as the instance lives; tests see to
// that.
unsafe impl Send for Device {}

impl Device {
    pub(crate) fn enter(&self) -> Outcome {
        // SAFETY: see `Send`.
        unsafe { ((*self.0).callback_enter)((*self.0).ctx) }
    }

    pub(crate) fn ports_changed(&self) -> Outcome {
        // SAFETY: see `Send`.
        unsafe { ((*self.0).ports_changed)((*self.0).ctx) }
    }

    pub(crate) fn leave(&self) {
        // SAFETY: see `Send`.
        unsafe { ((*self.0).callback_leave)((*self.0).ctx) }
    }
}

static BEHAVIOURS: Mutex<Option<HashMap<String, Arc<dyn Behaviour>>>> = Mutex::new(None);

/// Sets the behaviour of the component of that path, before it is created; paths are unique over all tests.
pub(crate) fn behave(path: &str, behaviour: Arc<dyn Behaviour>) {
    let mut all = BEHAVIOURS.lock().unwrap_or_else(PoisonError::into_inner);
    all.get_or_insert_default().insert(path.to_owned(), behaviour);
}

type Read = Arc<dyn Fn() -> u64 + Send + Sync>;

static READS: Mutex<Option<HashMap<u64, Read>>> = Mutex::new(None);

/// Sets the answer of qualified reads with this argument, for any component: a read has no instance. Unique
/// over all tests.
pub(crate) fn on_read(arg: u64, answer: impl Fn() -> u64 + Send + Sync + 'static) {
    let mut all = READS.lock().unwrap_or_else(PoisonError::into_inner);
    all.get_or_insert_default().insert(arg, Arc::new(answer));
}

struct Fake {
    behaviour: Arc<dyn Behaviour>,
    own: Own,
}

/// Runs `f` as an entry: an error becomes its sentence, a panic its text.
fn entry(err: *mut ErrBuf, f: impl FnOnce() -> Result<(), String>) -> Status {
    let (status, text) = match catch_unwind(AssertUnwindSafe(f)) {
        Ok(Ok(())) => return STATUS_OK,
        Ok(Err(text)) => (STATUS_FAILED, text),
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map_or("panicked", |t| t);
            (STATUS_PANICKED, text.to_owned())
        }
    };
    super::texts::write_err(err, text.as_bytes());
    status
}

fn fake<'a>(this: *mut c_void) -> &'a mut Fake {
    // SAFETY: made by `create` below, entered by one thread at a time (make_safe from outside uses shared
    // parts only).
    unsafe { &mut *this.cast::<Fake>() }
}

unsafe extern "C" fn create(host: *const HostTable, name: Bytes, _err: *mut ErrBuf) -> *mut c_void {
    // SAFETY: the host lends the name for the call.
    let name = unsafe { std::slice::from_raw_parts(name.ptr, name.len) };
    let name = String::from_utf8_lossy(name).into_owned();
    let behaviour = {
        let all = BEHAVIOURS.lock().unwrap_or_else(PoisonError::into_inner);
        all.as_ref().and_then(|all| all.get(&name).cloned())
    };
    match behaviour {
        Some(behaviour) => {
            let own = Own { host, ports: std::ptr::null() };
            Box::into_raw(Box::new(Fake { behaviour, own })).cast()
        }
        None => std::ptr::null_mut(),
    }
}

unsafe extern "C" fn destroy(this: *mut c_void) {
    // SAFETY: made by `create`, destroyed once.
    let fake = unsafe { Box::from_raw(this.cast::<Fake>()) };
    fake.behaviour.destroyed();
}

unsafe extern "C" fn configure(this: *mut c_void, json: Bytes, err: *mut ErrBuf) -> Status {
    // SAFETY: the host lends the text for the call.
    let json = unsafe { std::slice::from_raw_parts(json.ptr, json.len) };
    entry(err, || fake(this).behaviour.configure(&String::from_utf8_lossy(json)))
}

unsafe extern "C" fn describe(this: *mut c_void, _: *const Sink) -> Status {
    assert!(!this.is_null(), "nobody is described who is not there");
    STATUS_UNSUPPORTED
}

unsafe extern "C" fn on_event(this: *mut c_void, _: u32, _: *const c_void, err: *mut ErrBuf) -> Status {
    entry(err, || fake(this).behaviour.on_event())
}

unsafe extern "C" fn bind(this: *mut c_void, ports: *const Ports, _err: *mut ErrBuf) -> Status {
    fake(this).own.ports = ports;
    STATUS_OK
}

unsafe extern "C" fn start(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entry(err, || fake(this).behaviour.start())
}

unsafe extern "C" fn stop(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entry(err, || fake(this).behaviour.stop())
}

unsafe extern "C" fn resume(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entry(err, || fake(this).behaviour.resume())
}

unsafe extern "C" fn make_safe(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entry(err, || fake(this).behaviour.make_safe())
}

unsafe extern "C" fn step(this: *mut c_void, tick: *const Tick, err: *mut ErrBuf) -> Status {
    let fake = fake(this);
    // SAFETY: the host lends the tick for the call.
    let tick = unsafe { &*tick };
    entry(err, || fake.behaviour.step(tick, &fake.own))
}

unsafe extern "C" fn command(
    this: *mut c_void,
    id: u32,
    _arg: *const c_void,
    _ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    let fake = fake(this);
    entry(err, || fake.behaviour.command(id, &fake.own))
}

/// Qualified reads from u64 to u64.
unsafe extern "C" fn read(
    _row: *const c_void,
    _id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: the tests' reads have an argument of type u64.
    let arg = unsafe { arg.cast::<u64>().read() };
    let answer = {
        let all = READS.lock().unwrap_or_else(PoisonError::into_inner);
        all.as_ref().and_then(|all| all.get(&arg).cloned())
    };
    entry(err, || {
        let value = answer.ok_or_else(|| format!("nobody said what {arg} is"))?();
        // SAFETY: and a result of type u64.
        unsafe { ret.cast::<u64>().write(value) };
        Ok(())
    })
}

unsafe extern "C" fn on_service(this: *mut c_void, token: u64, reply: Bytes) -> Status {
    // SAFETY: the host lends the text for the call.
    let reply = unsafe { std::slice::from_raw_parts(reply.ptr, reply.len) };
    entry(std::ptr::null_mut(), || fake(this).behaviour.on_service(token, &String::from_utf8_lossy(reply)))
}

struct Shared(ClassTable);

// SAFETY: immutable; the name it points to is static.
unsafe impl Sync for Shared {}

static TABLE: Shared = Shared(ClassTable {
    struct_size: size_of::<ClassTable>() as u32,
    flags: 0,
    name: Bytes { ptr: c"fake".as_ptr().cast(), len: 4 },
    create: Some(create),
    destroy: Some(destroy),
    configure: Some(configure),
    describe: Some(describe),
    bind: Some(bind),
    start: Some(start),
    stop: Some(stop),
    resume: Some(resume),
    make_safe: Some(make_safe),
    step: Some(step),
    command: Some(command),
    read: Some(read),
    on_event: Some(on_event),
    on_service: Some(on_service),
    state_copy: None,
    snapshot: None,
    restore: None,
    extension: None,
});

/// A source that gives the fake class for every request.
pub(crate) struct FakeClasses;

impl Classes for FakeClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        Vec::new()
    }

    fn load(&self, _class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        // SAFETY: a static table.
        Ok(unsafe { LoadedClass::new(&raw const TABLE.0, Arc::new(())) })
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        Vec::new()
    }
}

/// The same source, where the code of this class is present for others, too.
pub(crate) struct KnownClasses(pub(crate) Arc<ClassInfo>);

impl Classes for KnownClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        FakeClasses.catalog()
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        FakeClasses.load(class)
    }

    fn present(&self, name: &str, hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        let known = self.0.full_name() == name && self.0.hash == hash;
        known.then(|| Some((self.0.clone(), self.load(&self.0).ok()?))).flatten()
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        FakeClasses.plugins()
    }
}

/// The fake class as the graph knows it, with these ports, the system interface and the taps.
pub(crate) fn class(mut ports: trocar_model::Ports, safety: Safety) -> ClassInfo {
    ports.provided.push(trocar_loader::system::interface());
    trocar_loader::taps::append(&mut ports);
    ClassInfo {
        plugin: "fakes".into(),
        version: "1.0.0".into(),
        hash: String::new(),
        name: "fake".into(),
        doc: String::new(),
        safety,
        hardware: false,
        safe_from_any_thread: false,
        programs: Programs::None,
        execution: Execution::default(),
        limits: ExecutionLimits::default(),
        config_schema: serde_json::json!({}),
        ports,
    }
}
