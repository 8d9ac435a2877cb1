//! A terminal as a screen: drawn over, and keys at once.
//!
//! Invariant: however the screen ends, the terminal is as it was; nothing drawn is longer or higher
//! than the terminal.

use std::io::{IsTerminal, Read, Write};

use rustix::termios::{self, LocalModes, OptionalActions, Termios};
use tokio::sync::mpsc;
use trocar_rt::house;

/// Action that a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    Quit,
    Sort,
    Reverse,
    Pause,
}

impl Key {
    fn of(byte: u8) -> Option<Key> {
        match byte {
            b'q' | b'Q' => Some(Key::Quit),
            b's' | b'S' => Some(Key::Sort),
            b'r' | b'R' => Some(Key::Reverse),
            b' ' | b'p' => Some(Key::Pause),
            _ => None,
        }
    }
}

/// The other screen of a terminal.
pub(super) struct Screen {
    /// `None`: no keys come from here.
    before: Option<Termios>,
    keys: mpsc::UnboundedReceiver<Key>,
}

impl Screen {
    /// Standard output is a terminal a person looks at.
    pub(super) fn is_possible() -> bool {
        std::io::stdout().is_terminal() && std::env::var_os("TERM").is_some_and(|term| term != "dumb")
    }

    /// `None`: standard output is no terminal a person looks at.
    pub(super) fn open() -> Option<Screen> {
        if !Screen::is_possible() {
            return None;
        }
        let (tell, keys) = mpsc::unbounded_channel();
        let before = raw();
        if before.is_some() {
            // The thread waits for a key until the process ends.
            house::spawn(std::thread::Builder::new().name("trocar-keys".into()), move || read_keys(&tell))
                .ok();
        }
        write("\x1b[?1049h\x1b[?25l");
        Some(Screen { before, keys })
    }

    /// The next key; never where none come from here.
    pub(super) async fn key(&mut self) -> Key {
        match self.keys.recv().await {
            Some(key) => key,
            None => std::future::pending().await,
        }
    }

    /// Rows and columns.
    pub(super) fn size(&self) -> (usize, usize) {
        match termios::tcgetwinsize(std::io::stdout()) {
            Ok(size) if size.ws_row > 0 && size.ws_col > 0 => (size.ws_row.into(), size.ws_col.into()),
            _ => (24, 80),
        }
    }

    pub(super) fn draw(&mut self, text: &str) {
        let (rows, columns) = self.size();
        write(&format!("\x1b[H{}\x1b[J", fitted(text, rows, columns)));
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        write("\x1b[?25h\x1b[?1049l");
        if let Some(before) = &self.before {
            // A terminal that is gone needs nothing.
            let _ = termios::tcsetattr(std::io::stdin(), OptionalActions::Now, before);
        }
    }
}

/// The next key; never without a screen.
pub(super) async fn next(screen: &mut Option<Screen>) -> Key {
    match screen {
        Some(screen) => screen.key().await,
        None => std::future::pending().await,
    }
}

/// Keys come at once and are not shown; Ctrl-C still ends the program. Answers how it was.
fn raw() -> Option<Termios> {
    let stdin = std::io::stdin();
    let before = termios::tcgetattr(&stdin).ok()?;
    let mut now = before.clone();
    now.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
    termios::tcsetattr(&stdin, OptionalActions::Now, &now).ok()?;
    Some(before)
}

fn read_keys(tell: &mpsc::UnboundedSender<Key>) {
    let mut byte = [0];
    while matches!(std::io::stdin().read(&mut byte), Ok(1)) {
        if let Some(key) = Key::of(byte[0])
            && tell.send(key).is_err()
        {
            return;
        }
    }
}

fn write(text: &str) {
    let mut out = std::io::stdout().lock();
    // A terminal that is gone ends the program by its signal.
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Returns the part that fits, each line cleared to its end. Colours take no room, and end with their line.
fn fitted(text: &str, rows: usize, columns: usize) -> String {
    let lines = clipped(text, rows, "");
    lines.iter().map(|line| cut(line, columns) + "\x1b[K").collect::<Vec<_>>().join("\r\n")
}

/// Returns so many lines of a text; where it has more, the last one says how many, and where they are seen.
pub(super) fn clipped(text: &str, rows: usize, elsewhere: &str) -> Vec<String> {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let hidden = lines.len().saturating_sub(rows);
    if hidden > 0 {
        lines.truncate(rows.saturating_sub(1));
        lines.push(format!("… {} more lines{elsewhere}", hidden + 1));
    }
    lines
}

fn cut(line: &str, columns: usize) -> String {
    let (mut out, mut width, mut escape) = (String::new(), 0, false);
    for c in line.chars() {
        match c {
            '\x1b' => escape = true,
            _ if escape => escape = c != 'm',
            _ if width == columns => return out + "\x1b[0m",
            _ => width += 1,
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_cut_at_the_edge_and_colours_take_no_room() {
        assert_eq!(cut("abcdef", 3), "abc\x1b[0m");
        assert_eq!(cut("\x1b[32mabc\x1b[0m", 3), "\x1b[32mabc\x1b[0m");
        assert_eq!(cut("\x1b[32mabcd\x1b[0m", 3), "\x1b[32mabc\x1b[0m");
        assert_eq!(cut("µµ", 5), "µµ");
    }

    #[test]
    fn what_does_not_fit_is_counted() {
        let text = fitted("1\n2\n3\n4\n5", 3, 80);
        let lines: Vec<&str> = text.split("\r\n").collect();
        assert_eq!(lines, ["1\x1b[K", "2\x1b[K", "… 3 more lines\x1b[K"]);
        assert_eq!(fitted("1\n2", 3, 80).matches("\r\n").count(), 1);
    }

    #[test]
    fn keys_that_mean_nothing_do_nothing() {
        assert_eq!([b'q', b'x', 0x1b, b' '].map(Key::of), [Some(Key::Quit), None, None, Some(Key::Pause)]);
    }
}
