//! Contracts of the standard device interfaces: what an arm, a camera, a spectrometer, a tracker, a force
//! sensor and an input device offer, so that one of them can take another's place.
//!
//! Invariant: contracts are data, [`check()`] is pure. A contract only grows by optional members;
//! `docs/INTERFACES.md` is written from these tables.

mod arm;
mod check;
mod document;
mod leaves;
mod payloads;
mod sensors;

pub use arm::ARM;
pub use check::{Problem, Violation, check, check_as, check_class};
pub use document::document;
pub use leaves::{leaves_of, leaves_of_payload, size_of_type};
pub use payloads::{PAYLOADS, Payload, PayloadField};
pub use sensors::{CAMERA, FORCE_SENSOR, INPUT, SPECTROMETER, TRACKER};

/// All contracts, in the order of the document.
pub const CONTRACTS: [&Contract; 6] = [&ARM, &CAMERA, &SPECTROMETER, &TRACKER, &FORCE_SENSOR, &INPUT];

/// The contract of this name; the error lists the names there are.
///
/// # Errors
/// No such contract.
pub fn contract(name: &str) -> Result<&'static Contract, String> {
    CONTRACTS.iter().copied().find(|c| c.name == name).ok_or_else(|| {
        let there: Vec<&str> = CONTRACTS.iter().map(|c| c.name).collect();
        format!("no contract `{name}`; there are {}", there.join(", "))
    })
}

/// Contract of one kind of device.
#[derive(Debug)]
pub struct Contract {
    /// As `trocar plugin check --as` takes it.
    pub name: &'static str,
    /// One sentence.
    pub doc: &'static str,
    /// The class's `safety`.
    pub safety: &'static str,
    /// Coordinate frames and times of the values.
    pub frames: &'static str,
    /// Threads, rates and waiting.
    pub threads: &'static str,
    /// Behaviour of the device beyond offering the members, one rule each.
    pub rules: &'static [&'static str],
    /// The function of `trocar_sdk::testing` that tries these rules; empty where there is none.
    pub tried_by: &'static str,
    /// Provided interfaces.
    pub interfaces: &'static [Interface],
    /// Outputs.
    pub outputs: &'static [Output],
}

/// A provided interface. Members of an optional one are checked where they exist.
#[derive(Debug)]
pub struct Interface {
    /// Name of the interface.
    pub name: &'static str,
    /// One sentence.
    pub doc: &'static str,
    /// A class without it does not fulfil the contract.
    pub required: bool,
    /// Its commands.
    pub commands: &'static [Command],
    /// Its events.
    pub events: &'static [Event],
}

/// A command of an interface.
#[derive(Debug)]
pub struct Command {
    /// Name of the command, CRTK's where it has one.
    pub name: &'static str,
    /// One sentence.
    pub doc: &'static str,
    /// An interface without it does not fulfil the contract.
    pub required: bool,
    /// As in the manifest: "void", "write", "read", "qualified_read", "void_return", "write_return".
    pub kind: &'static str,
    /// Its argument.
    pub arg: Carries,
    /// Its result.
    pub ret: Carries,
    /// The overflow policy it must have, "latest_wins"; empty = any.
    pub overflow: &'static str,
}

/// An event of an interface.
#[derive(Debug)]
pub struct Event {
    /// Name of the event.
    pub name: &'static str,
    /// One sentence.
    pub doc: &'static str,
    /// An interface without it does not fulfil the contract.
    pub required: bool,
    /// Payload of the event.
    pub payload: Carries,
}

/// A type as text: empty, a primitive, `text[32]`, `[f64;3]`, `list[f64;16]`, or the name of a [`Payload`].
#[derive(Clone, Copy, Debug)]
pub struct Carries {
    /// The type as text.
    pub ty: &'static str,
    /// Unit of a value without fields; empty = none.
    pub unit: &'static str,
}

impl Carries {
    /// No value.
    pub const NOTHING: Carries = Carries::of("");

    /// A value of this type, without a unit of its own.
    pub const fn of(ty: &'static str) -> Carries {
        Carries { ty, unit: "" }
    }
}

/// An output.
#[derive(Debug)]
pub struct Output {
    /// Name of the output.
    pub name: &'static str,
    /// One sentence.
    pub doc: &'static str,
    /// A class without it does not fulfil the contract.
    pub required: bool,
    /// The output is one of these.
    pub one_of: &'static [Flows],
}

/// Type of the data that flows through an output.
#[derive(Clone, Copy, Debug)]
pub enum Flows {
    /// Plain samples of this payload.
    Samples(&'static str),
    /// Frames with this header, their bytes read as `format` says.
    Frames {
        /// Payload of the header.
        header: &'static str,
        /// Name of the way the bytes are read.
        format: &'static str,
    },
}

const fn read(name: &'static str, required: bool, ty: &'static str, doc: &'static str) -> Command {
    let (arg, ret) = (Carries::NOTHING, Carries::of(ty));
    Command { name, doc, required, kind: "read", arg, ret, overflow: "" }
}

const fn write(name: &'static str, required: bool, ty: &'static str, doc: &'static str) -> Command {
    let (arg, ret) = (Carries::of(ty), Carries::NOTHING);
    Command { name, doc, required, kind: "write", arg, ret, overflow: "" }
}

/// A write of which only the newest counts: it replaces one that was not taken yet.
const fn newest(name: &'static str, required: bool, ty: &'static str, doc: &'static str) -> Command {
    Command { overflow: "latest_wins", ..write(name, required, ty, doc) }
}

const fn void(name: &'static str, required: bool, doc: &'static str) -> Command {
    let (arg, ret) = (Carries::NOTHING, Carries::NOTHING);
    Command { name, doc, required, kind: "void", arg, ret, overflow: "" }
}

const fn event(name: &'static str, required: bool, ty: &'static str, doc: &'static str) -> Event {
    Event { name, doc, required, payload: Carries::of(ty) }
}

#[cfg(test)]
mod tests;
