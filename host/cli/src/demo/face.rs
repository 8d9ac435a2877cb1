//! The looks of a running demo: a screen on a terminal, one table below the other elsewhere, nothing beside
//! `--json`.
//!
//! Invariant: on a screen the addresses and the commands to try stay in view, warnings have lines of their
//! own below the table, and only the table gives way where there is no room.

use std::time::{Duration, Instant};

use crate::logging::{self, Kept};
use crate::screen::{Key, Screen, clipped};
use crate::session::Session;
use crate::top::rates::{Figures, between};
use crate::view::SystemView;
use crate::{out, style};

/// Lines of warnings that are in view.
const WARNINGS: usize = 3;
/// Rows of the table that stay, however much is warned of.
const LEAST: usize = 4;

pub(super) struct Face<'a> {
    session: &'a Session,
    kind: Kind,
}

enum Kind {
    Silent,
    /// A table each second; whether one was there before.
    Tables(bool),
    /// With what stays on top.
    Screen(Screen, String),
}

impl<'a> Face<'a> {
    /// Opens the display: `head` stays in view on a screen, `lines` are printed first elsewhere.
    pub(super) fn open(session: &'a Session, silent: bool, head: String, lines: &str) -> Self {
        if silent {
            return Self { session, kind: Kind::Silent };
        }
        let kind = match Screen::open() {
            Some(screen) => Kind::Screen(screen, head),
            None => {
                out::text(lines);
                Kind::Tables(false)
            }
        };
        Self { session, kind }
    }

    /// Draws each second, until a person at a screen ends it, and tells `seen` what there is. While the GCM
    /// does not answer there are no figures.
    pub(super) async fn keep(&mut self, seen: impl Fn(&SystemView)) {
        if matches!(self.kind, Kind::Silent) {
            return std::future::pending().await;
        }
        let mut before = None;
        let mut second = tokio::time::interval(Duration::from_secs(1));
        loop {
            tokio::select! {
                _ = second.tick() => {}
                key = self.key() => match key {
                    Key::Quit => return,
                    Key::Sort | Key::Reverse | Key::Pause => continue,
                },
            }
            let answer = self.session.list().await;
            let now = Instant::now();
            if let Ok(all) = &answer {
                seen(all);
            }
            match (answer, before.take()) {
                (Ok(list), None) => {
                    self.draw(&between(&list, &list, 0.0));
                    before = Some((now, list));
                }
                (Ok(list), Some((at, old))) => {
                    self.draw(&between(&old, &list, (now - at).as_secs_f64()));
                    before = Some((now, list));
                }
                (Err(failure), old) => {
                    self.say(&format!("no newer figures: {}", out::harmless(&failure.message)));
                    before = old;
                }
            }
        }
    }

    async fn key(&mut self) -> Key {
        match &mut self.kind {
            Kind::Screen(screen, _) => screen.key().await,
            Kind::Silent | Kind::Tables(_) => std::future::pending().await,
        }
    }

    fn draw(&mut self, figures: &Figures) {
        match &mut self.kind {
            Kind::Silent => {}
            // There are no rates in a first look.
            Kind::Tables(_) if figures.seconds == 0.0 => {}
            Kind::Tables(one) => {
                let gap = if std::mem::replace(one, true) { "\n" } else { "" };
                out::text(&format!("{gap}{}", figures.render(style::stdout())));
            }
            Kind::Screen(screen, head) => {
                let (rows, columns) = screen.size();
                let table = figures.render_in(columns, style::stdout());
                screen.draw(&laid_out(head, &table, &logging::kept(), rows));
            }
        }
    }

    fn say(&mut self, text: &str) {
        match &mut self.kind {
            Kind::Silent => {}
            Kind::Tables(_) => out::line(text),
            Kind::Screen(screen, head) => {
                let rows = screen.size().0;
                screen.draw(&laid_out(head, text, &logging::kept(), rows));
            }
        }
    }
}

/// Lays out so many lines: the head, the table, and below it the warnings.
fn laid_out(head: &str, table: &str, kept: &Kept, rows: usize) -> String {
    let head: Vec<&str> = head.lines().collect();
    let room = rows.saturating_sub(head.len() + 1);
    let foot = foot(kept, room.saturating_sub(LEAST));
    let shown = clipped(table, room - foot.len(), ": trocar top");
    let mut lines: Vec<String> = head.into_iter().map(str::to_owned).collect();
    lines.push(String::new());
    lines.extend(shown);
    lines.extend(foot);
    lines.join("\n")
}

/// Returns the warnings, in so many lines: the first one from while it came up, which later ones may follow
/// from, and the last ones.
fn foot(kept: &Kept, room: usize) -> Vec<String> {
    let title = |text: String| style::paint(&text, style::WARN, style::stdout());
    let mut lines = Vec::new();
    if let Some(first) = kept.lasting.first().filter(|_| room >= 2) {
        lines.push(title(match kept.lasting.len() {
            1 => "1 warning while it came up:".to_owned(),
            many => format!("{many} warnings while it came up, the first:"),
        }));
        lines.push(first.clone());
    }
    let newest = kept.newest.len().min(WARNINGS).min(room.saturating_sub(lines.len() + 1));
    if newest > 0 {
        lines.push(title(match kept.all {
            1 => "1 warning:".to_owned(),
            all => format!("{all} warnings, the last:"),
        }));
        lines.extend(kept.newest.iter().skip(kept.newest.len() - newest).cloned());
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(n: usize) -> Kept {
        Kept { newest: (1..=n).map(|i| format!("warning {i}")).collect(), all: n, lasting: Vec::new() }
    }

    fn table(n: usize) -> String {
        (1..=n).map(|i| format!("row {i}\n")).collect()
    }

    #[test]
    fn the_head_and_the_last_warnings_stay_in_view_and_the_table_gives_way() {
        let text = laid_out("head\naddress", &table(30), &kept(5), 12);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 12);
        assert_eq!(lines[..4], ["head", "address", "", "row 1"]);
        assert_eq!(
            lines[7..],
            ["… 26 more lines: trocar top", "5 warnings, the last:", "warning 3", "warning 4", "warning 5"]
        );
        let quiet = laid_out("head", "row 1\nrow 2", &kept(0), 24);
        assert_eq!(quiet, "head\n\nrow 1\nrow 2");
        let refused = Kept { lasting: vec!["no priority".into(), "no lock".into()], ..kept(5) };
        let text = laid_out("head", &table(30), &refused, 14);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            (lines.len(), &lines[8..11]),
            (14, &["2 warnings while it came up, the first:", "no priority", "5 warnings, the last:"][..])
        );
        for rows in 0..16 {
            let text = laid_out("head\naddress", &table(30), &refused, rows);
            assert!(rows < 4 || text.lines().count() <= rows, "{rows}: {text}");
        }
    }
}
