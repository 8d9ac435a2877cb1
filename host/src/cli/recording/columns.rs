//! Messages as rows of named values, by the descriptors that the file has for them.
//!
//! Invariant: a message that is not what its channel says is counted and left out; it never ends the reading.

use prost_reflect::{
    DescriptorPool, DynamicMessage, FieldDescriptor, MessageDescriptor, ReflectMessage, Value,
};

use super::read::Channel;

/// Values of one message at most; a row of more is no row.
const MOST: usize = 4096;

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::cli) enum Cell {
    Float(f64),
    Whole(i64),
    Large(u64),
    Text(String),
    /// Bytes: only their number is shown.
    Bytes(usize),
}

/// Reads the messages of one channel.
pub(super) struct Reader {
    message: Option<MessageDescriptor>,
}

impl Reader {
    pub(super) fn of(channel: &Channel) -> Reader {
        let proto = channel.encoding == "protobuf" && channel.schema_encoding == "protobuf";
        // Of some damaged descriptions the library panics while it words its error: they describe nothing either.
        let pool = || {
            let decode = || DescriptorPool::decode(channel.schema_data.as_slice()).ok();
            std::panic::catch_unwind(decode).ok().flatten()
        };
        Reader {
            message: if proto { pool().and_then(|p| p.get_message_by_name(&channel.schema)) } else { None },
        }
    }

    pub(super) fn decode(&self, data: &[u8]) -> Option<DynamicMessage> {
        DynamicMessage::decode(self.message.clone()?, data).ok()
    }

    /// The values of a message, named by their path.
    pub(super) fn row(&self, channel: &Channel, data: &[u8]) -> Option<Vec<(String, Cell)>> {
        if channel.encoding == "json" {
            return Some(vec![("json".to_owned(), Cell::Text(String::from_utf8_lossy(data).into_owned()))]);
        }
        let message = self.decode(data)?;
        let mut row = Vec::new();
        flatten(&message, "", &mut row);
        Some(row)
    }
}

fn flatten(message: &DynamicMessage, path: &str, row: &mut Vec<(String, Cell)>) {
    for field in message.descriptor().fields() {
        // Of "one of these" and of what may be missing only what is there.
        if field.supports_presence() && !message.has_field(&field) && field.kind().as_message().is_none() {
            continue;
        }
        let name = if path.is_empty() { field.name().to_owned() } else { format!("{path}.{}", field.name()) };
        value(&message.get_field(&field), &name, &field, row);
    }
}

fn value(value_of: &Value, name: &str, field: &FieldDescriptor, row: &mut Vec<(String, Cell)>) {
    if row.len() >= MOST {
        return;
    }
    let cell = match value_of {
        Value::Bool(yes) => Cell::Whole(i64::from(*yes)),
        Value::I32(n) => Cell::Whole((*n).into()),
        Value::I64(n) => Cell::Whole(*n),
        Value::U32(n) => Cell::Whole((*n).into()),
        Value::U64(n) => Cell::Large(*n),
        Value::F32(n) => Cell::Float((*n).into()),
        Value::F64(n) => Cell::Float(*n),
        Value::String(text) => Cell::Text(text.clone()),
        Value::Bytes(bytes) => Cell::Bytes(bytes.len()),
        Value::EnumNumber(n) => {
            let kind = field.kind();
            let of = kind.as_enum().and_then(|e| e.get_value(*n));
            of.map_or(Cell::Whole((*n).into()), |value| Cell::Text(value.name().to_owned()))
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
        Value::Message(message) => return flatten(message, name, row),
        Value::List(items) => {
            for (n, item) in items.iter().enumerate() {
                value(item, &format!("{name}[{n}]"), field, row);
            }
            return;
        }
        Value::Map(_) => return,
    };
    row.push((name.to_owned(), cell));
}

impl Cell {
    /// As a spreadsheet reads it.
    pub(super) fn text(&self) -> String {
        match self {
            Cell::Float(n) => n.to_string(),
            Cell::Whole(n) => n.to_string(),
            Cell::Large(n) => n.to_string(),
            Cell::Bytes(n) => n.to_string(),
            Cell::Text(text) if text.contains(['"', ',', '\n', '\r']) => {
                format!("\"{}\"", text.replace('"', "\"\""))
            }
            Cell::Text(text) => text.clone(),
        }
    }
}
