//! Where the LCM and plugins meet: calls into class tables, and the slots and host table plugins call.
//!
//! Invariant: the only `unsafe` of the LCM is in this folder. Everything that enters through a slot is checked before it is
//! used; nothing here waits, allocates or locks on the step path.

mod call;
mod class;
mod entry;
mod event;
mod host_table;
mod ports;
mod stream;

pub(super) use call::{
    Answer, CommandTarget, DEFAULT_DEADLINE_NS, FnBinding, RangeCheck, ReadTarget, outcome_of,
};
pub use class::LoadedClass;
pub(super) use entry::{ERR_BYTES, Entered, EntryError, Object};
pub(super) use event::{EventSink, Tap};
pub use host_table::plugin_log;
pub(super) use host_table::{HostContext, SharedTable};
pub(super) use ports::Slots;
pub(super) use stream::{InLink, OutLink};

use trocar_plugin_api::abi::ErrBuf;

/// Words viewed as their bytes.
pub(super) fn as_bytes(words: &[u64]) -> &[u8] {
    // SAFETY: any u64 is eight valid bytes; the slice covers the same memory.
    unsafe { std::slice::from_raw_parts(words.as_ptr().cast(), size_of_val(words)) }
}

/// The text in an error buffer; empty for a null one.
pub(super) fn sentence(err: *mut ErrBuf) -> String {
    // SAFETY: null, or a buffer of this host that a plugin wrote at most `cap` bytes into.
    unsafe { err.as_ref() }.map_or_else(String::new, |err| {
        // SAFETY: `ptr` has room for `cap` bytes.
        let text = unsafe { std::slice::from_raw_parts(err.ptr, err.len.min(err.cap)) };
        String::from_utf8_lossy(text).into_owned()
    })
}

/// A class of the loader as the LCM keeps it.
pub(super) fn loaded_class(class: crate::loader::LoadedClass) -> LoadedClass {
    let table = std::ptr::from_ref(class.table);
    // SAFETY: the loader checked the table; the plugin, kept beside it, stays mapped for the life of the process.
    unsafe { LoadedClass::new(table, class.plugin) }
}
