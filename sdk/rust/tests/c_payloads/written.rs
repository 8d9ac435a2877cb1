//! The text of `trocar_payloads.h` from the types of a manifest.
//!
//! Invariant: a struct stands behind the types it is made of; names are Rust's, as `trocar_plugin.h` writes
//! them.

use std::fmt::Write;
use trocar_plugin_api::manifest::{Field, NamedType, Type};
use trocar_sdk::serde_json;

const HEAD: &str = r#"/* The standard payloads of trocar for C11 and C++17: structs, and their types as the manifest wants them.
 *
 * Invariant: written from the Rust types (trocar_sdk::data) by a test of trocar-sdk; never edited by hand.
 *
 * Numbers are in SI units, the unit stands beside them. A stamp of 0 says that the value is not valid. A
 * field `reserved` is zero. In a list or text, what lies behind `len` is zero.
 *
 * TROCAR_TYPE_POSE and the like are string literals of JSON for the key "types" of a manifest:
 *   TROCAR_MANIFEST(TROCAR_JSON({"trocar":1, "types":[) TROCAR_TYPE_SCALAR TROCAR_JSON(], ...}));
 * In C++ the structs are trocar::data::Scalar, trocar::data::Pose and so on, as in Rust. */
#ifndef TROCAR_PAYLOADS_H
#define TROCAR_PAYLOADS_H

#include "trocar_plugin.h"
#ifdef __cplusplus
#include "trocar_values.hpp"
#endif
"#;

/// Columns of a line at most.
const WIDTH: usize = 110;

/// Returns the same types, each behind those it is made of.
pub(crate) fn by_need(types: Vec<NamedType>) -> Vec<NamedType> {
    let mut sorted: Vec<NamedType> = Vec::new();
    let mut left = types;
    while !left.is_empty() {
        let there = |name: &str| sorted.iter().any(|t| t.name == name);
        let ready = left.iter().position(|t| t.fields.iter().filter_map(|f| named(&f.ty)).all(there));
        sorted.push(left.remove(ready.expect("a struct is made of itself")));
    }
    sorted
}

pub(crate) fn header(types: &[NamedType]) -> String {
    let mut text = HEAD.to_string();
    let mut rooms: Vec<String> = Vec::new();
    for ty in types {
        text.push('\n');
        for field in &ty.fields {
            room(&mut text, &mut rooms, &field.ty);
        }
        match &ty.repr {
            Some(repr) => values(&mut text, ty, repr),
            None => structure(&mut text, ty),
        }
        json(&mut text, ty);
    }
    text.push_str("\n#ifdef __cplusplus\nnamespace trocar {\nnamespace data {\n");
    for ty in types {
        writeln!(text, "using {} = ::{};", ty.name, c_name(&ty.name)).unwrap();
    }
    text.push_str("} // namespace data\n} // namespace trocar\n#endif\n\n#endif\n");
    text
}

/// `JOINT_STATE` of `JointState`, `A_SCAN_HEADER` of `AScanHeader`.
pub(crate) fn upper(name: &str) -> String {
    let letters: Vec<char> = name.chars().collect();
    let mut upper = String::new();
    for (i, letter) in letters.iter().enumerate() {
        let begins = i > 0
            && letter.is_uppercase()
            && (!letters[i - 1].is_uppercase() || letters.get(i + 1).is_some_and(|l| l.is_lowercase()));
        upper.extend(begins.then_some('_'));
        upper.push(letter.to_ascii_uppercase());
    }
    upper
}

pub(crate) fn c_name(name: &str) -> String {
    format!("trocar_{}", upper(name).to_lowercase())
}

/// The struct or enum a type is made of.
fn named(ty: &Type) -> Option<&str> {
    match ty {
        Type::Ref { name } => Some(name),
        Type::Array { item, .. } | Type::List { item, .. } => named(item),
        Type::Prim(_) | Type::Text { .. } => None,
    }
}

/// The type as C writes it before the field's name; arrays keep their length for behind it.
fn c_type(ty: &Type) -> String {
    match ty {
        Type::Prim(name) => match name.as_str() {
            "bool" => "uint8_t".into(),
            "stamp" => "trocar_stamp".into(),
            "f64" => "double".into(),
            "f32" => "float".into(),
            integer => {
                format!("{}int{}_t", if integer.starts_with('u') { "u" } else { "" }, &integer[1..])
            }
        },
        Type::Ref { name } => c_name(name),
        Type::Array { item, .. } => c_type(item),
        Type::List { .. } | Type::Text { .. } => format!("trocar_{}", room_name(ty)),
    }
}

/// `text_16`, `list_f64_16`, `list_text_16_32`, `list_tool_pose_8`.
fn room_name(ty: &Type) -> String {
    match ty {
        Type::Text { n } => format!("text_{n}"),
        Type::List { item, n } => format!("list_{}_{n}", room_name(item)),
        Type::Ref { name } => upper(name).to_lowercase(),
        Type::Prim(name) => name.clone(),
        Type::Array { item, n } => format!("{}_{n}", room_name(item)),
    }
}

/// A list or text gets a name before the first struct that has one.
fn room(text: &mut String, rooms: &mut Vec<String>, ty: &Type) {
    let (item, cpp, n) = match ty {
        Type::List { item, n } => {
            room(text, rooms, item);
            (c_type(item), format!("trocar::List<{}, {n}>", c_type(item)), n)
        }
        Type::Text { n } => ("char".into(), format!("trocar::Text<{n}>"), n),
        Type::Prim(_) | Type::Ref { .. } | Type::Array { .. } => return,
    };
    let name = c_type(ty);
    if rooms.contains(&name) {
        return;
    }
    writeln!(text, "#ifdef __cplusplus\ntypedef {cpp} {name};\n#else").unwrap();
    writeln!(text, "typedef struct {name} {{\n    uint64_t len;\n    {item} room[{n}];\n}} {name};\n#endif")
        .unwrap();
    rooms.push(name);
}

fn structure(text: &mut String, ty: &NamedType) {
    let name = c_name(&ty.name);
    comment(text, "", &ty.doc);
    writeln!(text, "typedef struct {name} {{").unwrap();
    for field in &ty.fields {
        comment(text, "    ", &field.doc);
        let unit = if field.unit.is_empty() { String::new() } else { format!(" /* {} */", field.unit) };
        writeln!(text, "    {} {};{unit}", c_type(&field.ty), declared(field)).unwrap();
    }
    writeln!(text, "}} {name};").unwrap();
    writeln!(text, "TROCAR_ASSERT(sizeof({name}) == {}, \"{name}\");", ty.size).unwrap();
    for Field { name: field, at, .. } in &ty.fields {
        writeln!(text, "TROCAR_ASSERT(offsetof({name}, {field}) == {at}, \"{field}\");").unwrap();
    }
}

fn declared(field: &Field) -> String {
    let (mut name, mut ty) = (field.name.clone(), &field.ty);
    while let Type::Array { item, n } = ty {
        write!(name, "[{n}]").unwrap();
        ty = item;
    }
    name
}

fn values(text: &mut String, ty: &NamedType, repr: &str) {
    let name = c_name(&ty.name);
    comment(text, "", &ty.doc);
    writeln!(text, "typedef {} {name};\nenum {{", c_type(&Type::Prim(repr.into()))).unwrap();
    let of = upper(&ty.name);
    let lines: Vec<String> =
        ty.values.iter().map(|v| format!("    TROCAR_{of}_{} = {}", v.name, v.value)).collect();
    writeln!(text, "{}\n}};", lines.join(",\n")).unwrap();
}

/// The type's manifest as a string literal, a line for each field.
fn json(text: &mut String, ty: &NamedType) {
    let others: Vec<String> = ty
        .fields
        .iter()
        .filter_map(|f| named(&f.ty))
        .map(|name| format!("TROCAR_TYPE_{}", upper(name)))
        .collect();
    if !others.is_empty() {
        comment(text, "", &format!("The manifest needs {} beside it.", listed(others)));
    }
    write!(text, "#define TROCAR_TYPE_{}", upper(&ty.name)).unwrap();
    let whole = serde_json::to_string(ty).unwrap();
    let mut rest = whole.as_str();
    while !rest.is_empty() {
        // Quotes, indent and backslash need room, too; a line ends behind a comma or space if there is one.
        let (mut used, mut end, mut good) = (0, 0, 0);
        for letter in rest.chars() {
            used += 1 + usize::from(letter == '"' || letter == '\\');
            if used > WIDTH - 8 {
                break;
            }
            end += letter.len_utf8();
            good = if letter == ',' || letter == ' ' { end } else { good };
        }
        if end < rest.len() && good > 0 {
            end = good;
        }
        let (piece, further) = rest.split_at(end);
        write!(text, " \\\n    \"{}\"", piece.replace('\\', "\\\\").replace('"', "\\\"")).unwrap();
        rest = further;
    }
    text.push('\n');
}

/// Each once: `A, B and C`.
fn listed(mut names: Vec<String>) -> String {
    let mut seen = Vec::new();
    names.retain(|name| !seen.contains(name) && (seen.push(name.clone()), true).1);
    let last = names.pop().unwrap_or_default();
    if names.is_empty() { last } else { format!("{} and {last}", names.join(", ")) }
}

/// A comment in lines of `WIDTH`; none for nothing.
fn comment(text: &mut String, indent: &str, what: &str) {
    if what.is_empty() {
        return;
    }
    let mut lines = vec![String::new()];
    for word in what.split_whitespace() {
        let line = lines.last_mut().unwrap();
        // The three at the beginning and at the end are those of the comment.
        if !line.is_empty() && indent.len() + line.chars().count() + word.chars().count() + 7 > WIDTH {
            lines.push(word.to_string());
        } else {
            line.push_str(if line.is_empty() { "" } else { " " });
            line.push_str(word);
        }
    }
    writeln!(text, "{indent}/* {} */", lines.join(&format!("\n{indent} * "))).unwrap();
}
