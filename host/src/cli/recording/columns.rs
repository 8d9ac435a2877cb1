//! Messages as rows of named values, by the descriptors that the file has for them.
//!
//! Invariant: a message that is not what its channel says is counted and left out; it never ends the reading.

use std::panic::{self, UnwindSafe};
use std::sync::Once;

use prost_reflect::bytes::Bytes;
use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, MessageDescriptor, ReflectMessage, Value,
};

use super::read::Channel;

/// Values of one message at most; the others are counted.
const MOST: usize = 4096;

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::cli) enum Cell {
    Float(f64),
    Whole(i64),
    Large(u64),
    Text(String),
    /// Of an enum: its number and name.
    Named(i64, String),
    /// Bytes: as a text only their number.
    Bytes(Bytes),
}

/// The values of one message, named by their path, in the order of its type.
#[derive(Default)]
pub(super) struct Values {
    pub(super) row: Vec<(String, Cell)>,
    /// How many there was no room for.
    pub(super) left_out: u64,
}

impl Values {
    fn push(&mut self, name: &str, cell: Cell) {
        if self.row.len() < MOST {
            self.row.push((name.to_owned(), cell));
        } else {
            self.left_out += 1;
        }
    }
}

/// Reads the messages of one channel.
pub(super) struct Reader {
    message: Option<MessageDescriptor>,
}

impl Reader {
    pub(super) fn of(channel: &Channel) -> Reader {
        let proto = channel.encoding == "protobuf" && channel.schema_encoding == "protobuf";
        // Of some damaged descriptions the library panics while it words its error: they describe nothing either.
        let pool =
            || unless_it_panics(|| DescriptorPool::decode(channel.schema_data.as_slice()).ok()).flatten();
        Reader {
            message: if proto { pool().and_then(|p| p.get_message_by_name(&channel.schema)) } else { None },
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

/// Gives what `f` gives, or nothing where it panics, of which nothing is printed.
fn unless_it_panics<T>(f: impl FnOnce() -> T + UnwindSafe) -> Option<T> {
    thread_local! {
        static QUIET: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
    }
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let told = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !QUIET.get() {
                told(info);
            }
        }));
    });
    QUIET.set(true);
    let given = panic::catch_unwind(f);
    QUIET.set(false);
    given.ok()
}

fn flatten(message: &DynamicMessage, path: &str, all: &mut Values) {
    for field in message.descriptor().fields() {
        // Of "one of these" and of what may be missing only what is there.
        if field.supports_presence() && !message.has_field(&field) && field.kind().as_message().is_none() {
            continue;
        }
        let name = if path.is_empty() { field.name().to_owned() } else { format!("{path}.{}", field.name()) };
        value(&message.get_field(&field), &name, &field, all);
    }
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
                value(item, &format!("{name}[{n}]"), field, all);
            }
            return;
        }
        Value::Map(_) => return,
    };
    all.push(name, cell);
}

impl Cell {
    /// As a spreadsheet reads it.
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
