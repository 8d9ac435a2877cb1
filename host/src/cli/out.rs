//! Writes to stdout; a reader that went away (`trocar ls | head`) ends the program quietly.
//!
//! Invariant: nothing else of the command line prints answers.

use std::io::{ErrorKind, Write};

use super::failure::Exit;

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

/// Text from elsewhere, such as a file name or a log line, without what a terminal would obey.
pub(super) fn harmless(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_control() { shown.extend(c.escape_default()) } else { shown.push(c) }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::harmless;

    #[test]
    fn a_terminal_obeys_nothing_of_a_file_name() {
        assert_eq!(harmless("a\x1b[2Jb\nµ.so"), "a\\u{1b}[2Jb\\nµ.so");
    }
}
