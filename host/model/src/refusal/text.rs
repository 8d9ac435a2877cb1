//! Parts of a refusal's sentence.
//!
//! Invariant: no list is longer than [`MOST`] entries.

use std::borrow::Cow;
use std::fmt::{Display, Write as _};

use crate::{MAX_COPIES, nearest};

/// Entries of a list that are spelled out.
const MOST: usize = 12;

/// Most characters of a sent text that are repeated to its sender.
const ECHO: usize = 200;

/// Ends the difference of two types whose fields only moved.
pub(crate) const ADAPTABLE: &str = "; adapt: true would copy it by name";

/// Ends the difference of two types whose fields only moved, but too many of them.
pub(crate) fn scattered() -> String {
    format!(
        "; adapt: true cannot help, it would have to copy more than {MAX_COPIES} runs of bytes for each sample"
    )
}

/// Returns the text that was sent, cut where it is longer than any reader needs; an answer must fit the
/// header it travels in.
pub fn brief(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(ECHO) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}… ({} bytes)", &text[..end], text.len())),
    }
}

/// "a, b, c and 5 more".
pub(super) fn list<T: Display>(items: &[T]) -> String {
    let mut out = String::new();
    for (i, item) in items.iter().take(MOST).enumerate() {
        // Writing to a String cannot fail.
        let _ = write!(out, "{}{item}", if i > 0 { ", " } else { "" });
    }
    if items.len() > MOST {
        let _ = write!(out, " and {} more", items.len() - MOST);
    }
    out
}

/// The list behind `lead`; nothing when it is empty.
pub(super) fn unless_none<T: Display>(lead: &str, items: &[T]) -> String {
    if items.is_empty() { String::new() } else { format!("{lead}{}", list(items)) }
}

/// The text behind `lead`; nothing when it is empty.
pub(super) fn unless_empty(lead: &str, text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("{lead}{text}") }
}

/// "one is wrong; another is wrong; and 5 more".
pub(super) fn clauses(texts: &[&str]) -> String {
    let first = texts[..texts.len().min(MOST)].join("; ");
    match texts.len().saturating_sub(MOST) {
        0 => first,
        more => format!("{first}; and {more} more"),
    }
}

/// "`host/gray` → `host/resize`".
pub(super) fn route<T: Display>(path: &[T]) -> String {
    let path: Vec<String> = path.iter().map(|id| format!("`{id}`")).collect();
    path.join(" → ")
}

/// The known name nearest to the mistyped one.
pub(super) fn near<T: Display>(wanted: &str, known: &[T]) -> Option<String> {
    // A word that long is no typing error, and the distance costs the product of the lengths.
    if wanted.len() > ECHO {
        return None;
    }
    let names: Vec<String> = known.iter().map(ToString::to_string).collect();
    nearest(wanted, names.iter().map(String::as_str)).map(str::to_owned)
}

/// "; did you mean `host`? There are gcm, host" — or only the part that helps.
pub(super) fn choices<T: Display>(wanted: &str, known: &[T]) -> String {
    let there = if known.len() == 1 { "There is" } else { "There are" };
    match near(wanted, known) {
        _ if known.is_empty() => "; there are none".to_owned(),
        Some(name) => format!("; did you mean `{name}`? {there} {}", list(known)),
        None => format!("; {} {}", there.to_lowercase(), list(known)),
    }
}

/// 1500000 ns → "1.5 ms".
pub(crate) fn duration(ns: u64) -> String {
    let (scale, unit) = match ns {
        0..1_000 => (1.0, "ns"),
        1_000..1_000_000 => (1e3, "µs"),
        1_000_000..1_000_000_000 => (1e6, "ms"),
        _ => (1e9, "s"),
    };
    format!("{} {unit}", ns as f64 / scale)
}

pub(super) fn is_are(n: usize) -> &'static str {
    if n == 1 { "is" } else { "are" }
}

/// Returns what is wrong with a file, without its name: the sentence has named it already.
pub(super) fn without_file<'a>(file: &str, text: &'a str) -> &'a str {
    let name = file.rsplit('/').next().unwrap_or(file);
    let rest = text.strip_prefix(file).or_else(|| text.strip_prefix(name));
    rest.and_then(|rest| rest.strip_prefix(": ")).unwrap_or(text)
}
