//! The canonical field list of a type: one line per leaf, `pose.position: [f64;3] m`.
//!
//! Invariant: two types have the same list exactly when a value of one may be read as the other. Manifests
//! come from files: a type that is missing, or contains itself, ends in an error, never in an endless walk.

use super::payloads::{Payload, payload};
use crate::manifest::{NamedType, Type};

/// Deepest nesting of a payload.
const MAX_DEPTH: usize = 16;
/// Most types that are looked at for one list, so that empty types within empty types end, too.
const MAX_VISITS: usize = 4096;

/// The field list of a manifest's type.
///
/// # Errors
/// A sentence: the type names a type that is not in `types`, or is nested too deeply.
pub fn leaves_of(types: &[NamedType], ty: &Type, unit: &str) -> Result<Vec<String>, String> {
    let mut walk = Walk { types, visits: 0, out: Vec::new() };
    walk.visit(ty, "", &tail(unit, ""), 0)?;
    Ok(walk.out)
}

/// The field list of a type of the contracts, see [`super::Carries`].
///
/// # Panics
/// Never for the tables here: a test walks them all.
pub fn leaves_of_payload(ty: &str, unit: &str) -> Vec<String> {
    let mut out = Vec::new();
    walk_text(ty, "", &tail(unit, ""), &mut out);
    out
}

/// Bytes of one value of a manifest's type.
///
/// # Errors
/// As [`leaves_of`].
pub fn size_of_type(types: &[NamedType], ty: &Type) -> Result<usize, String> {
    size(types, ty, 0)
}

fn tail(unit: &str, frame: &str) -> String {
    let mut tail = String::new();
    if !unit.is_empty() {
        tail = format!(" {unit}");
    }
    if !frame.is_empty() {
        tail += &format!(" in {frame}");
    }
    tail
}

struct Walk<'a> {
    types: &'a [NamedType],
    visits: usize,
    out: Vec<String>,
}

impl Walk<'_> {
    fn visit(&mut self, ty: &Type, path: &str, tail: &str, depth: usize) -> Result<(), String> {
        self.visits += 1;
        if depth > MAX_DEPTH || self.visits > MAX_VISITS {
            return Err(format!("`{path}` is nested too deeply or too wide for a payload"));
        }
        let types = self.types;
        match ty {
            Type::Prim(name) => self.out.push(format!("{path}: {name}{tail}")),
            Type::Text { n } => self.out.push(format!("{path}: text[{n}]{tail}")),
            Type::Array { item, n } | Type::List { item, n } => {
                let list = if matches!(ty, Type::List { .. }) { "list" } else { "" };
                match leaf(types, item)? {
                    Some(item) => self.out.push(format!("{path}: {list}[{item};{n}]{tail}")),
                    None => self.visit(item, &format!("{path}({list}[{n}])"), tail, depth + 1)?,
                }
            }
            Type::Ref { name } => {
                let found = find(types, name)?;
                if found.repr.is_some() {
                    self.out.push(format!("{path}: {}{tail}", enum_text(found)));
                } else {
                    self.fields(found, path, depth)?;
                }
            }
        }
        Ok(())
    }

    fn fields(&mut self, ty: &NamedType, path: &str, depth: usize) -> Result<(), String> {
        let mut end = 0;
        for field in &ty.fields {
            let name = if path.is_empty() { field.name.clone() } else { format!("{path}.{}", field.name) };
            // Offsets follow from the order; only a gap before a field is worth a word.
            let gap = if field.at == end { String::new() } else { format!(" @{}", field.at) };
            let tail = tail(&field.unit, &field.frame) + &gap;
            self.visit(&field.ty, &name, &tail, depth + 1)?;
            end = field.at.saturating_add(size(self.types, &field.ty, depth + 1)?);
        }
        Ok(())
    }
}

/// A type that ends a line, as text; none for structs and lists of lists.
fn leaf(types: &[NamedType], ty: &Type) -> Result<Option<String>, String> {
    Ok(match ty {
        Type::Prim(name) => Some(name.clone()),
        Type::Text { n } => Some(format!("text[{n}]")),
        Type::Ref { name } => {
            let found = find(types, name)?;
            found.repr.is_some().then(|| enum_text(found))
        }
        Type::Array { .. } | Type::List { .. } => None,
    })
}

fn find<'a>(types: &'a [NamedType], name: &str) -> Result<&'a NamedType, String> {
    types
        .iter()
        .find(|t| t.name == name)
        .ok_or_else(|| format!("the manifest names the type `{name}` and lacks it"))
}

fn enum_text(ty: &NamedType) -> String {
    let values: Vec<String> = ty.values.iter().map(|v| format!("{}={}", v.name, v.value)).collect();
    format!("{}({})", ty.repr.as_deref().unwrap_or_default(), values.join(","))
}

fn size(types: &[NamedType], ty: &Type, depth: usize) -> Result<usize, String> {
    if depth > MAX_DEPTH {
        return Err("a payload is nested too deeply".to_string());
    }
    Ok(match ty {
        Type::Prim(name) => match name.as_str() {
            "bool" | "u8" | "i8" => 1,
            "u16" | "i16" => 2,
            "u32" | "i32" | "f32" => 4,
            _ => 8,
        },
        Type::Text { n } => n.saturating_add(8),
        Type::Array { item, n } => size(types, item, depth + 1)?.saturating_mul(*n),
        Type::List { item, n } => size(types, item, depth + 1)?.saturating_mul(*n).saturating_add(8),
        Type::Ref { name } => find(types, name)?.size,
    })
}

fn walk_text(ty: &str, path: &str, tail: &str, out: &mut Vec<String>) {
    for (list, prefix) in [("list", "list["), ("", "[")] {
        let Some((item, n)) = ty.strip_prefix(prefix).and_then(|t| t.strip_suffix(']')?.rsplit_once(';'))
        else {
            continue;
        };
        match payload(item) {
            Some(p) if p.repr.is_empty() => walk_text(item, &format!("{path}({list}[{n}])"), tail, out),
            Some(p) => out.push(format!("{path}: {list}[{};{n}]{tail}", p.enum_text())),
            None => out.push(format!("{path}: {list}[{item};{n}]{tail}")),
        }
        return;
    }
    match payload(ty) {
        None => out.push(format!("{path}: {ty}{tail}")),
        Some(p) if !p.repr.is_empty() => out.push(format!("{path}: {}{tail}", p.enum_text())),
        Some(p) => {
            for field in p.fields {
                let name =
                    if path.is_empty() { field.name.to_string() } else { format!("{path}.{}", field.name) };
                walk_text(field.ty, &name, &self::tail(field.unit, ""), out);
            }
        }
    }
}

impl Payload {
    fn enum_text(&self) -> String {
        let values: Vec<String> = self.values.iter().map(|(name, value)| format!("{name}={value}")).collect();
        format!("{}({})", self.repr, values.join(","))
    }
}
