//! Finds the place of a number in the description of a type, for a step: makes nothing of the description.
//!
//! Invariant: allocates nothing and answers as [`AnyType::place`](super::AnyType::place) does for every
//! description that [`AnyType::of_port`](super::AnyType::of_port) takes; for any other text it answers
//! `None`.

use super::{MAX_DEPTH, Place, prim};
use trocar_plugin_api::desc::Prim;

/// The number at `path` of a port's type.
pub(crate) fn place(text: &str, path: &str) -> Option<Place> {
    let types = member(text, "types").unwrap_or("[]");
    let mut ty = member(text, "frame").or_else(|| member(text, "plain"))?;
    let mut at = 0usize;
    for step in path.split('/').filter(|step| !step.is_empty()) {
        let (further, inside) = go(ty, types, step)?;
        at = at.checked_add(further)?;
        ty = inside;
    }
    Some(Place { at, prim: number(ty, types)? })
}

/// One step of a path: the distance, and the type there.
fn go<'a>(ty: &'a str, types: &'a str, step: &str) -> Option<(usize, &'a str)> {
    if let Some(item) = member(ty, "array") {
        let i = step.parse::<usize>().ok().filter(|i| Some(*i) < count(ty, "n"))?;
        return Some((i.checked_mul(size(item, types, 0)?)?, item));
    }
    let fields = member(named(ty, types)?, "fields")?;
    let field = items(fields).find(|field| member(field, "name").and_then(string) == Some(step))?;
    Some((count(field, "at")?, member(field, "type")?))
}

/// The type of a number or of named values.
fn number(ty: &str, types: &str) -> Option<Prim> {
    let name = string(ty).or_else(|| member(named(ty, types)?, "enum").and_then(string))?;
    prim(name)
}

/// Bytes of a type.
fn size(ty: &str, types: &str, depth: usize) -> Option<usize> {
    if depth > MAX_DEPTH {
        return None;
    }
    let of = |item: &str, n: &str| size(item, types, depth + 1)?.checked_mul(count(ty, n)?);
    if let Some(found) = number(ty, types) {
        Some(found.size())
    } else if let Some(item) = member(ty, "array") {
        of(item, "n")
    } else if let Some(item) = member(ty, "list") {
        of(item, "n")?.checked_add(8)?.checked_next_multiple_of(8)
    } else if member(ty, "text").is_some() {
        count(ty, "text")?.checked_add(8)?.checked_next_multiple_of(8)
    } else {
        count(named(ty, types)?, "size")
    }
}

/// Returns the type that `{"ref": name}` stands for.
fn named<'a>(ty: &str, types: &'a str) -> Option<&'a str> {
    let name = member(ty, "ref").and_then(string)?;
    items(types).find(|ty| member(ty, "name").and_then(string) == Some(name))
}

fn count(of: &str, key: &str) -> Option<usize> {
    member(of, key)?.parse().ok()
}

/// The value of a key of a JSON object.
fn member<'a>(object: &'a str, key: &str) -> Option<&'a str> {
    let mut rest = object.trim_start().strip_prefix('{')?;
    loop {
        let (name, behind) = value(rest)?;
        let (found, behind) = value(behind.trim_start().strip_prefix(':')?)?;
        if string(name) == Some(key) {
            return Some(found);
        }
        rest = behind.trim_start().strip_prefix(',')?;
    }
}

/// The values of a JSON array.
fn items(array: &str) -> impl Iterator<Item = &str> {
    let mut rest = array.trim_start().strip_prefix('[');
    std::iter::from_fn(move || {
        let (found, behind) = value(rest?)?;
        rest = behind.trim_start().strip_prefix(',');
        Some(found)
    })
}

/// A JSON text without escapes; names have none.
fn string(value: &str) -> Option<&str> {
    value.strip_prefix('"')?.strip_suffix('"').filter(|text| !text.contains('\\'))
}

/// Returns the first JSON value of a text, and the rest behind it.
fn value(text: &str) -> Option<(&str, &str)> {
    let text = text.trim_start();
    let (mut depth, mut quoted, mut escaped) = (0usize, false, false);
    for (at, byte) in text.bytes().enumerate() {
        let ends = match byte {
            _ if escaped => {
                escaped = false;
                false
            }
            b'\\' if quoted => {
                escaped = true;
                false
            }
            b'"' => {
                quoted = !quoted;
                !quoted && depth == 0
            }
            _ if quoted => false,
            b'{' | b'[' => {
                depth += 1;
                false
            }
            b'}' | b']' if depth > 0 => {
                depth -= 1;
                depth == 0
            }
            // A number or a word ends before these.
            b',' | b'}' | b']' | b':' | b' ' | b'\n' | b'\t' | b'\r' if depth == 0 => {
                return (at > 0).then(|| text.split_at(at));
            }
            _ => false,
        };
        if ends {
            return Some(text.split_at(at + 1));
        }
    }
    (depth == 0 && !quoted && !text.is_empty()).then_some((text, ""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamic::AnyType;

    const TYPES: &str = r#"[
        {"name": "E", "size": 4, "enum": "u32", "values": [{"name": "A, \"b\"]", "value": -1}]},
        {"name": "P", "size": 64, "fields": [
            {"name": "stamp", "at": 0, "unit": "s:{", "type": "stamp"},
            {"name": "position", "at": 8, "unit": "m", "type": {"array": "f64", "n": 3}},
            {"name": "how", "at": 32, "type": {"ref": "E"}},
            {"name": "flag", "at": 36, "type": "bool"},
            {"name": "who", "at": 40, "type": {"text": 16}}]},
        {"name": "Q", "size": 400, "fields": [
            {"name": "p", "at": 0, "type": {"ref": "P"}},
            {"name": "list", "at": 64, "type": {"list": "f64", "n": 4}},
            {"name": "many", "at": 104, "type": {"array": {"ref": "P"}, "n": 4}},
            {"name": "grid", "at": 360, "type": {"array": {"array": "f32", "n": 2}, "n": 5}}]}]"#;
    const PATHS: [&str; 22] = [
        "",
        "/",
        "p",
        "p/stamp",
        "p/position",
        "p/position/0",
        "p/position/2",
        "p/position/3",
        "p/how",
        "p/flag",
        "p/who",
        "list",
        "list/0",
        "many/3/position/1",
        "many/4/position/1",
        "many/3/how",
        "grid/4/1",
        "grid/4/2",
        "grid/x/1",
        "none",
        "p/position/2/1",
        "p//how",
    ];

    #[test]
    fn it_finds_what_the_whole_description_says() {
        let roots = [r#"{"ref": "Q"}"#, r#"{"ref": "P"}"#, r#""f64""#, r#"{"array": "i16", "n": 2}"#];
        let mut found = 0;
        for root in roots {
            for kind in ["plain", "frame"] {
                let text = format!(r#" {{ "{kind}" : {root}, "format": "image", "types":{TYPES} }}"#);
                let whole = AnyType::of_port(&text).expect("a description");
                for path in PATHS.into_iter().chain(["1", "stamp", "position/1"]) {
                    assert_eq!(place(&text, path), whole.place(path), "{path} of {root}");
                    found += usize::from(whole.place(path).is_some());
                }
                let compact = text.replace([' ', '\n'], "");
                assert_eq!(place(&compact, "p/how"), whole.place("p/how"), "without a space");
            }
        }
        assert!(found > 20, "{found}");
    }

    #[test]
    fn what_is_no_description_has_no_place_wherever_it_is_cut() {
        let text = format!(r#"{{"types": {TYPES}, "plain": {{"ref": "Q"}}}}"#);
        assert!(place(&text, "many/3/how").is_some());
        for at in (0..text.len() - 1).filter(|at| text.is_char_boundary(*at)) {
            assert_eq!(place(&text[..at], "many/3/how"), None, "{}", &text[..at]);
        }
        let round = r#"{"plain": {"array": {"ref": "A"}, "n": 2}, "types": [{"name": "A", "size": 8}]}"#;
        assert_eq!(place(round, "1/1"), None);
        for text in ["", "{", "[]", "{}", r#"{"plain"}"#, r#"{"plain": "f65"}"#, "}{", r#""\"#] {
            assert_eq!(place(text, ""), None, "{text}");
        }
    }
}
