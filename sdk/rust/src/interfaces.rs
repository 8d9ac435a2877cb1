//! The parts of a class that `#[provides]` and `#[handles]` make, one for each interface.
//!
//! Invariant: a declared interface without an `impl` block has the empty part, and a block for an interface
//! that the class does not declare does not compile.

use crate::call::Call;
use crate::class::Class;
use trocar_plugin_api::abi::Status;
use trocar_plugin_api::desc::{CommandDesc, CommandKind, HandlerDesc};

/// Content of `#[provides]` for one interface of class `C`.
pub struct ProvidedPart<C: Class> {
    /// The documentation of the `impl` block.
    pub doc: &'static str,
    /// "truth", "sim" or empty.
    pub tag: &'static str,
    /// Descriptions of the commands and reads, by their ids.
    pub commands: &'static [CommandDesc],
    /// Id within the interface; which of the repeated interfaces, 0 for a fixed one.
    pub command: fn(&mut C, u32, usize, &mut Call) -> Status,
    /// The same for reads, from a row of the state table.
    pub read: fn(&C::State, u32, usize, &mut Call) -> Status,
}

impl<C: Class> ProvidedPart<C> {
    /// An interface with events only.
    pub const EMPTY: ProvidedPart<C> = ProvidedPart {
        doc: "",
        tag: "",
        commands: &[],
        command: |_, id, _, call| call.unknown(id),
        read: |_, id, _, call| call.unknown(id),
    };
}

/// Content of `#[handles]` for one required interface of class `C`.
pub struct HandlesPart<C: Class> {
    /// The documentation of the `impl` block.
    pub doc: &'static str,
    /// Descriptions of the handlers, by their ids.
    pub handlers: &'static [HandlerDesc],
    /// Id within the interface; which of the repeated interfaces, 0 for a fixed one.
    pub on_event: fn(&mut C, u32, usize, &mut Call) -> Status,
}

impl<C: Class> HandlesPart<C> {
    /// An interface with functions only.
    pub const EMPTY: HandlesPart<C> =
        HandlesPart { doc: "", handlers: &[], on_event: |_, id, _, call| call.unknown(id) };
}

/// Holds for each provided interface a class declares; `KEY` is the hash of its name.
///
/// A misspelt interface does not compile:
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// #[component(provides("ctl"))]
/// struct Lamp {}
/// #[provides("ctrl")]
/// impl Lamp {
///     #[command]
///     fn on(&mut self) {}
/// }
/// impl Component for Lamp {}
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` declares no provided interface of this name",
    label = "not a provided interface of `{Self}`",
    note = "declare it on the struct: `#[component(provides(\"name\"))]`, or by an event field: `#[event(\"name\")]`"
)]
pub trait DeclaresProvided<const KEY: u64> {}

/// Holds for each required interface a class declares; `KEY` is the hash of its name.
#[diagnostic::on_unimplemented(
    message = "`{Self}` declares no required interface of this name",
    label = "not a required interface of `{Self}`",
    note = "declare it on the struct: `#[component(requires(\"name\"))]`, or by a function field: `#[required(interface = \"name\")]`"
)]
pub trait DeclaresRequired<const KEY: u64> {}

/// True when a read is among the commands of an interface.
pub const fn has_reads(commands: &[CommandDesc]) -> bool {
    let mut i = 0;
    while i < commands.len() {
        if matches!(commands[i].kind, CommandKind::Read | CommandKind::QualifiedRead) {
            return true;
        }
        i += 1;
    }
    false
}
