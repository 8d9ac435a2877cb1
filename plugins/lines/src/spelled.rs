//! Samples of any type as lines: columns of numbers, or an object of JSON.
//!
//! Invariant: a number has all the digits that tell it from its neighbours; a line has no end inside.

use trocar_sdk::serde_json::Value as Json;
use trocar_sdk::{AnyPart, AnyShape, AnyType};

use crate::plan::Format;

/// Most columns of one input.
const COLUMNS: usize = 4096;

/// The way in which samples of all inputs are written.
#[derive(Default)]
pub(crate) struct Spelled {
    inputs: Vec<Input>,
}

struct Input {
    name: String,
    ty: AnyType,
    columns: Vec<Column>,
}

/// One number of a sample.
struct Column {
    path: String,
    unit: String,
    at: usize,
    leaf: Leaf,
    /// An item of a list: the place of the list's length, and its number.
    item: Option<(usize, u64)>,
}

enum Leaf {
    Number(&'static str),
    Enum { number: &'static str, values: Vec<(String, i64)> },
    Text(usize),
}

impl Spelled {
    /// `first`: a sample of each input, which says how many columns a list gets.
    pub(crate) fn of<'a>(inputs: impl IntoIterator<Item = (&'a str, &'a AnyType, &'a [u8])>) -> Spelled {
        let inputs = inputs.into_iter().map(|(name, ty, first)| {
            let mut columns = Vec::new();
            walk(ty.part(), (String::new(), String::new(), 0), None, first, &mut columns);
            Input { name: name.to_owned(), ty: ty.clone(), columns }
        });
        Spelled { inputs: inputs.collect() }
    }

    /// A comment that names the columns.
    pub(crate) fn header(&self, to: &mut String) {
        to.push_str("# t s");
        for input in &self.inputs {
            for column in &input.columns {
                to.push_str(", ");
                to.push_str(&input.name);
                for word in [&column.path, &column.unit] {
                    if !word.is_empty() {
                        to.push(if std::ptr::eq(word, &column.path) { '.' } else { ' ' });
                        to.push_str(word);
                    }
                }
            }
        }
        to.push('\n');
    }

    /// One line, with its end; `values` has the bytes of each input.
    pub(crate) fn line(&self, format: Format, stamp_ns: u64, values: &[&[u8]], to: &mut String) {
        use std::fmt::Write;
        let (s, ns) = (stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000);
        let _ = match format {
            Format::Numbers => write!(to, "{s}.{ns:09}"),
            Format::Json => write!(to, "{{\"t\":{s}.{ns:09}"),
        };
        for (input, value) in self.inputs.iter().zip(values) {
            match format {
                Format::Numbers => {
                    for column in &input.columns {
                        to.push(',');
                        column.write(value, to);
                    }
                }
                Format::Json => {
                    let value = input.ty.to_json(value).unwrap_or_default();
                    let _ = write!(to, ",{}:{value}", Json::from(input.name.as_str()));
                }
            }
        }
        to.push_str(if format == Format::Json { "}\n" } else { "\n" });
    }
}

/// The columns of a part, `(path, unit, at)`. Stamps are left out, since a line has one, and what is
/// reserved.
fn walk(
    part: AnyPart<'_>,
    (path, unit, at): (String, String, usize),
    item: Option<(usize, u64)>,
    first: &[u8],
    to: &mut Vec<Column>,
) {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    let mut put = |leaf| {
        if to.len() < COLUMNS {
            to.push(Column { path: path.clone(), unit: unit.clone(), at, leaf, item });
        }
    };
    match part.shape() {
        AnyShape::Number("stamp") => {}
        AnyShape::Number(number) => put(Leaf::Number(number)),
        AnyShape::Enum { number, values } => put(Leaf::Enum { number, values: values.to_vec() }),
        AnyShape::Text { n } => put(Leaf::Text(n)),
        AnyShape::Array { item: inner, n } => {
            for i in 0..n.min(COLUMNS) {
                walk(inner, (below(&i.to_string()), unit.clone(), at + i * inner.size()), item, first, to);
            }
        }
        AnyShape::List { item: inner, n } => {
            let there = usize::try_from(word(first, at)).unwrap_or(n).min(n);
            for i in 0..there {
                let place = (below(&i.to_string()), unit.clone(), at + 8 + i * inner.size());
                walk(inner, place, Some((at, i as u64)), first, to);
            }
        }
        AnyShape::Struct { fields, .. } => {
            for field in fields.iter().filter(|field| !field.name.starts_with("reserved")) {
                let unit = if field.unit.is_empty() { unit.clone() } else { field.unit.to_owned() };
                walk(field.part, (below(field.name), unit, at + field.at), item, first, to);
            }
        }
    }
}

/// Eight bytes as a number; 0 where there are fewer.
fn word(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..at + 8).and_then(|b| b.first_chunk()).map_or(0, |b| u64::from_le_bytes(*b))
}

impl Column {
    fn write(&self, value: &[u8], to: &mut String) {
        if self.item.is_some_and(|(len, item)| word(value, len) <= item) {
            return to.push_str("nan");
        }
        match &self.leaf {
            Leaf::Number(number) => number_of(number, value, self.at, to),
            Leaf::Enum { number, values } => {
                let mut digits = String::new();
                number_of(number, value, self.at, &mut digits);
                let known = values.iter().find(|(_, n)| n.to_string() == digits);
                to.push_str(known.map_or(&digits, |(name, _)| name));
            }
            Leaf::Text(n) => {
                let len = usize::try_from(word(value, self.at)).unwrap_or(*n).min(*n);
                let bytes = value.get(self.at + 8..self.at + 8 + len).unwrap_or_default();
                let text = String::from_utf8_lossy(bytes);
                let apart = |c: char| c.is_whitespace() || c.is_control() || matches!(c, ',' | ';' | '#');
                to.extend(text.chars().map(|c| if apart(c) { '_' } else { c }));
                if text.is_empty() {
                    to.push('_');
                }
            }
        }
    }
}

fn number_of(number: &str, value: &[u8], at: usize, to: &mut String) {
    use std::fmt::Write;
    macro_rules! as_text {
        ($ty:ty) => {{
            const N: usize = size_of::<$ty>();
            let bytes = value.get(at..at + N).and_then(|b| b.first_chunk::<N>());
            // The shortest digits that read as the same number.
            write!(to, "{:?}", bytes.map_or(Default::default(), |b| <$ty>::from_le_bytes(*b)))
        }};
    }
    let _ = match number {
        "bool" => write!(to, "{}", u8::from(value.get(at).is_some_and(|b| *b != 0))),
        "u8" => as_text!(u8),
        "i8" => as_text!(i8),
        "u16" => as_text!(u16),
        "i16" => as_text!(i16),
        "u32" => as_text!(u32),
        "i32" => as_text!(i32),
        "u64" => as_text!(u64),
        "i64" => as_text!(i64),
        "f32" => as_text!(f32),
        _ => as_text!(f64),
    };
}

#[cfg(test)]
#[path = "spelled_tests.rs"]
mod tests;
