//! A class for tests: entries that do what a test's own object says, called through a table as any class is.
//!
//! Invariant: everything goes through the tables a plugin has, and a panic never crosses them; it becomes
//! STATUS_PANICKED, as the SDK does it.

mod own;
mod stage;

use std::collections::HashMap;
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::null_mut;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use parking_lot::Mutex;
use trocar_model::{ClassInfo, Execution, ExecutionLimits, Programs, Refusal, Safety};
use trocar_plugin_api::abi::{
    Bytes, ClassTable, ErrBuf, HostTable, Ports, STATUS_FAILED, STATUS_OK, STATUS_PANICKED,
    STATUS_UNSUPPORTED, Sink, Status, Tick,
};

pub(crate) use self::own::Own;
pub(crate) use self::stage::Stage;
use super::LoadedClass;
use crate::{Classes, PluginInfo};

/// Where the argument of a command lies, and where its result goes: as many bytes as its types have.
#[derive(Clone, Copy)]
pub(crate) struct ArgRet {
    pub(super) arg: *const c_void,
    pub(super) ret: *mut c_void,
}

/// Actions of a component's entries; each does nothing unless overridden.
pub(crate) trait Behaviour: Send + Sync {
    fn configure(&self, _json: &str, _own: &Own) -> Result<(), String> {
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
    fn command(&self, _id: u32, _data: ArgRet, _own: &Own) -> Result<(), String> {
        Ok(())
    }
    fn on_service(&self, _token: u64, _reply: &str) -> Result<(), String> {
        Ok(())
    }
    fn on_event(&self, _id: u32, _payload: *const c_void, _own: &Own) -> Result<(), String> {
        Ok(())
    }
    /// Text that `describe` writes; empty: no description is offered.
    fn described(&self) -> String {
        String::new()
    }
    fn destroyed(&self) {}
}

/// Sets the umask of this process, as a library may.
pub(crate) fn set_umask(mask: u32) {
    // SAFETY: any mask is one.
    unsafe { libc::umask(mask) };
}

static BEHAVIOURS: Mutex<Option<HashMap<String, Arc<dyn Behaviour>>>> = Mutex::new(None);

/// Sets the behaviour of the component of that path, before it is created; paths are unique over all tests.
pub(crate) fn behave(path: &str, behaviour: Arc<dyn Behaviour>) {
    BEHAVIOURS.lock().get_or_insert_default().insert(path.to_owned(), behaviour);
}

type Read = Arc<dyn Fn() -> u64 + Send + Sync>;

static READS: Mutex<Option<HashMap<u64, Read>>> = Mutex::new(None);

/// Sets the answer of qualified reads with this argument, for any component: a read has no instance. Unique
/// over all tests.
pub(crate) fn on_read(arg: u64, answer: impl Fn() -> u64 + Send + Sync + 'static) {
    READS.lock().get_or_insert_default().insert(arg, Arc::new(answer));
}

/// Runs `f` as an entry: an error becomes its sentence, a panic its text.
pub(super) fn entry(err: *mut ErrBuf, f: impl FnOnce() -> Result<(), String>) -> Status {
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

/// A text that the other side lends.
///
/// # Safety
/// `bytes` are valid for as long as the answer is used.
unsafe fn lent<'a>(bytes: Bytes) -> &'a str {
    // SAFETY: by the caller.
    std::str::from_utf8(unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) }).unwrap()
}

/// The instance of an entry. An entry of one that was destroyed ends the process: no panic leaves it.
fn own(this: *mut c_void) -> Own {
    // SAFETY: made by `create` below, and never freed.
    let own = Own(unsafe { &*this.cast::<Stage>() });
    assert!(!own.destroyed.load(Ordering::SeqCst), "no entry runs in an instance that was destroyed");
    own
}

/// Runs an entry of an instance, which is looked at before panics are caught.
fn entered(this: *mut c_void, err: *mut ErrBuf, f: impl FnOnce(&Own) -> Result<(), String>) -> Status {
    let own = own(this);
    entry(err, || f(&own))
}

unsafe extern "C" fn create(host: *const HostTable, name: Bytes, _err: *mut ErrBuf) -> *mut c_void {
    // SAFETY: lent for the call.
    let name = unsafe { lent(name) };
    let behaviour = BEHAVIOURS.lock().as_ref().and_then(|all| all.get(name).cloned());
    behaviour.map_or(null_mut(), |behaviour| {
        std::ptr::from_ref(Stage::made(name, behaviour, host)).cast_mut().cast()
    })
}

/// Stages stay: tests look at them when their component is gone.
unsafe extern "C" fn destroy(this: *mut c_void) {
    let own = own(this);
    own.destroyed.store(true, Ordering::SeqCst);
    own.behaviour.destroyed();
}

unsafe extern "C" fn configure(this: *mut c_void, json: Bytes, err: *mut ErrBuf) -> Status {
    // SAFETY: lent for the call.
    let json = unsafe { lent(json) };
    entered(this, err, |own| own.behaviour.configure(json, own))
}

unsafe extern "C" fn describe(this: *mut c_void, sink: *const Sink) -> Status {
    assert!(!this.is_null(), "nobody is described who is not there");
    let described = own(this).behaviour.described();
    if described.is_empty() {
        return STATUS_UNSUPPORTED;
    }
    for piece in described.as_bytes().chunks(1000) {
        // SAFETY: the host's sink lives for the call.
        unsafe { ((*sink).write)((*sink).ctx, super::texts::bytes(piece)) };
    }
    STATUS_OK
}

unsafe extern "C" fn on_event(
    this: *mut c_void,
    id: u32,
    payload: *const c_void,
    err: *mut ErrBuf,
) -> Status {
    entered(this, err, |own| own.behaviour.on_event(id, payload, own))
}

unsafe extern "C" fn bind(this: *mut c_void, ports: *const Ports, _err: *mut ErrBuf) -> Status {
    own(this).ports.store(ports.cast_mut(), Ordering::Release);
    STATUS_OK
}

unsafe extern "C" fn start(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entered(this, err, |own| own.behaviour.start())
}

unsafe extern "C" fn stop(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entered(this, err, |own| own.behaviour.stop())
}

unsafe extern "C" fn resume(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entered(this, err, |own| own.behaviour.resume())
}

unsafe extern "C" fn make_safe(this: *mut c_void, err: *mut ErrBuf) -> Status {
    entered(this, err, |own| own.behaviour.make_safe())
}

unsafe extern "C" fn step(this: *mut c_void, tick: *const Tick, err: *mut ErrBuf) -> Status {
    // SAFETY: the host lends the tick for the call.
    let tick = unsafe { &*tick };
    entered(this, err, |own| own.behaviour.step(tick, own))
}

unsafe extern "C" fn command(
    this: *mut c_void,
    id: u32,
    arg: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    entered(this, err, |own| own.behaviour.command(id, ArgRet { arg, ret }, own))
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
    let answer = READS.lock().as_ref().and_then(|all| all.get(&arg).cloned());
    entry(err, || {
        let value = answer.ok_or_else(|| format!("nobody said what {arg} is"))?();
        // SAFETY: and a result of type u64.
        unsafe { ret.cast::<u64>().write(value) };
        Ok(())
    })
}

unsafe extern "C" fn on_service(this: *mut c_void, token: u64, reply: Bytes) -> Status {
    // SAFETY: lent for the call.
    let reply = unsafe { lent(reply) };
    entered(this, null_mut(), |own| own.behaviour.on_service(token, reply))
}

/// A table that lives as long as the tests.
pub(super) struct Table(pub(super) ClassTable);

// SAFETY: immutable; the name it points to is static.
unsafe impl Sync for Table {}

impl Table {
    pub(super) fn loaded(&'static self) -> LoadedClass {
        // SAFETY: a static table.
        unsafe { LoadedClass::new(&raw const self.0, Arc::new(())) }
    }
}

/// The entries of every puppet.
pub(super) const ENTRIES: ClassTable = ClassTable {
    struct_size: size_of::<ClassTable>() as u32,
    flags: 0,
    name: Bytes { ptr: c"puppet".as_ptr().cast(), len: 6 },
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
};

static TABLE: Table = Table(ENTRIES);

/// A source that gives the puppets' class for every request.
pub(crate) struct PuppetClasses;

impl Classes for PuppetClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        Vec::new()
    }

    fn load(&self, _class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        Ok(TABLE.loaded())
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        Vec::new()
    }
}

/// The same source, where the code of this class is present for others, too.
pub(crate) struct KnownClasses(pub(crate) Arc<ClassInfo>);

impl Classes for KnownClasses {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        PuppetClasses.catalog()
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        PuppetClasses.load(class)
    }

    fn present(&self, name: &str, hash: &str) -> Option<(Arc<ClassInfo>, LoadedClass)> {
        let known = self.0.full_name() == name && self.0.hash == hash;
        known.then(|| Some((self.0.clone(), self.load(&self.0).ok()?))).flatten()
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        PuppetClasses.plugins()
    }
}

/// The puppets' class as the graph knows it, with these ports, the system interface and the taps.
pub(crate) fn class(mut ports: trocar_model::Ports, safety: Safety) -> ClassInfo {
    ports.provided.push(trocar_loader::system::interface());
    trocar_loader::taps::append(&mut ports);
    ClassInfo {
        plugin: "puppets".into(),
        version: "1.0.0".into(),
        hash: String::new(),
        name: "puppet".into(),
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
