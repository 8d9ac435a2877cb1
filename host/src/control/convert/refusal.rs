//! Refusals by their values, so that a remote caller gets the same sentence, code and help as a local one.
//!
//! Invariant: the list below names every refusal with every field (it does not compile otherwise).

use std::collections::HashMap;

use serde_json::{Value, json};
use trocar_model::{ComponentId, MemberId, Name, PortId, ProcessState, Refusal, State, Tag, Verb, Violation};
use trocar_proto::v1;

/// A value that travels as JSON.
trait Travels: Sized {
    fn put(&self) -> Value;
    fn take(value: &Value) -> Option<Self>;
}

macro_rules! refusals {
    ($($kind:ident { $($field:ident),* })*) => {
        fn values(refusal: &Refusal) -> (&'static str, Vec<(&'static str, Value)>) {
            match refusal {
                $(Refusal::$kind { $($field),* } => {
                    (stringify!($kind), vec![$((stringify!($field), $field.put())),*])
                })*
            }
        }

        fn from_values(kind: &str, values: &HashMap<String, String>) -> Option<Refusal> {
            match kind {
                $(stringify!($kind) => Some(Refusal::$kind {
                    $($field: field(values, stringify!($field))?),*
                }),)*
                _ => None,
            }
        }
    };
}

refusals! {
    BadPath { text, why }
    ProcessNotFound { process, known }
    ProcessLost { process, state, last_exit }
    NotSupervised { process, known }
    ProcessNotUp { process, why }
    ProcessRuns { process, state, pid }
    ProcessExists { process, endpoint, pid }
    ManagedElsewhere { at }
    PluginNotFound { name, known }
    ClassNotFound { process, class, known, elsewhere, ambiguous }
    ComponentExists { id }
    ComponentNotFound { id, known }
    NothingMatches { pattern, known }
    InterfaceNotFound { port, known }
    MemberNotFound { member, known }
    WrongKind { member, is, wanted }
    ConnectionNotFound { asked, known }
    WrongDirection { client, client_is, server, server_is }
    AlreadyConnected { client, server }
    ConnectionExists { id, client, server }
    CommandMissing { client, server, function, known }
    CommandKindMismatch { client, server, function, wants, has }
    TypeMismatch { client, server, what, difference }
    FormatMismatch { client, server, wants, has }
    TagMismatch { client, server, has }
    TruthToActuator { client, server, tag, path }
    SyncCycle { path }
    WrongState { id, state, verb, allowed, why }
    Unconnected { id, verb, ports }
    ConfigInvalid { id, violations }
    ArgumentInvalid { what, why, field }
    ComponentRefused { id, entry, text }
    ComponentFault { id, text }
    NoMemory { id, outputs, bytes, why }
    NoThread { id, why }
    Unreachable { client, server, why }
    InUse { id, by }
    PluginAbi { file, text }
    PluginUntrusted { file, text }
    PluginBadFile { file, text }
    RevisionConflict { expected, actual }
    NotReached { id, state, wanted, after_ns }
    EventNotSeen { member, state, after_ns }
    NoSample { port, state, after_ns }
    LcmTimeout { process, what }
    Busy { doing }
    Unbound { member }
    Disabled { member }
    NotActive { member, state }
    WouldBlock { member }
    CommandFailed { member, text }
    Deadline { member, after_ns, may_still_run }
    PeerLost { member }
    Replaced { member }
    QueueFull { member, depth }
    NotImplemented { what, hint }
    ProgramsNotAllowed { process, class }
    Forbidden { what, caller, user }
    ReadOnly { what }
    Internal { text }
}

pub(crate) fn refusal_info(refusal: &Refusal) -> v1::RefusalInfo {
    let (kind, values) = values(refusal);
    v1::RefusalInfo {
        kind: kind.into(),
        values: values.into_iter().map(|(name, value)| (name.to_owned(), value.to_string())).collect(),
        text: refusal.to_string(),
    }
}

/// A kind this build does not know keeps its sentence.
pub(crate) fn refusal(info: &v1::RefusalInfo) -> Refusal {
    from_values(&info.kind, &info.values).unwrap_or_else(|| Refusal::Internal { text: info.text.clone() })
}

fn field<T: Travels>(values: &HashMap<String, String>, name: &str) -> Option<T> {
    T::take(&serde_json::from_str(values.get(name)?).ok()?)
}

impl Travels for String {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_str().map(str::to_owned)
    }
}

impl Travels for bool {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_bool()
    }
}

impl<T: Travels> Travels for Vec<T> {
    fn put(&self) -> Value {
        self.iter().map(Travels::put).collect()
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_array()?.iter().map(T::take).collect()
    }
}

macro_rules! numbers {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self)
            }
            fn take(value: &Value) -> Option<Self> {
                value.as_u64()?.try_into().ok()
            }
        }
    )*};
}
numbers!(u32, u64, usize);

macro_rules! names {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self.to_string())
            }
            fn take(value: &Value) -> Option<Self> {
                <$ty>::parse(value.as_str()?).ok()
            }
        }
    )*};
}
names!(Name, ComponentId, PortId, MemberId);

macro_rules! words {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self.to_string())
            }
            fn take(value: &Value) -> Option<Self> {
                <$ty>::ALL.into_iter().find(|known| value.as_str() == Some(&known.to_string()))
            }
        }
    )*};
}
words!(State, Verb, ProcessState);

impl Travels for Tag {
    fn put(&self) -> Value {
        json!(self.name())
    }
    fn take(value: &Value) -> Option<Self> {
        Tag::parse(value.as_str()?)
    }
}

/// Words the refusals use for entries of a component and for kinds of ends.
const WORDS: [&str; 19] = [
    "create",
    "configure",
    "describe",
    "start",
    "step",
    "stop",
    "resume",
    "reset",
    "make_safe",
    "destroy",
    "call",
    "handle",
    "run",
    "show its state",
    "show an output",
    "an input",
    "an output",
    "a required interface",
    "a provided interface",
];

impl Travels for &'static str {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        let text = value.as_str()?;
        Some(WORDS.into_iter().find(|word| *word == text).unwrap_or("a call"))
    }
}

impl Travels for Violation {
    fn put(&self) -> Value {
        json!([self.pointer, self.message])
    }
    fn take(value: &Value) -> Option<Self> {
        Some(Violation { pointer: String::take(value.get(0)?)?, message: String::take(value.get(1)?)? })
    }
}

#[cfg(test)]
mod tests {
    use trocar_model::StopReason;

    use super::*;

    #[test]
    fn every_refusal_arrives_as_it_was_sent() {
        for sent in Refusal::examples() {
            let arrived = refusal(&refusal_info(&sent));
            assert_eq!(arrived, sent, "sent {sent:?}");
        }
    }

    #[test]
    fn a_refusal_of_a_newer_build_keeps_its_sentence() {
        let info = v1::RefusalInfo {
            kind: "Later".into(),
            text: "the moon is not full".into(),
            ..Default::default()
        };
        assert!(refusal(&info).to_string().contains("the moon is not full"));
        assert_eq!(refusal(&refusal_info(&refusal(&info))), refusal(&info));
    }

    #[test]
    fn stop_reasons_survive() {
        let state = State::Stopped(StopReason::Interlock);
        assert_eq!(State::take(&state.put()), Some(state));
    }
}
