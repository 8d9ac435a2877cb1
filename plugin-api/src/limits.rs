//! Upper limits of a host for a class, and the check of a description against them while a plugin is
//! compiled.
//!
//! Invariant: no class that passes here and the derives is refused when a host lists it. The numbers are the
//! host's own (`tests/it/embedding/limits.rs` holds both sides together), so one may only grow after the
//! host's has.

use crate::const_text::{Sentence, same_text};
use crate::desc::{
    ClassDesc, CommandKind, InputDesc, OutputDesc, PluginDesc, PortType, ProvidedDesc, RequiredDesc,
    TypeDesc, TypeKind,
};

/// Longest name of a class, port, interface or member, bytes.
pub const MAX_NAME: usize = 63;
/// The interface that every component has; no port of a class is called so.
pub const RESERVED_NAME: &str = "system";
/// Outputs that every component has; no port of a class is called so.
pub const RESERVED_OUTPUTS: [&str; 3] = ["tap_rows", "tap_events", "tap_commands"];
/// Shortest and longest period, ns.
pub const PERIOD_NS: (u64, u64) = (1_000, 3_600_000_000_000);
/// Limits of the longest stay inside a component's own code, ns.
pub const MAX_STEP_NS: (u64, u64) = (100_000, 3_600_000_000_000);
/// Execution models whose thread steps on a grid, so that a rate means something.
pub const MODELS_WITH_RATE: [&str; 2] = ["periodic", "stream"];
/// Longest queue an input may ask for, samples.
pub const MAX_FIFO: usize = 65_536;
/// Largest frame of an output, bytes.
pub const MAX_FRAME: usize = 1 << 30;
/// Largest plain payload, header of a frame, or row of a state table, bytes.
pub const MAX_PAYLOAD: usize = 64 * 1024;
/// Most inputs, outputs, functions, commands, handlers and events of one class together.
pub const MAX_MEMBERS: usize = 10_000;
/// Deepest nesting of arrays, lists and structs.
pub const MAX_DEPTH: usize = 32;

/// Returns what is wrong with a name; none when a host takes it.
pub fn name_fault(name: &str) -> Option<String> {
    let first = |c: char| c.is_ascii_alphabetic() || c == '_';
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    let why = if name.is_empty() || !name.chars().all(fits) {
        "use letters, digits, `_` and `-`".to_string()
    } else if !name.starts_with(first) {
        "it begins with a letter or `_`".to_string()
    } else if name.len() > MAX_NAME {
        format!("it has {} bytes, and at most {MAX_NAME} are allowed", name.len())
    } else {
        return None;
    };
    Some(format!("`{name}` is not a name: {why}"))
}

/// Fails the build of a class that no host would list.
///
/// # Panics
/// A host would not list the class; the message says what is wrong, and where.
pub const fn check_class(class: &ClassDesc) {
    let many = &class.many;
    ports(class.inputs, class.outputs);
    ports(many.inputs, many.outputs);
    let members = class.inputs.len()
        + class.outputs.len()
        + interfaces(class.required, class.provided)
        + interfaces(many.required, many.provided);
    if let Some(state) = class.state {
        payload(Place { kind: "the #[state] fields", interface: "", name: "" }, state);
    }
    if members > MAX_MEMBERS {
        let sentence = Sentence::of("a class has at most ").number(MAX_MEMBERS);
        sentence.text(" ports and members, this one ").number(members).fail();
    }
}

/// Fails the build of a plugin that no host would list.
///
/// # Panics
/// A host would not list the plugin; the message says what is wrong.
pub const fn check_plugin(plugin: &PluginDesc) {
    let name = plugin.name.as_bytes();
    let mut plain = !name.is_empty() && name.len() <= MAX_NAME;
    let mut i = 0;
    while i < name.len() {
        plain = plain && (name[i].is_ascii_alphanumeric() || name[i] == b'_' || name[i] == b'-');
        i += 1;
    }
    if !plain {
        let sentence = Sentence::of("the name of the plugin, `").text(plugin.name);
        sentence.text("`, is not 1 to ").number(MAX_NAME).text(" letters, digits, `_` or `-`").fail();
    }
    i = 0;
    while i < plugin.classes.len() {
        let mut j = 0;
        while j < i {
            if same_text(plugin.classes[i].name, plugin.classes[j].name) {
                let sentence = Sentence::of("two classes of this plugin are called `");
                let sentence = sentence.text(plugin.classes[i].name);
                sentence.text("`: give one another name, #[component(name = \"…\")]").fail();
            }
            j += 1;
        }
        i += 1;
    }
}

const fn ports(inputs: &[InputDesc], outputs: &[OutputDesc]) {
    let mut i = 0;
    while i < inputs.len() {
        port(Place { kind: "input", interface: "", name: inputs[i].name }, inputs[i].ty);
        i += 1;
    }
    i = 0;
    while i < outputs.len() {
        port(Place { kind: "output", interface: "", name: outputs[i].name }, outputs[i].ty);
        i += 1;
    }
}

const fn port(place: Place, ty: PortType) {
    match ty {
        PortType::Plain(ty) | PortType::Frame { header: ty, .. } => payload(place, ty),
        PortType::Any => {}
    }
}

/// Checks every member and counts them.
const fn interfaces(required: &[RequiredDesc], provided: &[ProvidedDesc]) -> usize {
    let mut members = 0;
    let mut i = 0;
    while i < required.len() {
        let of = &required[i];
        let mut j = 0;
        while j < of.functions.len() {
            let place = Place { kind: "function", interface: of.name, name: of.functions[j].name };
            optional(place, of.functions[j].arg);
            optional(place, of.functions[j].ret);
            j += 1;
        }
        j = 0;
        while j < of.handlers.len() {
            let place = Place { kind: "handler", interface: of.name, name: of.handlers[j].name };
            optional(place, of.handlers[j].payload);
            j += 1;
        }
        members += of.functions.len() + of.handlers.len();
        i += 1;
    }
    i = 0;
    while i < provided.len() {
        let of = &provided[i];
        let mut j = 0;
        while j < of.commands.len() {
            let command = &of.commands[j];
            let place = Place { kind: "command", interface: of.name, name: command.name };
            if let Some(arg) = &command.arg {
                payload(place, arg.ty);
            }
            optional(place, command.ret);
            if matches!(command.kind, CommandKind::Read | CommandKind::QualifiedRead) && command.ret.is_none()
            {
                let place = Place { kind: "read", ..place };
                place.sentence().text("a read returns a value, and this one returns nothing").fail();
            }
            j += 1;
        }
        j = 0;
        while j < of.events.len() {
            let place = Place { kind: "event", interface: of.name, name: of.events[j].name };
            optional(place, of.events[j].payload);
            j += 1;
        }
        members += of.commands.len() + of.events.len();
        i += 1;
    }
    members
}

const fn optional(place: Place, ty: Option<&'static TypeDesc>) {
    if let Some(ty) = ty {
        payload(place, ty);
    }
}

const fn payload(place: Place, ty: &TypeDesc) {
    if ty.size > MAX_PAYLOAD {
        let sentence = place.sentence().number(ty.size).text(" bytes are more than a value may have, ");
        sentence.number(MAX_PAYLOAD).text(": send it through a port of frames, `Frame<Header>`").fail();
    }
    nested(place, ty, 0);
}

const fn nested(place: Place, ty: &TypeDesc, depth: usize) {
    if depth > MAX_DEPTH {
        let sentence = place.sentence().text("its type is nested deeper than ");
        sentence.number(MAX_DEPTH).text(" arrays, lists and structs").fail();
    }
    match &ty.kind {
        TypeKind::Array { item, n } | TypeKind::List { item, n } => {
            if *n > MAX_PAYLOAD {
                place.sentence().number(*n).text(" items are more than ").number(MAX_PAYLOAD).fail();
            }
            nested(place, item, depth + 1);
        }
        TypeKind::Struct { fields, .. } => {
            let mut i = 0;
            while i < fields.len() {
                nested(place, fields[i].ty, depth + 1);
                i += 1;
            }
        }
        TypeKind::Prim(_) | TypeKind::Text { .. } | TypeKind::Enum { .. } => {}
    }
}

/// Subject of a message: `command ctl/move`.
#[derive(Clone, Copy)]
struct Place {
    kind: &'static str,
    interface: &'static str,
    name: &'static str,
}

impl Place {
    const fn sentence(self) -> Sentence {
        let mut sentence = Sentence::of(self.kind);
        if !self.name.is_empty() {
            sentence = sentence.text(" ");
        }
        if !self.interface.is_empty() {
            sentence = sentence.text(self.interface).text("/");
        }
        sentence.text(self.name).text(": ")
    }
}

#[cfg(test)]
#[path = "limits_tests.rs"]
mod tests;
