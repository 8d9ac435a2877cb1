//! Text from elsewhere made harmless: one line, without characters a terminal would obey.
//!
//! Invariant: each sentence of a plugin passes here where it enters the host, so logs, answers and refusals
//! hold it as shown.

use std::borrow::Cow;

/// The text a plugin wrote into `bytes`, padding cut off.
pub fn sentence(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    harmless(text.trim_end_matches(['\0', '\n', '\r', ' '])).into_owned()
}

/// Returns `text` with every character escaped that moves a cursor, changes a colour, begins a line or turns
/// the writing direction.
pub fn harmless(text: &str) -> Cow<'_, str> {
    if !text.contains(obeyed) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if obeyed(c) { shown.extend(c.escape_default()) } else { shown.push(c) }
    }
    shown.into()
}

/// As [`harmless`], for a text of the host's own that may have several lines: those after the first are
/// indented.
pub fn paragraph(text: &str) -> Cow<'_, str> {
    each_line(text, "\n    ")
}

/// As [`harmless`], for a page: its lines stay as they are.
pub fn lines(text: &str) -> Cow<'_, str> {
    each_line(text, "\n")
}

fn each_line<'a>(text: &'a str, between: &str) -> Cow<'a, str> {
    if !text.contains(obeyed) {
        return text.into();
    }
    text.split('\n').map(harmless).collect::<Vec<_>>().join(between).into()
}

/// Returns JSON text, in which such characters stand inside strings only, in JSON's own escapes.
pub fn json(text: &str) -> Cow<'_, str> {
    if !text.contains(obeyed) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        // None of them is beyond the basic plane, so one unit is enough.
        if obeyed(c) { shown.push_str(&format!("\\u{:04x}", u32::from(c))) } else { shown.push(c) }
    }
    shown.into()
}

fn obeyed(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_obeys_nothing_of_a_file_name() {
        assert_eq!(harmless("a\x1b[2Jb\nµ.so"), "a\\u{1b}[2Jb\\nµ.so");
        assert_eq!(harmless("left\u{202e}right"), "left\\u{202e}right");
    }

    #[test]
    fn a_sentence_of_a_plugin_is_one_line_without_padding() {
        assert_eq!(sentence(b"no\nERROR forged\r\n\0\0\0"), "no\\nERROR forged");
        assert_eq!(sentence(b"\0\0"), "");
        assert_eq!(sentence(b"a\0b\xff"), "a\\u{0}b\u{fffd}");
    }

    #[test]
    fn later_lines_of_a_paragraph_cannot_pass_for_lines_of_the_log() {
        assert_eq!(paragraph("two\nlines\x1b[m"), "two\n    lines\\u{1b}[m");
        assert_eq!(lines("two\nlines\x1b[m"), "two\nlines\\u{1b}[m");
    }

    #[test]
    fn json_stays_json_and_means_the_same() {
        let value = serde_json::json!({ "a\u{9b}31m": "\u{7f}\x1b\n\u{202e}µ" });
        let shown = json(&value.to_string()).into_owned();
        assert!(!shown.contains(obeyed), "{shown}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).ok(), Some(value));
    }
}
