//! The manifest as a host reads it from the note.
//!
//! Invariant: unknown keys are ignored (newer plugins load in older hosts); an error names a missing key that
//! a host needs.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Version of the manifest format.
pub const FORMAT: u32 = 1;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Manifest format, [`FORMAT`].
    pub trocar: u32,
    /// ABI major and minor the plugin was built for.
    pub abi: [u32; 2],
    pub name: String,
    pub version: String,
    #[serde(default)]
    pub vendor: String,
    #[serde(default)]
    pub license: String,
    #[serde(default)]
    pub doc: String,
    #[serde(default)]
    pub built_with: String,
    /// "unwind" for Rust plugins, "none" for other languages.
    #[serde(default)]
    pub panic: String,
    #[serde(default)]
    pub unload: bool,
    /// Every struct and enum used below, once; others refer to it by name.
    #[serde(default)]
    pub types: Vec<NamedType>,
    pub classes: Vec<Class>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedType {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    pub size: usize,
    pub align: usize,
    /// Present for structs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fields: Vec<Field>,
    /// Present for enums: the integer behind it and its named values.
    #[serde(default, rename = "enum", skip_serializing_if = "Option::is_none")]
    pub repr: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<EnumValue>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EnumValue {
    pub name: String,
    pub value: i64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Field {
    pub name: String,
    pub at: usize,
    #[serde(rename = "type")]
    pub ty: Type,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub doc: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
}

/// `"f64"`, `{"ref":"Force"}`, `{"array":T,"n":3}`, `{"list":T,"n":16}`, `{"text":64}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Type {
    Prim(String),
    Ref {
        #[serde(rename = "ref")]
        name: String,
    },
    Array {
        #[serde(rename = "array")]
        item: Box<Type>,
        n: usize,
    },
    List {
        #[serde(rename = "list")]
        item: Box<Type>,
        n: usize,
    },
    Text {
        #[serde(rename = "text")]
        n: usize,
    },
}

/// `{"plain":T}`, `{"frame":T,"format":"image","max_bytes":0}`, `"any"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PortType {
    Plain {
        plain: Type,
    },
    Frame {
        frame: Type,
        #[serde(default)]
        format: String,
        /// Bytes of the largest frame; 0 = reserved at Configure.
        #[serde(default)]
        max_bytes: usize,
    },
    /// The text "any".
    Any(String),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Class {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    /// "none", "sensor", "actuator".
    #[serde(default = "none")]
    pub safety: String,
    #[serde(default)]
    pub hardware: bool,
    /// `make_safe` touches only what is made for several threads: it may be called while another entry hangs.
    #[serde(default)]
    pub safe_from_any_thread: bool,
    /// Starts programs: created only in a process that allows that.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub starts_programs: bool,
    #[serde(default)]
    pub execution: Execution,
    /// JSON Schema of the configuration object, with the extra keywords `unit` and `live`.
    #[serde(default = "empty_schema")]
    pub config: Value,
    #[serde(default)]
    pub inputs: Vec<Input>,
    #[serde(default)]
    pub outputs: Vec<Output>,
    #[serde(default)]
    pub required: Vec<Required>,
    #[serde(default)]
    pub provided: Vec<Provided>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<Type>,
}

/// Output of `describe`: the class with the present configuration, and the types its ports name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    #[serde(default)]
    pub types: Vec<NamedType>,
    pub class: Class,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Execution {
    #[serde(default)]
    pub model: String,
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
    #[serde(default, skip_serializing_if = "is_zero")]
    pub max_period_ns: u64,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(rename = "type")]
    pub ty: PortType,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// "" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
    #[serde(default)]
    pub optional: bool,
    #[serde(default)]
    pub fifo: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(rename = "type")]
    pub ty: PortType,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    /// "", "truth" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provided {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    /// "", "truth" or "sim".
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub tag: String,
    #[serde(default)]
    pub commands: Vec<Command>,
    #[serde(default)]
    pub events: Vec<Event>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Command {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    /// "void", "write", "read", "qualified_read", "void_return", "write_return".
    pub kind: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arg: Option<Arg>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ret: Option<Type>,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub ret_unit: String,
    /// Coordinate frame of the result.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub ret_frame: String,
    /// "reject", "latest_wins", "drop_oldest".
    #[serde(default = "reject")]
    pub overflow: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arg {
    #[serde(default)]
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(rename = "type")]
    pub ty: Type,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<Type>,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Required {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(default)]
    pub optional: bool,
    #[serde(default)]
    pub functions: Vec<Function>,
    #[serde(default)]
    pub handlers: Vec<Handler>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Function {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arg: Option<Type>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ret: Option<Type>,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Coordinate frame of argument and result, of whichever has coordinates.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
    #[serde(default)]
    pub optional: bool,
    #[serde(default)]
    pub any: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Handler {
    pub name: String,
    #[serde(default)]
    pub doc: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<Type>,
    /// Coordinate frame of the payload; said of a type without coordinates it is an error.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame: String,
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
