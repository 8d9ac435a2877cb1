//! Puppets whose entries run the closures of a script.

use std::collections::HashMap;
use std::ffi::c_void;
use std::sync::atomic::Ordering;
use std::sync::{Arc, LazyLock};

use parking_lot::Mutex;
use trocar_model::ComponentId;
use trocar_plugin_api::abi::*;

pub(super) use super::super::puppet::Stage;
use super::super::puppet::{ArgRet, Behaviour, ENTRIES, Own, Table, behave, entry};

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

/// State on which a read panics.
pub(super) const READ_PANICS: u64 = 66;

/// Scripts by instance name.
static SCRIPTS: LazyLock<Mutex<HashMap<String, Arc<Script>>>> = LazyLock::new(Default::default);

/// What an entry with this status does: it says a sentence, or panics with it.
fn ends(status: Status) -> Result<(), String> {
    match status {
        STATUS_PANICKED => panic!("as the test wants"),
        STATUS_FAILED => Err("as the test wants".into()),
        STATUS_OK => Ok(()),
        other => unreachable!("no script ends with {other}"),
    }
}

impl Behaviour for Script {
    fn configure(&self, _json: &str, own: &Own) -> Result<(), String> {
        self.configure.as_ref().map_or(Ok(()), |f| ends(f(own)))
    }

    fn step(&self, _tick: &Tick, own: &Own) -> Result<(), String> {
        self.step.as_ref().map_or(Ok(()), |f| ends(f(own)))
    }

    fn command(&self, id: u32, data: ArgRet, own: &Own) -> Result<(), String> {
        // SAFETY: the first command of each interface is void; all others of the tests take one u64.
        let arg = if id.is_multiple_of(4) { 0 } else { unsafe { data.arg.cast::<u64>().read() } };
        match self.command.as_ref().map_or(Ok(0), |f| f(own, id, arg)) {
            Ok(value) if id % 4 >= 2 => {
                // SAFETY: the third and fourth of each interface return a u64.
                unsafe { data.ret.cast::<u64>().write(value) };
                Ok(())
            }
            answer => ends(answer.err().unwrap_or(STATUS_OK)),
        }
    }

    fn on_event(&self, id: u32, payload: *const c_void, own: &Own) -> Result<(), String> {
        // SAFETY: events of the tests carry one u64.
        let payload = unsafe { payload.cast::<u64>().read() };
        self.on_event.as_ref().map_or(Ok(()), |f| ends(f(own, id, payload)))
    }

    fn described(&self) -> String {
        self.described.lock().clone()
    }
}

/// A read of the state, which is one u64.
unsafe extern "C" fn read(
    row: *const c_void,
    _: u32,
    _: *const c_void,
    ret: *mut c_void,
    err: *mut ErrBuf,
) -> Status {
    // SAFETY: the row is one u64, and so is the result.
    let value = unsafe { row.cast::<u64>().read() };
    entry(err, || {
        ends(if value == READ_PANICS { STATUS_PANICKED } else { STATUS_OK })?;
        // SAFETY: as above.
        unsafe { ret.cast::<u64>().write(value) };
        Ok(())
    })
}

unsafe extern "C" fn state_copy(this: *mut c_void, dst: *mut c_void, _: usize) {
    // SAFETY: made by the entry `create`, and never freed; the state is one u64.
    unsafe { dst.cast::<u64>().write((*this.cast::<Stage>()).state.load(Ordering::Relaxed)) };
}

/// A table without a name: these classes are given theirs by their manifest.
const NAMELESS: ClassTable = ClassTable {
    name: Bytes { ptr: std::ptr::null(), len: 0 },
    on_service: None,
    state_copy: Some(state_copy),
    read: Some(read),
    ..ENTRIES
};

/// The one class of all scripts.
pub(super) static PUPPET: Table = Table(NAMELESS);

/// Name of the class whose table has no entries for ports.
pub(super) const MUTE: &str = "mute";

/// Table of a class without ports.
pub(super) static MUTE_TABLE: Table =
    Table(ClassTable { bind: None, command: None, read: None, on_event: None, ..NAMELESS });

/// Sets the script of the instance of this name; before it is created.
pub(super) fn enrol(id: &ComponentId, script: Script) {
    let script = Arc::new(script);
    behave(&id.to_string(), script.clone());
    SCRIPTS.lock().insert(id.to_string(), script);
}

pub(super) fn script_of(id: &ComponentId) -> Arc<Script> {
    SCRIPTS.lock()[&id.to_string()].clone()
}

/// The newest instance of this name.
pub(super) fn stage_of(id: &ComponentId) -> &'static Stage {
    Stage::of(&id.to_string())
}
