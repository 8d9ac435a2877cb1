//! Taps: the outputs every component has without any code, for recorders of its work. Their names and types.
//!
//! Invariant: they are the last outputs of every class, so positions of its own outputs stay what the
//! plugin's manifest says.

use std::sync::Arc;

use trocar_model::{EnumType, Field, Output, PortType, Ports, Prim, StructType, TAPS, Tag, Type};
use trocar_plugin_api::abi;

/// Bytes before the payload of an event or command.
pub const HEAD: usize = 16;
/// Bytes kept of a payload at most.
pub const MOST: usize = 4096;

/// Types nested deeper are not described within a tap's type: a reader of descriptions reads 32 levels, and
/// two are the tap's own.
const DEEPEST: usize = 30;

/// Outcomes as a command's sample names them.
const OUTCOMES: [(&str, abi::Outcome); 12] = [
    ("EXECUTED", abi::EXECUTED),
    ("QUEUED", abi::QUEUED),
    ("UNBOUND", abi::UNBOUND),
    ("QUEUE_FULL", abi::QUEUE_FULL),
    ("WOULD_BLOCK", abi::WOULD_BLOCK),
    ("DISABLED", abi::DISABLED),
    ("INVALID_ARGUMENT", abi::INVALID_ARGUMENT),
    ("FAILED", abi::FAILED),
    ("DEADLINE", abi::DEADLINE),
    ("PEER_LOST", abi::PEER_LOST),
    ("NOT_ACTIVE", abi::NOT_ACTIVE),
    ("EXHAUSTED", abi::EXHAUSTED),
];

/// An event or command as its tap tells it.
struct Member<'p> {
    /// `interface/member`.
    name: String,
    /// ABI id.
    id: usize,
    payload: Option<&'p Type>,
    unit: &'p str,
    doc: &'p str,
}

/// Appends the taps of a component with these ports, the system interface included.
pub fn append(ports: &mut Ports) {
    let tag = tag(ports);
    let tap = |name: &str, doc: &str, ty: Type| Output {
        name: name.into(),
        doc: doc.into(),
        ty: PortType::Plain(ty),
        tag,
    };
    let [rows, events, commands] = TAPS;
    let mut all = Vec::new();
    if let Some(state) = ports.state.as_ref().filter(|state| state.size() > 0) {
        all.push(tap(rows, "Each row of the state table as it is published.", state.clone()));
    }
    let sent = self::events(ports);
    if !sent.is_empty() {
        all.push(tap(events, "Each event the component sends.", told("TapEvents", &sent, false)));
    }
    let carried_out = self::commands(ports);
    if !carried_out.is_empty() {
        let ty = told("TapCommands", &carried_out, true);
        all.push(tap(commands, "Each command the component carries out or turns away, reads excepted.", ty));
    }
    ports.outputs.extend(all);
}

/// Returns the tag of the taps: rows, events and commands hold what tagged ports tell, so they go nowhere
/// those may not go.
fn tag(ports: &Ports) -> Tag {
    let outputs = ports.outputs.iter().map(|output| output.tag);
    let tagged =
        outputs.chain(ports.provided.iter().map(|provided| provided.tag)).any(|tag| tag != Tag::None);
    if tagged { Tag::Truth } else { Tag::None }
}

fn events(ports: &Ports) -> Vec<Member<'_>> {
    let all = ports.provided.iter().flat_map(|p| p.events.iter().map(move |e| (p, e))).enumerate();
    all.map(|(id, (interface, event))| Member {
        name: format!("{}/{}", interface.name, event.name),
        id,
        payload: event.payload.as_ref(),
        unit: &event.unit,
        doc: &event.doc,
    })
    .collect()
}

fn commands(ports: &Ports) -> Vec<Member<'_>> {
    let all = ports.provided.iter().flat_map(|p| p.commands.iter().map(move |c| (p, c))).enumerate();
    all.filter(|(_, (_, command))| !command.kind.is_read())
        .map(|(id, (interface, command))| Member {
            name: format!("{}/{}", interface.name, command.name),
            id,
            payload: command.arg.as_ref().map(|arg| &arg.ty),
            unit: command.arg.as_ref().map_or("", |arg| &arg.unit),
            doc: &command.doc,
        })
        .collect()
}

/// Returns the type that tells of any of `members`. Behind the bytes stand fields without length: for each
/// member with a payload an empty array of that type, which describes it field by field.
fn told(name: &str, members: &[Member<'_>], outcome: bool) -> Type {
    let size = |member: &Member<'_>| member.payload.map_or(0, Type::size);
    let room = members.iter().map(size).max().unwrap_or(0).min(MOST).next_multiple_of(8);
    let u32s = || Type::Prim(Prim::U32);
    let which = enumeration(
        format!("{name}.which"),
        Prim::U32,
        members.iter().map(|m| (m.name.clone(), m.id as i64)).collect(),
    );
    let mut fields = vec![("which", which, "what was sent or called")];
    if outcome {
        let values = OUTCOMES.map(|(name, value)| (name.to_owned(), i64::from(value)));
        let outcomes = enumeration(format!("{name}.outcome"), Prim::I32, values.to_vec());
        fields.push(("outcome", outcomes, "what came of it"));
    }
    fields.push(("len", u32s(), "bytes of the payload that follow"));
    fields.push(("whole", u32s(), "bytes of the payload; more than len: its end was cut"));
    if !outcome {
        fields.push(("reserved", u32s(), "0"));
    }
    let bytes = Type::Array { item: Box::new(Type::Prim(Prim::U8)), n: room };
    fields.push((
        "bytes",
        bytes,
        "the payload as it lies in memory, then zeros: its type is that of the field named as which",
    ));
    let mut at = 0;
    let mut field = |name: &str, ty: Type, unit: &str, doc: &str| {
        let field =
            Field { name: name.into(), at, unit: unit.into(), doc: doc.into(), frame: String::new(), ty };
        at += field.ty.size();
        field
    };
    let mut all: Vec<Field> = fields.into_iter().map(|(name, ty, doc)| field(name, ty, "", doc)).collect();
    for member in members {
        if let Some(payload) = member.payload.filter(|payload| levels(payload) <= DEEPEST) {
            let none = Type::Array { item: Box::new(payload.clone()), n: 0 };
            all.push(field(&member.name, none, member.unit, member.doc));
        }
    }
    let doc = "One of several members, with its payload.".into();
    Type::Struct(Arc::new(StructType { name: name.into(), doc, size: HEAD + room, align: 8, fields: all }))
}

/// Returns the depth of nesting of a type.
fn levels(ty: &Type) -> usize {
    match ty {
        Type::Array { item, .. } | Type::List { item, .. } => 1 + levels(item),
        Type::Struct(s) => 1 + s.fields.iter().map(|field| levels(&field.ty)).max().unwrap_or(0),
        Type::Prim(_) | Type::Text { .. } | Type::Enum(_) => 1,
    }
}

fn enumeration(name: String, repr: Prim, values: Vec<(String, i64)>) -> Type {
    Type::Enum(Arc::new(EnumType { name, repr, values }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde_json::Value;
    use trocar_model::{Event, Provided};
    use trocar_plugin_api::manifest as wire;

    use super::super::convert::back;
    use super::super::system;
    use super::*;

    fn event(name: &str, payload: Option<Type>) -> Event {
        Event { name: name.into(), doc: "Said.".into(), payload, unit: String::new() }
    }

    /// Events of these payloads, and the system's.
    fn ports(payloads: &[Type], tag: Tag) -> Ports {
        let events = payloads.iter().enumerate();
        let events = events.map(|(i, payload)| event(&format!("event{i}"), Some(payload.clone()))).collect();
        let own = Provided { name: "own".into(), doc: String::new(), tag, commands: Vec::new(), events };
        let mut ports = Ports { provided: vec![own, system::interface()], ..Ports::default() };
        append(&mut ports);
        ports
    }

    fn bytes(n: usize) -> Type {
        Type::Array { item: Box::new(Type::Prim(Prim::U8)), n }
    }

    #[test]
    fn a_component_without_commands_or_rows_has_no_taps_for_them() {
        let ports = ports(&[], Tag::None);
        let names: Vec<&str> = ports.outputs.iter().map(|output| output.name.as_str()).collect();
        assert_eq!(names, ["tap_events"]);
        assert!(ports.outputs.iter().all(Output::is_tap) && ports.own_outputs().next().is_none());
        assert_eq!(
            ports.names().collect::<Vec<_>>(),
            ["own", "system"],
            "they are offered to nobody who only mistyped"
        );
        assert!(ports.find("tap_events").is_some());
    }

    #[test]
    fn the_type_tells_every_payload_and_where_it_lies() {
        let ports = ports(&[bytes(3), bytes(MOST + 9)], Tag::None);
        let PortType::Plain(ty) = &ports.outputs[0].ty else { panic!("{ports:?}") };
        assert_eq!(ty.size(), HEAD + MOST, "no payload makes it larger");
        let text: Value = serde_json::from_str(&back::port(&ports.outputs[0].ty)).unwrap();
        let types: Vec<wire::NamedType> = serde_json::from_value(text["types"].clone()).unwrap();
        let of = |name: &str| types.iter().find(|ty| ty.name == name).unwrap();
        let values = &of("TapEvents.which").values;
        let which: Vec<(&str, i64)> = values.iter().map(|v| (v.name.as_str(), v.value)).collect();
        assert_eq!(which[..3], [("own/event0", 0), ("own/event1", 1), ("system/status", 2)]);
        let fields: Vec<(&str, usize)> =
            of("TapEvents").fields.iter().map(|f| (f.name.as_str(), f.at)).collect();
        let head = [("which", 0), ("len", 4), ("whole", 8), ("reserved", 12), ("bytes", 16)];
        assert_eq!(fields[..5], head);
        assert_eq!(fields[5..7], [("own/event0", HEAD + MOST), ("own/event1", HEAD + MOST)]);
        assert_eq!(
            of("TapEvents").fields[5].ty,
            wire::Type::Array {
                item: Box::new(wire::Type::Array { item: Box::new(wire::Type::Prim("u8".into())), n: 3 }),
                n: 0
            }
        );
        assert!(types.iter().any(|ty| ty.name == "ComponentStatus"), "payloads are described field by field");
    }

    #[test]
    fn payloads_of_two_types_make_two_types_of_taps() {
        let of = |payload: Type| ports(&[payload], Tag::None).outputs[0].ty.clone();
        let (PortType::Plain(a), PortType::Plain(b)) = (of(Type::Prim(Prim::U64)), of(Type::Prim(Prim::F64)))
        else {
            panic!("no samples")
        };
        assert_eq!(a.size(), b.size());
        assert!(!a.same(&b), "whoever reads one as the other would be wrong");
    }

    #[test]
    fn what_tells_the_truth_is_tapped_as_truth() {
        assert_eq!(ports(&[], Tag::None).outputs[0].tag, Tag::None);
        assert_eq!(ports(&[], Tag::Truth).outputs[0].tag, Tag::Truth);
        assert_eq!(ports(&[], Tag::Sim).outputs[0].tag, Tag::Truth);
    }
}
