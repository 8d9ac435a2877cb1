//! Boundary between the LCM and plugins: calls into class tables, and the slots and host table plugins call.
//!
//! Invariant: the only `unsafe` of the LCM is in this folder. Everything that enters through a slot is
//! checked before it is used; nothing here waits, allocates or locks on the step path.

mod answer;
mod call;
mod class;
#[cfg(test)]
pub(super) mod counting;
pub(super) mod deferred;
mod entry;
mod event;
mod here;
mod host_table;
mod hot;
mod input;
pub(super) mod inside;
mod mend;
mod needs;
mod no_room;
mod options;
mod outcomes;
mod output;
mod parallel;
mod ports;
#[cfg(test)]
pub(super) mod puppet;
mod queue;
mod range;
mod read;
mod remains;
mod remote;
mod room;
mod row;
pub(super) mod same;
mod tap;
#[cfg(test)]
mod tests;
mod texts;
pub(super) mod told;

pub(super) use answer::Answer;
pub(super) use call::{CommandTarget, FnBinding, FnCell};
pub use class::LoadedClass;
pub(super) use class::{linked_class, loaded_class};
pub(super) use entry::{ERR_BYTES, Entered, EntryError, EntryResult, Object};
pub(super) use event::{EventCell, EventSink, Handler, Tap};
pub(super) use event::{RemoteEvents, RemoteHandler};
pub(super) use here::{OwnClass, OwnRead, OwnRows, Panics};
pub use host_table::plugin_log;
pub(super) use host_table::{HostContext, SharedTable};
pub(super) use input::{InCell, InLink, Newest};
pub(super) use no_room::NoRoom;
pub(super) use outcomes::{DEFAULT_DEADLINE_NS, outcome_of, plain_outcome, within_ns};
pub(super) use output::{Consumer, OUTSIDE, OutCell, OutLink, Shape};
pub(super) use ports::Slots;
pub(super) use queue::{Lane, REPLACED, replaced};
pub(super) use range::RangeCheck;
pub(super) use read::{ReadTarget, Reader, read_published};
pub(super) use remains::AllRemains;
pub(super) use remote::{
    Asking, ReadAnswer, RemoteCommand, RemoteRead, RemoteServer, RemoteSource, RemoteTable,
};
pub(super) use same::{same_input, same_output, same_provided, same_required};
pub(super) use tap::{EventTap, command_tap, row_tap};
pub(super) use texts::{as_bytes, sentence, text_in, write_err};
