//! The entries of a class table: each is looked up by the size the table gives; those of every cycle are
//! looked up only once.
//!
//! Invariant: an entry that a class does not have has a default here, so that calling one needs no check.

use std::ffi::c_void;

use trocar_plugin_api::abi::{ClassTable, ErrBuf, STATUS_OK, STATUS_UNSUPPORTED, Status, Tick};

/// Reads an entry of a table that may be shorter than the host's; `None` when absent or null.
macro_rules! entry {
    ($table:expr, $field:ident) => {{
        let table: *const trocar_plugin_api::abi::ClassTable = $table;
        // SAFETY: every table starts with its struct_size; the loader checked that the pointer is a table.
        let size = unsafe { (*table).struct_size };
        let offset = std::mem::offset_of!(trocar_plugin_api::abi::ClassTable, $field);
        if trocar_plugin_api::has_entry(size, offset, size_of::<usize>()) {
            // SAFETY: the field lies inside the table, by the size the table gives.
            unsafe { (*table).$field }
        } else {
            None
        }
    }};
}
pub(super) use entry;

type Step = unsafe extern "C" fn(*mut c_void, *const Tick, *mut ErrBuf) -> Status;
type Command = unsafe extern "C" fn(*mut c_void, u32, *const c_void, *mut c_void, *mut ErrBuf) -> Status;
pub(super) type Read =
    unsafe extern "C" fn(*const c_void, u32, *const c_void, *mut c_void, *mut ErrBuf) -> Status;
type OnEvent = unsafe extern "C" fn(*mut c_void, u32, *const c_void, *mut ErrBuf) -> Status;
pub(super) type StateCopy = unsafe extern "C" fn(*mut c_void, *mut c_void, usize);

/// Entries that are called in every cycle.
pub(super) struct Hot {
    pub(super) step: Step,
    pub(super) command: Command,
    pub(super) read: Read,
    pub(super) on_event: OnEvent,
    pub(super) state_copy: StateCopy,
}

impl Hot {
    pub(super) fn of(table: *const ClassTable) -> Hot {
        Hot {
            step: entry!(table, step).unwrap_or(no_step),
            command: entry!(table, command).unwrap_or(no_command),
            read: entry!(table, read).unwrap_or(no_read),
            on_event: entry!(table, on_event).unwrap_or(no_event),
            state_copy: entry!(table, state_copy).unwrap_or(no_state),
        }
    }
}

unsafe extern "C" fn no_step(_: *mut c_void, _: *const Tick, _: *mut ErrBuf) -> Status {
    STATUS_OK
}

unsafe extern "C" fn no_command(
    _: *mut c_void,
    _: u32,
    _: *const c_void,
    _: *mut c_void,
    _: *mut ErrBuf,
) -> Status {
    STATUS_UNSUPPORTED
}

unsafe extern "C" fn no_read(
    _: *const c_void,
    _: u32,
    _: *const c_void,
    _: *mut c_void,
    _: *mut ErrBuf,
) -> Status {
    STATUS_UNSUPPORTED
}

unsafe extern "C" fn no_event(_: *mut c_void, _: u32, _: *const c_void, _: *mut ErrBuf) -> Status {
    STATUS_OK
}

unsafe extern "C" fn no_state(_: *mut c_void, _: *mut c_void, _: usize) {}
