//! Writes to stdout; a reader that went away (`trocar ls | head`) ends the program quietly.
//!
//! Invariant: nothing else of the command line prints answers.

use std::io::{ErrorKind, Write};

use serde_json::Value;

use super::exit::Exit;
pub(super) use trocar_model::plain::{harmless, json, lines, paragraph};

/// Longest value shown on one line, characters; `--json` shows all of it.
pub(super) const LONG: usize = 2000;

/// Writes `text` as it is, at once.
pub(super) fn text(text: &str) {
    let mut stdout = std::io::stdout().lock();
    if let Err(e) = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        if e.kind() != ErrorKind::BrokenPipe {
            eprintln!("error: cannot write the answer: {e}");
        }
        let exit = if e.kind() == ErrorKind::BrokenPipe { Exit::Ok } else { Exit::Refused };
        std::process::exit(exit as i32);
    }
}

/// Writes one line.
pub(super) fn line(line: &str) {
    text(&format!("{line}\n"));
}

/// Writes text that may come from elsewhere: a terminal obeys nothing in it, and no part of it begins a
/// line of its own.
pub(super) fn say(text: &str) {
    line(&paragraph(text));
}

/// The same on stderr, behind "error" or "warning". A reader that went away does not end the program: the
/// answer is elsewhere.
pub(super) fn complain(kind: &str, text: &str) {
    let _ = writeln!(std::io::stderr(), "{kind}: {}", paragraph(text));
}

/// Writes a line that nobody has to read, to stderr or stdout: where it cannot be written the
/// program goes on.
pub(super) fn news(line: &str, to_stderr: bool) {
    let line = format!("{line}\n");
    let _ = match to_stderr {
        true => std::io::stderr().write_all(line.as_bytes()),
        false => {
            let mut stdout = std::io::stdout().lock();
            stdout.write_all(line.as_bytes()).and_then(|()| stdout.flush())
        }
    };
}

/// Documentation, which comes with the line breaks of its source, as one harmless line.
pub(super) fn one_line(doc: &str) -> String {
    harmless(&doc.split_whitespace().collect::<Vec<_>>().join(" ")).into_owned()
}
/// A value as people read it: without the fields `reserved`, which only fill a payload up to its alignment.
pub(super) fn without_padding(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let shown = fields.iter().filter(|(name, _)| *name != "reserved");
            shown.map(|(name, value)| (name.clone(), without_padding(value))).collect()
        }
        Value::Array(items) => items.iter().map(without_padding).collect(),
        plain => plain.clone(),
    }
}
