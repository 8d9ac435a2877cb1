//! The manifest as a host reads it from the note.
//!
//! Invariant: unknown keys are ignored (newer plugins load in older hosts); an error names a missing key that
//! a host needs.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Version of the manifest format.
pub const FORMAT: u32 = 1;

/// A plugin, as its note says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Manifest format, [`FORMAT`].
    pub trocar: u32,
    /// ABI major and minor the plugin was built for.
    pub abi: [u32; 2],
    /// Name: letters, digits, `_`, `-`.
    pub name: String,
    /// Version; the same as in the entry's table.
    pub version: String,
    /// Maker, shown.
    #[serde(default)]
    pub vendor: String,
    /// Licence, shown.
    #[serde(default)]
    pub license: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Compiler and SDK, shown.
    #[serde(default)]
    pub built_with: String,
    /// "unwind" for Rust plugins, "none" for other languages.
    #[serde(default)]
    pub panic: String,
    /// The library may leave the process when nothing of it is used any more.
    #[serde(default)]
    pub unload: bool,
    /// Every struct and enum used below, once; others refer to it by name.
    #[serde(default)]
    pub types: Vec<NamedType>,
    /// Its classes, in the order of the entry's table.
    pub classes: Vec<Class>,
}

/// A struct or an enum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedType {
    /// Name by which others refer to it.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Bytes of a value.
    pub size: usize,
    /// Alignment, bytes.
    pub align: usize,
    /// Present for structs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fields: Vec<Field>,
    /// Present for enums: the integer behind it and its named values.
    #[serde(default, rename = "enum", skip_serializing_if = "Option::is_none")]
    pub repr: Option<String>,
    /// Named values of an enum.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<EnumValue>,
}

/// One named value of an enum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EnumValue {
    /// Name of the value.
    pub name: String,
    /// The number behind it.
    pub value: i64,
}

/// One field of a struct.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Field {
    /// Name of the field.
    pub name: String,
    /// Offset in its struct, bytes.
    pub at: usize,
    /// Type of the field.
    #[serde(rename = "type")]
    pub ty: Type,
    /// Unit of its numbers; empty = none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Documentation.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub doc: String,
    /// Coordinate frame of its coordinates; empty = not said.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
}

/// `"f64"`, `{"ref":"Force"}`, `{"array":T,"n":3}`, `{"list":T,"n":16}`, `{"text":64}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Type {
    /// A primitive by its name.
    Prim(String),
    /// One of the named types.
    Ref {
        /// Its name.
        #[serde(rename = "ref")]
        name: String,
    },
    /// `n` items, one after the other.
    Array {
        /// Type of an item.
        #[serde(rename = "array")]
        item: Box<Type>,
        /// Number of items.
        n: usize,
    },
    /// A u64 length, then room for `n` items.
    List {
        /// Type of an item.
        #[serde(rename = "list")]
        item: Box<Type>,
        /// Most items.
        n: usize,
    },
    /// A u64 length in bytes, then room for UTF-8.
    Text {
        /// Most bytes.
        #[serde(rename = "text")]
        n: usize,
    },
}

/// `{"plain":T}`, `{"frame":T,"format":"image","max_bytes":0}`, `"any"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PortType {
    /// Plain samples.
    Plain {
        /// Their type.
        plain: Type,
    },
    /// A header and bytes.
    Frame {
        /// Type of the header.
        frame: Type,
        /// Name of the way the bytes are read.
        #[serde(default)]
        format: String,
        /// Bytes of the largest frame; 0 = reserved at Configure.
        #[serde(default)]
        max_bytes: usize,
    },
    /// The text "any".
    Any(String),
}

/// A component class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// Name, unique in its plugin.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// "none", "sensor", "actuator".
    #[serde(default = "none")]
    pub safety: String,
    /// Opens a device.
    #[serde(default)]
    pub hardware: bool,
    /// `make_safe` touches only what is made for several threads: it may be called while another entry hangs.
    #[serde(default)]
    pub safe_from_any_thread: bool,
    /// Starts programs: created only in a process that allows that.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub starts_programs: bool,
    /// How it runs, and may run.
    #[serde(default)]
    pub execution: Execution,
    /// JSON Schema of the configuration object, with the extra keywords `unit` and `live`.
    #[serde(default = "empty_schema")]
    pub config: Value,
    /// Its inputs, in the order of their slots.
    #[serde(default)]
    pub inputs: Vec<Input>,
    /// Its outputs, in the order of their slots.
    #[serde(default)]
    pub outputs: Vec<Output>,
    /// Its required interfaces.
    #[serde(default)]
    pub required: Vec<Required>,
    /// Its provided interfaces.
    #[serde(default)]
    pub provided: Vec<Provided>,
    /// Type of a row of its state table, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<Type>,
}

/// Output of `describe`: the class with the present configuration, and the types its ports name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// Types that its ports name.
    #[serde(default)]
    pub types: Vec<NamedType>,
    /// The class as it is now.
    pub class: Class,
}

/// Source of a class's thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Execution {
    /// Default model: "periodic", "continuous", "on_signal", "on_callback", "stream", "none".
    #[serde(default)]
    pub model: String,
    /// Default period, ns; 0 = none.
    #[serde(default)]
    pub period_ns: u64,
    /// Longest stay inside its own code before a component without a period counts as unresponsive; 0 = 50
    /// ms.
    #[serde(default)]
    pub max_step_ns: u64,
    /// Models its components can be run by; empty = any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<String>,
    /// Shortest and longest time between two steps it is made for, ns; 0 = no limit.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub min_period_ns: u64,
    /// The longest of the two, ns; 0 = no limit.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub max_period_ns: u64,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// An input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// Name of the port.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of its samples.
    #[serde(rename = "type")]
    pub ty: PortType,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// "" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
    /// The component starts without a connection of it.
    #[serde(default)]
    pub optional: bool,
    /// Depth of its queue in samples; 0 = the newest only.
    #[serde(default)]
    pub fifo: usize,
}

/// An output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// Name of the port.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of its samples.
    #[serde(rename = "type")]
    pub ty: PortType,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// "", "truth" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
}

/// A provided interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provided {
    /// Name of the interface.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// "", "truth" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
    /// Its commands, in the order of their ids.
    #[serde(default)]
    pub commands: Vec<Command>,
    /// Its events, in the order of their ids.
    #[serde(default)]
    pub events: Vec<Event>,
}

/// A command of a provided interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// Name of the command.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// "void", "write", "read", "qualified_read", "void_return", "write_return".
    pub kind: String,
    /// Its argument, where it takes one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arg: Option<Arg>,
    /// Type of its result, where it gives one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ret: Option<Type>,
    /// Unit of the result; empty = none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub ret_unit: String,
    /// Coordinate frame of the result.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub ret_frame: String,
    /// "reject", "latest_wins", "drop_oldest".
    #[serde(default = "reject")]
    pub overflow: String,
}

/// The argument of a command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arg {
    /// Name; may be empty.
    #[serde(default)]
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of the argument.
    #[serde(rename = "type")]
    pub ty: Type,
    /// Unit of its numbers; empty = none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// Lowest value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Highest value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

/// An event of a provided interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Name of the event.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of its payload, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<Type>,
    /// Unit of a payload that is a number; empty = none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
}

/// A required interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Required {
    /// Name of the interface.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// The component starts without a connection of it.
    #[serde(default)]
    pub optional: bool,
    /// Its functions, in the order of their ids.
    #[serde(default)]
    pub functions: Vec<Function>,
    /// Its handlers, in the order of their ids.
    #[serde(default)]
    pub handlers: Vec<Handler>,
}

/// A function of a required interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Function {
    /// Name of the function, and of the command it is bound to.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of its argument, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arg: Option<Type>,
    /// Type of its result, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ret: Option<Type>,
    /// Unit the argument must have; empty = not checked.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of argument and result, of whichever has coordinates.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// The interface may be connected to one without this command.
    #[serde(default)]
    pub optional: bool,
    /// Takes the type of the command it is connected to.
    #[serde(default)]
    pub any: bool,
}

/// A handler of a required interface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Handler {
    /// Name of the handler, and of the event it hears.
    pub name: String,
    /// Documentation.
    #[serde(default)]
    pub doc: String,
    /// Type of the payload, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<Type>,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// The interface may be connected to one without this event.
    #[serde(default)]
    pub optional: bool,
    /// Runs inside `emit` when both ends share an executor.
    #[serde(default)]
    pub direct: bool,
}

fn none() -> String {
    "none".into()
}
fn reject() -> String {
    "reject".into()
}
fn empty_schema() -> Value {
    serde_json::json!({"type": "object", "additionalProperties": false, "properties": {}})
}

impl Manifest {
    /// Parses and checks the format; trailing padding of the note is ignored.
    ///
    /// # Errors
    /// A sentence that says where the text is not a manifest of this format.
    pub fn parse(note: &[u8]) -> Result<Manifest, String> {
        let text = std::str::from_utf8(note).map_err(|e| format!("the manifest is not UTF-8: {e}"))?;
        let text = text.trim_end_matches(['\0', ' ']);
        let manifest: Manifest =
            serde_json::from_str(text).map_err(|e| format!("the manifest is not understood: {e}"))?;
        if manifest.trocar != FORMAT {
            return Err(format!(
                "the manifest has format {}, this host reads {FORMAT}: rebuild the plugin",
                manifest.trocar
            ));
        }
        Ok(manifest)
    }

    /// The struct or enum a [`Type::Ref`] names.
    pub fn named(&self, name: &str) -> Option<&NamedType> {
        self.types.iter().find(|t| t.name == name)
    }
}
