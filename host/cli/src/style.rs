//! Colours for people: only on a terminal, never under NO_COLOR.
//!
//! Invariant: nothing else decides whether to colour; text is complete without colour.

use std::io::IsTerminal;

use anstyle::{AnsiColor, Style};

/// True when escape codes may be written to `stream`.
fn coloured(stream: &impl IsTerminal) -> bool {
    let refused = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty());
    let dumb = std::env::var_os("TERM").is_some_and(|t| t == "dumb");
    !refused && !dumb && stream.is_terminal()
}

/// True when stdout may be coloured.
pub(super) fn stdout() -> bool {
    coloured(&std::io::stdout())
}

/// True when stdout is a terminal a person looks at.
pub(super) fn interactive() -> bool {
    std::io::stdout().is_terminal()
}

/// Start of red bold, start of green bold, and reset for stderr; empty without colour.
pub(super) fn error_colours() -> (String, String, &'static str) {
    if !coloured(&std::io::stderr()) {
        return (String::new(), String::new(), "");
    }
    let bold = |c: AnsiColor| Style::new().bold().fg_color(Some(c.into())).render().to_string();
    (bold(AnsiColor::Red), bold(AnsiColor::Green), "\x1b[0m")
}

pub(super) const HEAD: Style = Style::new().bold();
pub(super) const DIM: Style = Style::new().dimmed();
pub(super) const GOOD: Style = Style::new().fg_color(Some(anstyle::Color::Ansi(AnsiColor::Green)));
pub(super) const WARN: Style = Style::new().fg_color(Some(anstyle::Color::Ansi(AnsiColor::Yellow)));
pub(super) const BAD: Style = Style::new().fg_color(Some(anstyle::Color::Ansi(AnsiColor::Red)));
pub(super) const PLAIN: Style = Style::new();

/// The colour of a component's or process's state or health word.
pub(super) fn of_state(word: &str) -> Style {
    match word {
        "ACTIVE" | "ATTACHED" | "OK" => GOOD,
        "FAULT" | "LOST" | "UNRESPONSIVE" | "FAILED" => BAD,
        "OVERRUN" | "STALE_INPUT" | "RESTARTING" => WARN,
        w if w.starts_with("STOPPED") => WARN,
        _ => PLAIN,
    }
}

/// `text` in `style` when colour is on.
pub(super) fn paint(text: &str, style: Style, colour: bool) -> String {
    if colour && style != PLAIN { format!("{style}{text}{style:#}") } else { text.to_owned() }
}
