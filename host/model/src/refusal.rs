//! Why a request is refused: values, not sentences; sentences, codes and help are made from them in one
//! place.
//!
//! Invariant: every variant has a reason code, a sentence that says what was asked and what is wrong, and
//! help that says what to do (a test fails otherwise); `docs/errors.md` is generated from here.

mod details;
mod examples;
mod help;
mod text;

pub use examples::errors_markdown;
pub use text::brief;
pub(crate) use text::{ADAPTABLE, duration, scattered};

use crate::{ComponentId, MemberId, Name, PortId, ProcessState, State, Tag, Verb, Violation};

/// gRPC status codes by name; the wire numbers live in `control/status.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Code {
    InvalidArgument,
    NotFound,
    AlreadyExists,
    FailedPrecondition,
    Aborted,
    DeadlineExceeded,
    Unavailable,
    ResourceExhausted,
    PermissionDenied,
    Unimplemented,
    Internal,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    BadPath {
        text: String,
        why: String,
    },
    ProcessNotFound {
        process: Name,
        known: Vec<Name>,
    },
    /// The process is known and cannot be asked. `state` says what becomes of it, `last_exit` how it ended;
    /// "" when that is unknown.
    ProcessLost {
        process: Name,
        state: ProcessState,
        last_exit: String,
    },
    /// No supervisor is there that would make a process beside this one; `known`: those that a supervisor
    /// keeps.
    NotSupervised {
        process: Name,
        known: Vec<Name>,
    },
    /// A process that was to be made for a component.
    ProcessNotUp {
        process: Name,
        why: String,
    },
    /// The process was to be forgotten, and has not ended.
    ProcessRuns {
        process: Name,
        state: ProcessState,
        pid: u32,
    },
    /// The name is held by a process that answers.
    ProcessExists {
        process: Name,
        endpoint: String,
        pid: u32,
    },
    /// This port belongs to a process that another GCM manages.
    ManagedElsewhere {
        at: String,
    },
    /// No plugin or class of that name in any process.
    PluginNotFound {
        name: String,
        known: Vec<String>,
    },
    /// `elsewhere`: processes that have it; `ambiguous`: full names the short name could mean.
    ClassNotFound {
        process: Name,
        class: String,
        known: Vec<String>,
        elsewhere: Vec<Name>,
        ambiguous: Vec<String>,
    },
    ComponentExists {
        id: ComponentId,
    },
    ComponentNotFound {
        id: ComponentId,
        known: Vec<ComponentId>,
    },
    /// A glob that matches nothing.
    NothingMatches {
        pattern: String,
        known: Vec<ComponentId>,
    },
    InterfaceNotFound {
        port: PortId,
        known: Vec<String>,
    },
    MemberNotFound {
        member: MemberId,
        known: Vec<String>,
    },
    /// The member is there, but is something else than what was asked of it: `is` "a read command", `wanted`
    /// "an event".
    WrongKind {
        member: MemberId,
        is: String,
        wanted: String,
    },
    ConnectionNotFound {
        asked: String,
        known: Vec<String>,
    },
    /// Client and server are swapped, or both are of the same direction.
    WrongDirection {
        client: PortId,
        client_is: &'static str,
        server: PortId,
        server_is: &'static str,
    },
    AlreadyConnected {
        client: PortId,
        server: PortId,
    },
    ConnectionExists {
        id: u64,
        client: PortId,
        server: PortId,
    },
    CommandMissing {
        client: PortId,
        server: PortId,
        function: String,
        known: Vec<String>,
    },
    CommandKindMismatch {
        client: PortId,
        server: PortId,
        function: String,
        wants: String,
        has: String,
    },
    /// `difference` names the first difference by field.
    TypeMismatch {
        client: PortId,
        server: PortId,
        what: String,
        difference: String,
    },
    FormatMismatch {
        client: PortId,
        server: PortId,
        wants: String,
        has: String,
    },
    /// A port for simulated devices only, and one that is not.
    TagMismatch {
        client: PortId,
        server: PortId,
        has: Tag,
    },
    /// Data of `server` would reach an actuator; `path` leads from the client to it.
    TruthToActuator {
        client: PortId,
        server: PortId,
        tag: Tag,
        path: Vec<ComponentId>,
    },
    SyncCycle {
        path: Vec<ComponentId>,
    },
    WrongState {
        id: ComponentId,
        state: State,
        verb: Verb,
        allowed: Vec<Verb>,
        why: String,
    },
    /// Start or Resume while required ends are open.
    Unconnected {
        id: ComponentId,
        verb: Verb,
        ports: Vec<String>,
    },
    ConfigInvalid {
        id: ComponentId,
        violations: Vec<Violation>,
    },
    /// An execution setting or another argument of a request is not acceptable.
    ArgumentInvalid {
        what: String,
        why: String,
        field: String,
    },
    ComponentRefused {
        id: ComponentId,
        entry: &'static str,
        text: String,
    },
    ComponentFault {
        id: ComponentId,
        text: String,
    },
    /// There is no memory for the frames of these outputs: `bytes` were asked for, `why` says what there is.
    NoMemory {
        id: ComponentId,
        outputs: Vec<String>,
        bytes: u64,
        why: String,
    },
    /// The processes of a connection's ends cannot be linked.
    Unreachable {
        client: PortId,
        server: PortId,
        why: String,
    },
    /// The machine gives no thread for it.
    NoThread {
        id: ComponentId,
        why: String,
    },
    InUse {
        id: ComponentId,
        by: Vec<String>,
    },
    PluginAbi {
        file: String,
        text: String,
    },
    PluginUntrusted {
        file: String,
        text: String,
    },
    PluginBadFile {
        file: String,
        text: String,
    },
    RevisionConflict {
        expected: u64,
        actual: u64,
    },
    /// WaitFor: none of the wanted states came in time.
    NotReached {
        id: ComponentId,
        state: State,
        wanted: Vec<State>,
        after_ns: u64,
    },
    /// WaitFor: the event did not come in time. `state` is that of the component then.
    EventNotSeen {
        member: MemberId,
        state: State,
        after_ns: u64,
    },
    /// Read: an output gave no sample in time. `state` is that of its component then.
    NoSample {
        port: PortId,
        state: State,
        after_ns: u64,
    },
    /// The process, or a component of it, was not done before the deadline.
    LcmTimeout {
        process: Name,
        what: String,
    },
    /// Another request had what this one needs until its deadline; nothing was begun.
    Busy {
        doing: String,
    },
    Unbound {
        member: MemberId,
    },
    Disabled {
        member: MemberId,
    },
    NotActive {
        member: MemberId,
        state: State,
    },
    WouldBlock {
        member: MemberId,
    },
    CommandFailed {
        member: MemberId,
        text: String,
    },
    Deadline {
        member: MemberId,
        after_ns: u64,
        may_still_run: bool,
    },
    PeerLost {
        member: MemberId,
    },
    /// A newer call took its place before it ran, as the command's policy says.
    Replaced {
        member: MemberId,
    },
    QueueFull {
        member: MemberId,
        depth: usize,
    },
    NotImplemented {
        what: String,
        hint: String,
    },
    /// A component of this class starts programs, and its process lets none do that.
    ProgramsNotAllowed {
        process: Name,
        class: String,
    },
    /// A change asked by a caller that is neither the host's user nor has that user's token.
    Forbidden {
        what: String,
        /// As the kernel and the caller tell.
        caller: String,
        /// Number of the host's user.
        user: u32,
    },
    /// The request would change something, and came from a page that only reads.
    ReadOnly {
        what: String,
    },
    Internal {
        text: String,
    },
}

impl Refusal {
    /// A process that does not answer, of which nothing more is known.
    pub fn lost(process: Name) -> Refusal {
        Refusal::ProcessLost { process, state: ProcessState::Lost, last_exit: String::new() }
    }
}
