//! Messages as rows of named values, by the descriptors that the file has for them.
//!
//! Invariant: a message that is not what its channel says is counted and left out; it never ends the reading.
//! Its cost is bounded by the values it has, not by those its type could have.

use prost_reflect::bytes::Bytes;
use prost_reflect::{DynamicMessage, FieldDescriptor, MessageDescriptor, ReflectMessage, Value};

use super::read::Channel;
use super::types::Types;

/// Values of one message at most; the others are counted.
const MOST: usize = 4096;
/// Fields of one message that are looked at, values or not.
const STEPS: u64 = 4 * MOST as u64;
/// Depth of types inside each other to which columns are made before a message has come.
const DEEP: usize = 32;
/// Longest name of a value, B.
const NAME: usize = 1024;

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cell {
    Float(f64),
    Whole(i64),
    Large(u64),
    Text(String),
    /// Value of an enum: its number and name.
    Named(i64, String),
    /// Bytes: as a text only their number.
    Bytes(Bytes),
}

/// The values of one message, named by their path, in the order of its type.
#[derive(Default)]
pub(super) struct Values {
    pub(super) row: Vec<(String, Cell)>,
    /// Number of values that there was no room for.
    pub(super) left_out: u64,
    /// Number of fields that were looked at.
    pub(super) steps: u64,
    /// The types around the field that is looked at.
    around: Vec<MessageDescriptor>,
}

impl Values {
    fn push(&mut self, name: &str, cell: Cell) {
        if self.row.len() < MOST {
            self.row.push((name.to_owned(), cell));
        } else {
            self.left_out += 1;
        }
    }

    /// Counts a step; tells whether another field may be looked at.
    fn step(&mut self) -> bool {
        self.steps += 1;
        self.steps <= STEPS
    }

    /// Tells whether a message that is not there has columns: a type within itself would have them
    /// without an end.
    fn has_columns(&self, of: &MessageDescriptor) -> bool {
        self.around.len() < DEEP && !self.around.contains(of)
    }
}

/// Reads the messages of one channel.
pub(super) struct Reader {
    message: Option<MessageDescriptor>,
    /// Reason why it can read none; empty where nothing is wrong.
    pub(super) wrong: String,
}

impl Reader {
    pub(super) fn of(channel: &Channel, types: &mut Types) -> Reader {
        let none = |wrong: String| Reader { message: None, wrong };
        if channel.encoding == "json" {
            return none(String::new());
        }
        if channel.encoding != "protobuf" || channel.schema.encoding != "protobuf" {
            let (encoding, of) = (&channel.encoding, &channel.schema.encoding);
            return none(format!("messages in {encoding:?} with types in {of:?} are not read here"));
        }
        match types.message(&channel.schema) {
            Ok(message) => Reader { message: Some(message), wrong: String::new() },
            Err(wrong) => none(wrong),
        }
    }

    pub(super) fn decode(&self, data: &[u8]) -> Option<DynamicMessage> {
        DynamicMessage::decode(self.message.clone()?, data).ok()
    }

    /// The values of a message.
    pub(super) fn values(&self, channel: &Channel, data: &[u8]) -> Option<Values> {
        let mut all = Values::default();
        if channel.encoding == "json" {
            all.push("json", Cell::Text(String::from_utf8_lossy(data).into_owned()));
        } else {
            flatten(&self.decode(data)?, "", &mut all);
        }
        Some(all)
    }
}

fn flatten(message: &DynamicMessage, path: &str, all: &mut Values) {
    all.around.push(message.descriptor());
    for field in message.descriptor().fields() {
        let there = message.has_field(&field);
        let inner = field.kind();
        let columns = match inner.as_message().filter(|_| !field.is_list()) {
            Some(of) => all.has_columns(of),
            // A member of "one of these", or one that may be missing, counts only if it is there.
            None => !field.supports_presence(),
        };
        if !there && !columns {
            continue;
        }
        let point = if path.is_empty() { "" } else { "." };
        let fits = path.len() + field.name().len() < NAME;
        if !all.step() || !fits {
            all.left_out += u64::from(there);
            continue;
        }
        value(&message.get_field(&field), &format!("{path}{point}{}", field.name()), &field, all);
    }
    all.around.pop();
}

fn value(value_of: &Value, name: &str, field: &FieldDescriptor, all: &mut Values) {
    let cell = match value_of {
        Value::Bool(yes) => Cell::Whole(i64::from(*yes)),
        Value::I32(n) => Cell::Whole((*n).into()),
        Value::I64(n) => Cell::Whole(*n),
        Value::U32(n) => Cell::Whole((*n).into()),
        Value::U64(n) => Cell::Large(*n),
        Value::F32(n) => Cell::Float((*n).into()),
        Value::F64(n) => Cell::Float(*n),
        Value::String(text) => Cell::Text(text.clone()),
        Value::Bytes(bytes) => Cell::Bytes(bytes.clone()),
        Value::EnumNumber(n) => {
            let kind = field.kind();
            let of = kind.as_enum().and_then(|e| e.get_value(*n));
            of.map_or(Cell::Whole((*n).into()), |value| Cell::Named((*n).into(), value.name().to_owned()))
        }
        Value::Message(message) if message.descriptor().full_name() == "google.protobuf.Timestamp" => {
            let part = |name: &str| {
                message
                    .get_field_by_name(name)
                    .and_then(|v| v.as_i64().or(v.as_i32().map(i64::from)))
                    .unwrap_or(0)
            };
            Cell::Whole(part("seconds").saturating_mul(1_000_000_000).saturating_add(part("nanos")))
        }
        Value::Message(message) => return flatten(message, name, all),
        Value::List(items) => {
            for (n, item) in items.iter().enumerate() {
                if all.step() {
                    value(item, &format!("{name}[{n}]"), field, all);
                } else {
                    all.left_out += 1;
                }
            }
            return;
        }
        // Their keys are no columns.
        Value::Map(entries) => {
            all.left_out += entries.len() as u64;
            return;
        }
    };
    all.push(name, cell);
}

impl Cell {
    /// Returns the text as a spreadsheet reads it.
    pub(super) fn text(&self) -> String {
        match self {
            // Far from 1, its digits are too many to be read.
            Cell::Float(n) if n.is_finite() && *n != 0.0 && !(1e-5..1e16).contains(&n.abs()) => {
                format!("{n:e}")
            }
            Cell::Float(n) => n.to_string(),
            Cell::Whole(n) => n.to_string(),
            Cell::Large(n) => n.to_string(),
            Cell::Bytes(bytes) => bytes.len().to_string(),
            Cell::Text(text) if text.contains(['"', ',', '\n', '\r']) => {
                format!("\"{}\"", text.replace('"', "\"\""))
            }
            Cell::Text(text) | Cell::Named(_, text) => text.clone(),
        }
    }
}
