//! Latest events on the bench, printed when an expectation fails.
//!
//! Invariant: values are kept as bytes and spelt only when a test fails; a bounded number is kept.

use super::shape::{Of, Shape, header};
use std::collections::VecDeque;
use std::fmt::Write;
use trocar_plugin_api::contracts::size_of_type;
use trocar_plugin_api::manifest::{NamedType, Type};

/// Entries that are kept.
const KEPT: usize = 64;
/// Entries that a failing expectation prints.
const SHOWN: usize = 24;

#[derive(Clone, Copy)]
pub(crate) enum Kind {
    Input,
    Output,
    Event,
    Call,
}

enum What {
    Text(String),
    Value { kind: Kind, at: usize, bytes: Vec<u8> },
}

#[derive(Default)]
pub(crate) struct History {
    entries: VecDeque<(u64, What)>,
}

impl History {
    fn add(&mut self, now_ns: u64, what: What) {
        if self.entries.len() == KEPT {
            self.entries.pop_front();
        }
        self.entries.push_back((now_ns, what));
    }

    pub(crate) fn note(&mut self, now_ns: u64, text: String) {
        self.add(now_ns, What::Text(text));
    }

    pub(crate) fn value(&mut self, now_ns: u64, kind: Kind, at: usize, bytes: &[u8]) {
        self.add(now_ns, What::Value { kind, at, bytes: bytes.to_vec() });
    }

    /// The latest entries, one per line, the last one last.
    pub(crate) fn text(&self, shape: &Shape) -> String {
        let mut out = String::from("\nwhat happened last:");
        for (now_ns, what) in self.entries.iter().skip(self.entries.len().saturating_sub(SHOWN)) {
            let line = match what {
                What::Text(text) => text.clone(),
                What::Value { kind, at, bytes } => spell(shape, *kind, *at, bytes),
            };
            // Writing to a String cannot fail.
            let _ = write!(out, "\n  {:.6} s  {line}", *now_ns as f64 * 1e-9);
        }
        out
    }
}

fn spell(shape: &Shape, kind: Kind, at: usize, bytes: &[u8]) -> String {
    let member = |of| shape.members(of).get(at).map(|m| (m.path.clone(), m.arg.clone()));
    let (what, port) = match kind {
        Kind::Input => {
            ("into", shape.class().inputs.get(at).map(|i| (i.name.clone(), header(&i.ty).cloned())))
        }
        Kind::Output => {
            ("out of", shape.class().outputs.get(at).map(|o| (o.name.clone(), header(&o.ty).cloned())))
        }
        Kind::Event => ("event", member(Of::Events)),
        Kind::Call => ("call of", member(Of::Functions)),
    };
    let Some((name, ty)) = port else { return format!("{what} a port that is gone") };
    let value = ty.map_or(String::new(), |ty| value(shape.types(), &ty, bytes));
    format!("{what} {name} {value}")
}

/// A value as text: `{position: [0, 0, 0.1], valid: true}`.
pub(crate) fn value(types: &[NamedType], ty: &Type, bytes: &[u8]) -> String {
    let items = |item: &Type, bytes: &[u8], n: usize| {
        let size = size_of_type(types, item).unwrap_or(0).max(1);
        let items: Vec<String> = bytes.chunks_exact(size).take(n).map(|b| value(types, item, b)).collect();
        format!("[{}]", items.join(", "))
    };
    match ty {
        Type::Prim(name) => prim(name, bytes),
        Type::Array { item, n } => items(item, bytes, *n),
        Type::List { item, n } => match bytes.split_first_chunk::<8>() {
            Some((len, rest)) => items(item, rest, (u64::from_le_bytes(*len) as usize).min(*n)),
            None => "?".to_string(),
        },
        Type::Text { n } => match bytes.split_first_chunk::<8>() {
            Some((len, rest)) => {
                let len = (u64::from_le_bytes(*len) as usize).min(*n).min(rest.len());
                format!("{:?}", String::from_utf8_lossy(&rest[..len]))
            }
            None => "?".to_string(),
        },
        Type::Ref { name } => {
            let Some(named) = types.iter().find(|t| t.name == *name) else { return "?".to_string() };
            if let Some(repr) = &named.repr {
                let number = prim(repr, bytes);
                let value = named.values.iter().find(|v| v.value.to_string() == number);
                return value.map_or(number, |v| v.name.clone());
            }
            let fields = named.fields.iter().map(|f| {
                let rest = bytes.get(f.at..).unwrap_or_default();
                format!("{}: {}", f.name, value(types, &f.ty, rest))
            });
            format!("{{{}}}", fields.collect::<Vec<_>>().join(", "))
        }
    }
}

fn prim(name: &str, bytes: &[u8]) -> String {
    macro_rules! number {
        ($ty:ty) => {
            bytes.first_chunk().map(|b| <$ty>::from_ne_bytes(*b).to_string())
        };
    }
    let text = match name {
        "bool" => bytes.first().map(|b| (*b != 0).to_string()),
        "u8" => number!(u8),
        "i8" => number!(i8),
        "u16" => number!(u16),
        "i16" => number!(i16),
        "u32" => number!(u32),
        "i32" => number!(i32),
        "f32" => number!(f32),
        "f64" => number!(f64),
        "i64" => number!(i64),
        _ => number!(u64),
    };
    text.unwrap_or_else(|| "?".to_string())
}
