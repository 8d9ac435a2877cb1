//! Turns the bytes of the note into a manifest every later reader may rely on.
//!
//! Invariant: after `read`, names are plain and unique, every type reference resolves without a cycle, every
//! field lies inside its struct, and a host lists every class. The ABI version is looked at before anything
//! else, so a newer manifest is never "not understood".

use std::collections::{BTreeSet, HashMap};

use serde::Deserialize;
use serde_json::Value;
use trocar_plugin_api::manifest::{Class, Command, Manifest, PortType, Type};
use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR};

use super::{Fault, keys};
use crate::convert;

/// Longest plugin or class name, bytes.
const MAX_NAME: usize = 64;
/// Deepest nesting of payload types.
const MAX_DEPTH: usize = 32;
/// Largest plain payload, bytes.
const MAX_PAYLOAD: usize = 1 << 30;

/// Reads, checks the ABI major, then the content.
pub(crate) fn read(note: &[u8]) -> Result<Manifest, Fault> {
    read_warned(note).map(|(manifest, _)| manifest)
}

/// As [`read`], with warnings of what is strange and yet taken: keys that only a newer minor can know.
pub(crate) fn read_warned(note: &[u8]) -> Result<(Manifest, Vec<String>), Fault> {
    #[derive(Deserialize)]
    struct Version {
        abi: [u32; 2],
    }
    let padding = |b: &u8| *b == 0 || b.is_ascii_whitespace();
    let end = note.iter().rposition(|b| !padding(b)).map_or(0, |last| last + 1);
    let text = &note[..end];
    if let Ok(Version { abi }) = serde_json::from_slice::<Version>(text)
        && abi[0] != ABI_MAJOR
    {
        return Err(Fault::Abi { plugin: abi });
    }
    let manifest = Manifest::parse(note).map_err(bad)?;
    if manifest.abi[0] != ABI_MAJOR {
        return Err(Fault::Abi { plugin: manifest.abi });
    }
    check(&manifest).map_err(bad)?;
    let mut unknown = keys::unknown(&serde_json::from_slice(text).unwrap_or_default());
    if manifest.abi[1] <= ABI_MINOR && !unknown.is_empty() {
        return Err(bad(unknown.swap_remove(0)));
    }
    unknown.iter_mut().for_each(|key| key.push_str(": this host does without it"));
    Ok((manifest, unknown))
}

fn bad(because: String) -> Fault {
    Fault::BadManifest { because }
}

fn check(manifest: &Manifest) -> Result<(), String> {
    check_name("plugin", &manifest.name)?;
    if manifest.classes.is_empty() {
        return Err("it offers no class".into());
    }
    unique("class", manifest.classes.iter().map(|c| c.name.as_str()))?;
    unique("type", manifest.types.iter().map(|t| t.name.as_str()))?;
    let mut types = Types { manifest, done: HashMap::new() };
    for ty in &manifest.types {
        types.named(&ty.name, 0)?;
    }
    for class in &manifest.classes {
        check_name("class", &class.name)?;
        check_class(class, &mut types).map_err(|e| format!("class `{}`: {e}", class.name))?;
    }
    // The host does the same when it lists the classes: a tool that checks the file gets the host's own
    // verdict.
    convert::classes(manifest, "").map(drop)
}

fn check_name(what: &str, name: &str) -> Result<(), String> {
    let plain = name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
    if name.is_empty() || name.len() > MAX_NAME || !plain {
        return Err(format!(
            "the {what} name `{}` is not 1 to {MAX_NAME} letters, digits, `_` or `-`",
            name.escape_default().take(100).collect::<String>()
        ));
    }
    Ok(())
}

fn unique<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(format!("the {what} `{name}` is there twice"));
        }
    }
    Ok(())
}

fn check_class<'a>(class: &'a Class, types: &mut Types<'a>) -> Result<(), String> {
    if !class.config.is_object() {
        return Err("its config schema is not a JSON object".into());
    }
    if class.config.get("type").and_then(Value::as_str) != Some("object") {
        let said = class.config.get("type").map_or("none".to_owned(), Value::to_string);
        return Err(format!("its config schema has the type {said}: a configuration is an \"object\""));
    }
    if let Some(wrong) = trocar_model::schema_fault(&class.config) {
        return Err(format!("its config schema is not a JSON Schema: {wrong}"));
    }
    if let Some(wrong) = trocar_model::idle_limit(&class.config) {
        return Err(format!("its config schema: {wrong}"));
    }
    if !matches!(class.safety.as_str(), "none" | "sensor" | "actuator") {
        return Err(format!("`{}` is no safety: say none, sensor or actuator", class.safety));
    }
    let ports = class.inputs.iter().map(|i| &i.name).chain(class.outputs.iter().map(|o| &o.name));
    let interfaces = class.required.iter().map(|r| &r.name).chain(class.provided.iter().map(|p| &p.name));
    unique("port or interface", ports.chain(interfaces).map(String::as_str))?;
    for ty in class.inputs.iter().map(|i| &i.ty).chain(class.outputs.iter().map(|o| &o.ty)) {
        match ty {
            PortType::Plain { plain: ty } | PortType::Frame { frame: ty, .. } => types.check(ty)?,
            PortType::Any(any) if any == "any" => {}
            PortType::Any(other) => return Err(format!("`{other}` is no port type")),
        }
    }
    for interface in &class.required {
        unique("function", interface.functions.iter().map(|f| f.name.as_str()))?;
        unique("event handler", interface.handlers.iter().map(|h| h.name.as_str()))?;
        for f in &interface.functions {
            f.arg.iter().chain(&f.ret).try_for_each(|ty| types.check(ty))?;
        }
        interface.handlers.iter().flat_map(|h| &h.payload).try_for_each(|ty| types.check(ty))?;
    }
    for interface in &class.provided {
        unique("command", interface.commands.iter().map(|c| c.name.as_str()))?;
        unique("event", interface.events.iter().map(|e| e.name.as_str()))?;
        for command in &interface.commands {
            check_command(command, types).map_err(|e| format!("command `{}`: {e}", command.name))?;
        }
        interface.events.iter().flat_map(|e| &e.payload).try_for_each(|ty| types.check(ty))?;
    }
    class.state.iter().try_for_each(|ty| types.check(ty))
}

fn check_command<'a>(command: &'a Command, types: &mut Types<'a>) -> Result<(), String> {
    let (arg, ret) = match command.kind.as_str() {
        "void" => (false, false),
        "write" => (true, false),
        "read" | "void_return" => (false, true),
        "qualified_read" | "write_return" => (true, true),
        other => {
            return Err(format!(
                "`{other}` is no command kind; there are void, write, read, qualified_read, void_return, write_return"
            ));
        }
    };
    if command.arg.is_some() != arg || command.ret.is_some() != ret {
        return Err(format!("its argument and result do not fit the kind `{}`", command.kind));
    }
    command.arg.iter().map(|a| &a.ty).chain(&command.ret).try_for_each(|ty| types.check(ty))
}

/// Sizes of the types seen so far.
struct Types<'a> {
    manifest: &'a Manifest,
    done: HashMap<&'a str, usize>,
}

impl<'a> Types<'a> {
    fn check(&mut self, ty: &'a Type) -> Result<(), String> {
        self.size(ty, 0).map(drop)
    }

    /// Size in bytes; `depth` bounds both nesting and cycles.
    fn size(&mut self, ty: &'a Type, depth: usize) -> Result<usize, String> {
        if depth > MAX_DEPTH {
            return Err("a type contains itself, or types are nested too deeply".into());
        }
        let size = match ty {
            Type::Prim(name) => prim_size(name).ok_or_else(|| format!("`{name}` is no primitive type"))?,
            Type::Ref { name } => self.named(name, depth + 1)?,
            Type::Array { item, n } => self.size(item, depth + 1)?.saturating_mul(*n),
            Type::List { item, n } => self.size(item, depth + 1)?.saturating_mul(*n).saturating_add(8),
            Type::Text { n } => n.saturating_add(8),
        };
        if size > MAX_PAYLOAD {
            return Err(format!("a type is larger than {} MiB", MAX_PAYLOAD >> 20));
        }
        Ok(size)
    }

    fn named(&mut self, name: &str, depth: usize) -> Result<usize, String> {
        if let Some(size) = self.done.get(name) {
            return Ok(*size);
        }
        let manifest = self.manifest;
        let ty = manifest.named(name).ok_or_else(|| format!("the type `{name}` is not described"))?;
        if !ty.align.is_power_of_two() || ty.align > 4096 || ty.size > MAX_PAYLOAD {
            return Err(format!("the size or alignment of type `{name}` makes no sense"));
        }
        if let Some(repr) = &ty.repr
            && prim_size(repr) != Some(ty.size)
        {
            return Err(format!("the enum `{name}` does not have the size of `{repr}`"));
        }
        unique("field", ty.fields.iter().map(|f| f.name.as_str()))
            .map_err(|e| format!("type `{name}`: {e}"))?;
        for field in &ty.fields {
            let size = self.size(&field.ty, depth + 1)?;
            if field.at.checked_add(size).is_none_or(|end| end > ty.size) {
                return Err(format!("the field `{}` leaves its type `{name}`", field.name));
            }
        }
        self.done.insert(&ty.name, ty.size);
        Ok(ty.size)
    }
}

fn prim_size(name: &str) -> Option<usize> {
    Some(match name {
        "bool" | "u8" | "i8" => 1,
        "u16" | "i16" => 2,
        "u32" | "i32" | "f32" => 4,
        "u64" | "i64" | "f64" | "stamp" => 8,
        _ => return None,
    })
}

#[cfg(test)]
#[path = "manifest_tests.rs"]
mod tests;
