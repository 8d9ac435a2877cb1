//! Boundary between the LCM and plugins: calls into class tables, and the slots and host table plugins call.
//!
//! Invariant: the only `unsafe` of the LCM is in this folder. Everything that enters through a slot is
//! checked before it is used; nothing here waits, allocates or locks on the step path.

mod answer;
mod call;
mod class;
#[cfg(test)]
pub(super) mod counting;
mod entry;
mod event;
#[cfg(test)]
pub(super) mod fake;
mod far;
mod here;
mod host_table;
mod hot;
mod input;
pub(super) mod late;
mod needs;
mod options;
mod output;
mod parallel;
mod ports;
mod queue;
mod range;
mod read;
mod remains;
mod room;
pub(super) mod same;
mod tap;
#[cfg(test)]
mod tests;
pub(super) mod told;

pub(super) use answer::Answer;
pub(super) use call::{
    CommandTarget, DEFAULT_DEADLINE_NS, FnBinding, FnCell, outcome_of, within_ns, write_err,
};
pub use class::LoadedClass;
pub(super) use entry::{ERR_BYTES, Entered, EntryError, Object};
pub(super) use event::{EventCell, EventSink, Handler, Tap};
pub(super) use event::{FarEvents, FarHandler};
pub(super) use far::{FarCommand, FarRead, FarServer, FarSource, FarTable};
pub(super) use here::{OwnClass, OwnRead, OwnRows, Panics};
pub use host_table::plugin_log;
pub(super) use host_table::{HostContext, SharedTable};
pub(super) use input::{InCell, InLink, Newest};
pub(super) use output::{Consumer, OUTSIDE, OutCell, OutLink, Shape};
pub(super) use ports::{NoRoom, Slots};
pub(super) use queue::{Lane, REPLACED, replaced};
pub(super) use range::RangeCheck;
pub(super) use read::{ReadTarget, Reader, read_published};
pub(super) use remains::AllRemains;
pub(super) use same::{same_input, same_output, same_provided, same_required};
pub(super) use tap::{CommandTap, EventTap, plain_outcome};

use trocar_plugin_api::abi::{ErrBuf, STATUS_OK, STATUS_UNSUPPORTED, Sink, Status};
use trocar_rt::turn;

use super::instance::Instance;

/// Words viewed as their bytes.
pub(super) fn as_bytes(words: &[u64]) -> &[u8] {
    // SAFETY: any u64 is eight valid bytes; the slice covers the same memory.
    unsafe { std::slice::from_raw_parts(words.as_ptr().cast(), size_of_val(words)) }
}

/// The text in an error buffer; empty for a null one.
pub(super) fn sentence(err: *mut ErrBuf) -> String {
    // SAFETY: null, or a buffer of this host that a plugin wrote at most `cap` bytes into.
    unsafe { err.as_ref() }.map_or_else(String::new, |err| trocar_model::plain::sentence(text_in(err)))
}

/// The bytes in an error buffer of this host, or of a caller that lent one.
pub(super) fn text_in(err: &ErrBuf) -> &[u8] {
    if err.ptr.is_null() {
        return &[];
    }
    // SAFETY: `ptr` has room for `cap` bytes, and the code that sets `len` has written that many, by the
    // contract of an `ErrBuf`.
    unsafe { std::slice::from_raw_parts(err.ptr, err.len.min(err.cap)) }
}

/// Shows `f` the component whose code runs on this thread, unless there is none or it is being dropped.
fn running<R>(f: impl FnOnce(&Instance) -> R) -> Option<R> {
    // SAFETY: null, or the context of the instance that is being called on this very thread.
    let host = unsafe { super::context::component().as_ref() }?;
    let instance = host.instance.get().filter(|instance| instance.strong_count() > 0)?;
    // SAFETY: it was not being dropped, and its code runs on this very thread, inside its entry lock: the
    // manager that removes it waits for that lock, or leaves the instance where it is for good.
    Some(f(unsafe { &*instance.as_ptr() }))
}

/// Tells whether no other thread enters the component whose code runs on this thread before this turn ends.
pub(super) fn runs_kept() -> bool {
    turn::is_inside() && running(|instance| instance.object.is_kept_here()) == Some(true)
}

/// Counts a misuse by the component whose code runs on this thread.
#[cold]
fn misused(what: super::instance::Misuse) {
    running(|instance| instance.counters.misuse(what));
}

/// Passes on the input of a failed filter, without a copy of a frame. Real-time.
pub(super) fn bypass(instance: &Instance, _inside: &mut crate::instance::Entered<'_>) {
    instance.bypass();
}

/// Gives `text` to a plugin; an empty text is STATUS_UNSUPPORTED.
fn tell(sink: *const Sink, text: &str) -> Status {
    // SAFETY: null or a sink the plugin lends for the call.
    let Some(sink) = (unsafe { sink.as_ref() }) else { return STATUS_UNSUPPORTED };
    if text.is_empty() {
        return STATUS_UNSUPPORTED;
    }
    // SAFETY: the sink takes any bytes; they live for the call.
    unsafe { (sink.write)(sink.ctx, entry::bytes(text.as_bytes())) };
    STATUS_OK
}

/// A class of the loader as the LCM keeps it.
pub(super) fn loaded_class(class: trocar_loader::LoadedClass) -> LoadedClass {
    let table = std::ptr::from_ref(class.table);
    // SAFETY: the loader checked the table; the plugin, kept beside it, stays mapped for the life of the
    // process.
    unsafe { LoadedClass::new(table, class.plugin) }
}

/// A class of a plugin linked into this program, by its position in the manifest.
pub(super) fn linked_class(
    plugin: &std::sync::Arc<trocar_loader::LinkedPlugin>,
    index: usize,
) -> Option<LoadedClass> {
    let table = std::ptr::from_ref(plugin.table(index)?);
    // SAFETY: the loader checked the table, a static of this program.
    Some(unsafe { LoadedClass::new(table, plugin.clone()) })
}
