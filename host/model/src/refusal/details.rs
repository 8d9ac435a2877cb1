//! The machine-readable side of a refusal: code, reason, metadata, field violations.
//!
//! Invariant: reasons and metadata keys only grow; clients match on them.

use std::collections::BTreeMap;
use std::fmt::Display;

use super::text::{brief, near};
use crate::{Code, Refusal, Tag};

/// Entries of a list, and fields, that metadata names.
const MOST: usize = 100;

impl Code {
    /// The name gRPC gives it.
    pub fn name(self) -> &'static str {
        match self {
            Code::InvalidArgument => "INVALID_ARGUMENT",
            Code::NotFound => "NOT_FOUND",
            Code::AlreadyExists => "ALREADY_EXISTS",
            Code::FailedPrecondition => "FAILED_PRECONDITION",
            Code::Aborted => "ABORTED",
            Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
            Code::Unavailable => "UNAVAILABLE",
            Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
            Code::PermissionDenied => "PERMISSION_DENIED",
            Code::Unimplemented => "UNIMPLEMENTED",
            Code::Internal => "INTERNAL",
        }
    }
}

impl Refusal {
    pub fn code(&self) -> Code {
        self.code_and_reason().0
    }

    /// `reason` of the ErrorInfo; its domain is "trocar.v1".
    pub fn reason(&self) -> &'static str {
        self.code_and_reason().1
    }

    fn code_and_reason(&self) -> (Code, &'static str) {
        use Code::*;
        match self {
            Refusal::BadPath { .. } => (InvalidArgument, "BAD_PATH"),
            Refusal::ProcessNotFound { .. } => (NotFound, "PROCESS_NOT_FOUND"),
            Refusal::ProcessLost { .. } => (Unavailable, "PROCESS_LOST"),
            Refusal::NotSupervised { .. } => (FailedPrecondition, "NOT_SUPERVISED"),
            Refusal::ProcessNotUp { .. } => (Unavailable, "PROCESS_NOT_UP"),
            Refusal::ProcessRuns { .. } => (FailedPrecondition, "PROCESS_RUNS"),
            Refusal::ProcessExists { .. } => (AlreadyExists, "PROCESS_EXISTS"),
            Refusal::ClassNotFound { .. } => (NotFound, "CLASS_NOT_FOUND"),
            Refusal::ComponentExists { .. } => (AlreadyExists, "COMPONENT_EXISTS"),
            Refusal::ComponentNotFound { .. } => (NotFound, "COMPONENT_NOT_FOUND"),
            Refusal::NothingMatches { .. } => (NotFound, "NOTHING_MATCHES"),
            Refusal::InterfaceNotFound { .. } => (NotFound, "INTERFACE_NOT_FOUND"),
            Refusal::MemberNotFound { .. } => (NotFound, "MEMBER_NOT_FOUND"),
            Refusal::WrongKind { .. } => (InvalidArgument, "WRONG_KIND"),
            Refusal::ManagedElsewhere { .. } => (FailedPrecondition, "MANAGED_ELSEWHERE"),
            Refusal::PluginNotFound { .. } => (NotFound, "PLUGIN_NOT_FOUND"),
            Refusal::ConnectionNotFound { .. } => (NotFound, "CONNECTION_NOT_FOUND"),
            Refusal::WrongDirection { .. } => (InvalidArgument, "WRONG_DIRECTION"),
            Refusal::AlreadyConnected { .. } => (AlreadyExists, "ALREADY_CONNECTED"),
            Refusal::ConnectionExists { .. } => (AlreadyExists, "CONNECTION_EXISTS"),
            Refusal::CommandMissing { .. } => (FailedPrecondition, "COMMAND_MISSING"),
            Refusal::CommandKindMismatch { .. } => (FailedPrecondition, "COMMAND_KIND_MISMATCH"),
            Refusal::TypeMismatch { .. } => (FailedPrecondition, "TYPE_MISMATCH"),
            Refusal::FormatMismatch { .. } => (FailedPrecondition, "FORMAT_MISMATCH"),
            Refusal::TagMismatch { .. } => (FailedPrecondition, "TAG_MISMATCH"),
            Refusal::TruthToActuator { .. } => (FailedPrecondition, "TRUTH_TO_ACTUATOR"),
            Refusal::SyncCycle { .. } => (FailedPrecondition, "SYNC_CYCLE"),
            Refusal::WrongState { .. } => (FailedPrecondition, "WRONG_STATE"),
            Refusal::Unconnected { .. } => (FailedPrecondition, "UNCONNECTED"),
            Refusal::ConfigInvalid { .. } => (InvalidArgument, "CONFIG_INVALID"),
            Refusal::ArgumentInvalid { .. } => (InvalidArgument, "ARGUMENT_INVALID"),
            Refusal::ComponentRefused { .. } => (FailedPrecondition, "COMPONENT_REFUSED"),
            Refusal::ComponentFault { .. } => (Internal, "COMPONENT_FAULT"),
            Refusal::NoMemory { .. } => (ResourceExhausted, "NO_MEMORY"),
            Refusal::Unreachable { .. } => (Unavailable, "UNREACHABLE"),
            Refusal::NoThread { .. } => (ResourceExhausted, "NO_THREAD"),
            Refusal::InUse { .. } => (FailedPrecondition, "IN_USE"),
            Refusal::PluginAbi { .. } => (FailedPrecondition, "PLUGIN_ABI"),
            Refusal::PluginUntrusted { .. } => (FailedPrecondition, "PLUGIN_UNTRUSTED"),
            Refusal::PluginBadFile { .. } => (FailedPrecondition, "PLUGIN_BAD_FILE"),
            Refusal::RevisionConflict { .. } => (Aborted, "REVISION_CONFLICT"),
            Refusal::NotReached { .. } => (DeadlineExceeded, "NOT_REACHED"),
            Refusal::EventNotSeen { .. } => (DeadlineExceeded, "EVENT_NOT_SEEN"),
            Refusal::NoSample { .. } => (DeadlineExceeded, "NO_SAMPLE"),
            Refusal::LcmTimeout { .. } => (DeadlineExceeded, "LCM_TIMEOUT"),
            Refusal::Busy { .. } => (DeadlineExceeded, "BUSY"),
            Refusal::Unbound { .. } => (FailedPrecondition, "UNBOUND"),
            Refusal::Disabled { .. } => (FailedPrecondition, "DISABLED"),
            Refusal::NotActive { .. } => (FailedPrecondition, "NOT_ACTIVE"),
            Refusal::WouldBlock { .. } => (FailedPrecondition, "WOULD_BLOCK"),
            Refusal::CommandFailed { .. } => (Aborted, "COMMAND_FAILED"),
            Refusal::Deadline { .. } => (DeadlineExceeded, "DEADLINE"),
            Refusal::PeerLost { .. } => (Unavailable, "PEER_LOST"),
            Refusal::Replaced { .. } => (Aborted, "REPLACED"),
            Refusal::QueueFull { .. } => (ResourceExhausted, "QUEUE_FULL"),
            Refusal::NotImplemented { .. } => (Unimplemented, "NOT_IMPLEMENTED"),
            Refusal::ProgramsNotAllowed { .. } => (PermissionDenied, "PROGRAMS_NOT_ALLOWED"),
            Refusal::Forbidden { .. } => (PermissionDenied, "FORBIDDEN"),
            Refusal::ReadOnly { .. } => (PermissionDenied, "READ_ONLY"),
            Refusal::Internal { .. } => (Internal, "INTERNAL"),
        }
    }

    /// The values of the refusal by name: ids, `nearest`, `known` and other lists separated by commas.
    pub fn metadata(&self) -> BTreeMap<String, String> {
        use Refusal::*;
        let mut m = Metadata(BTreeMap::new());
        match self {
            BadPath { text, .. } => m.put("text", text),
            ProcessNotFound { process, known } => m.put("process", process).known(process.as_str(), known),
            ProcessLost { process, state, last_exit } => {
                m.put("process", process).put("state", state);
                if last_exit.is_empty() { &mut m } else { m.put("last_exit", last_exit) }
            }
            NotSupervised { process, known } => m.put("process", process).list("known", known),
            ProcessNotUp { process, why } => m.put("process", process).put("why", why),
            ProcessRuns { process, state, pid } => {
                m.put("process", process).put("state", state).put("pid", pid)
            }
            ProcessExists { process, endpoint, pid } => {
                m.put("process", process).put("endpoint", endpoint).put("pid", pid)
            }
            ClassNotFound { process, class, known, elsewhere, ambiguous } => m
                .put("process", process)
                .put("class", class)
                .known(class, known)
                .list("elsewhere", elsewhere)
                .list("ambiguous", ambiguous),
            ComponentExists { id } => m.put("component", id),
            ComponentNotFound { id, known } => m.put("component", id).known(&id.to_string(), known),
            NothingMatches { pattern, known } => m.put("pattern", pattern).known(pattern, known),
            InterfaceNotFound { port, known } => m.put("port", port).known(port.port.as_str(), known),
            MemberNotFound { member, known } => m.put("member", member).known(member.member.as_str(), known),
            WrongKind { member, is, wanted } => m.put("member", member).put("is", is).put("wanted", wanted),
            ManagedElsewhere { at } => m.put("gcm", at),
            PluginNotFound { name, known } => m.put("name", name).known(name, known),
            ConnectionNotFound { asked, known } => m.put("asked", asked).list("known", known),
            WrongDirection { client, client_is, server, server_is } => {
                m.ends(client, server).put("client_is", client_is).put("server_is", server_is)
            }
            AlreadyConnected { client, server } => m.ends(client, server),
            ConnectionExists { id, client, server } => m.put("id", id).ends(client, server),
            CommandMissing { client, server, function, known } => {
                m.ends(client, server).put("function", function).known(function, known)
            }
            CommandKindMismatch { client, server, function, wants, has } => {
                m.ends(client, server).put("function", function).put("wants", wants).put("has", has)
            }
            TypeMismatch { client, server, what, difference } => {
                m.ends(client, server).put("what", what).put("difference", difference)
            }
            FormatMismatch { client, server, wants, has } => {
                m.ends(client, server).put("wants", wants).put("has", has)
            }
            TagMismatch { client, server, has } => {
                m.ends(client, server).put("has", if *has == Tag::None { "none" } else { has.name() })
            }
            TruthToActuator { client, server, tag, path } => {
                m.ends(client, server).put("tag", tag.name()).list("path", path)
            }
            SyncCycle { path } => m.list("path", path),
            WrongState { id, state, verb, allowed, .. } => {
                m.put("component", id).put("state", state).put("verb", verb).list("allowed", allowed)
            }
            Unconnected { id, verb, ports } => m.put("component", id).put("verb", verb).list("ports", ports),
            ConfigInvalid { id, .. } => m.put("component", id),
            ArgumentInvalid { what, field, .. } => m.put("what", what).put("field", field),
            ComponentRefused { id, entry, text } => {
                m.put("component", id).put("entry", entry).put("text", text)
            }
            ComponentFault { id, text } => m.put("component", id).put("text", text),
            NoMemory { id, outputs, bytes, why } => {
                m.put("component", id).list("outputs", outputs).put("bytes", bytes).put("why", why)
            }
            Unreachable { client, server, why } => {
                m.put("client", client).put("server", server).put("why", why)
            }
            NoThread { id, why } => m.put("component", id).put("why", why),
            InUse { id, by } => m.put("component", id).list("by", by),
            PluginAbi { file, text } | PluginUntrusted { file, text } | PluginBadFile { file, text } => {
                m.put("file", file).put("text", text)
            }
            RevisionConflict { expected, actual } => m.put("expected", expected).put("actual", actual),
            NotReached { id, state, wanted, after_ns } => {
                m.put("component", id).put("state", state).list("wanted", wanted).put("after_ns", after_ns)
            }
            EventNotSeen { member, state, after_ns } => {
                m.put("member", member).put("state", state).put("after_ns", after_ns)
            }
            NoSample { port, state, after_ns } => {
                m.put("port", port).put("state", state).put("after_ns", after_ns)
            }
            LcmTimeout { process, what } => m.put("process", process).put("what", what),
            Busy { doing } => m.put("doing", doing),
            Unbound { member }
            | Disabled { member }
            | WouldBlock { member }
            | PeerLost { member }
            | Replaced { member } => m.put("member", member),
            NotActive { member, state } => m.put("member", member).put("state", state),
            CommandFailed { member, text } => m.put("member", member).put("text", text),
            Deadline { member, after_ns, may_still_run } => {
                m.put("member", member).put("after_ns", after_ns).put("may_still_run", may_still_run)
            }
            QueueFull { member, depth } => m.put("member", member).put("depth", depth),
            NotImplemented { what, .. } | ReadOnly { what } => m.put("what", what),
            ProgramsNotAllowed { process, class } => m.put("process", process).put("class", class),
            Forbidden { what, caller, user } => m.put("what", what).put("caller", caller).put("user", user),
            Internal { text } => m.put("text", text),
        };
        m.0
    }

    /// Returns (field of the request, what is wrong with it), for the BadRequest detail; empty where no field
    /// is to blame.
    pub fn field_violations(&self) -> Vec<(String, String)> {
        match self {
            Refusal::ConfigInvalid { violations, .. } => {
                let first = violations.iter().take(MOST);
                first.map(|v| (format!("config{}", v.pointer), v.message.clone())).collect()
            }
            Refusal::ArgumentInvalid { why, field, .. } => vec![(field.clone(), why.clone())],
            Refusal::BadPath { why, .. } => vec![("path".to_owned(), why.clone())],
            Refusal::WrongDirection { client_is, server_is, .. } => vec![
                ("client".to_owned(), format!("it is {client_is}")),
                ("server".to_owned(), format!("it is {server_is}")),
            ],
            _ => Vec::new(),
        }
    }
}

struct Metadata(BTreeMap<String, String>);

impl Metadata {
    fn put(&mut self, key: &str, value: impl Display) -> &mut Metadata {
        self.0.insert(key.to_owned(), brief(&value.to_string()).into_owned());
        self
    }

    /// The first [`MOST`]: an answer must fit the header it travels in.
    fn list<T: Display>(&mut self, key: &str, items: &[T]) -> &mut Metadata {
        let items: Vec<String> = items.iter().take(MOST).map(ToString::to_string).collect();
        if !items.is_empty() {
            self.0.insert(key.to_owned(), items.join(","));
        }
        self
    }

    fn known<T: Display>(&mut self, wanted: &str, known: &[T]) -> &mut Metadata {
        if let Some(name) = near(wanted, known) {
            self.put("nearest", name);
        }
        self.list("known", known)
    }

    fn ends(&mut self, client: impl Display, server: impl Display) -> &mut Metadata {
        self.put("client", client).put("server", server)
    }
}
