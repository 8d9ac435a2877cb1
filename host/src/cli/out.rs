//! Writes to stdout; a reader that went away (`trocar ls | head`) ends the program quietly.
//!
//! Invariant: nothing else of the command line prints answers.

use std::io::{ErrorKind, Write};

use super::failure::Exit;

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
