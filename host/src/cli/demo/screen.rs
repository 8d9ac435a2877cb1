//! The live table of a running demo: redrawn in place on a terminal, one table below the other elsewhere, nothing beside
//! `--json`.

use std::convert::Infallible;
use std::time::{Duration, Instant};

use crate::cli::session::Session;
use crate::cli::top::rates::between;
use crate::cli::{out, style};

pub(super) struct Screen<'a> {
    session: &'a Session,
    silent: bool,
    drawn_lines: usize,
}

impl<'a> Screen<'a> {
    pub(super) fn new(session: &'a Session, silent: bool) -> Self {
        Self { session, silent, drawn_lines: 0 }
    }

    /// Draws each second, for ever. While the GCM does not answer there are no figures.
    pub(super) async fn keep(&mut self) -> Infallible {
        if self.silent {
            return std::future::pending().await;
        }
        let mut before = None;
        let mut second = tokio::time::interval(Duration::from_secs(1));
        loop {
            second.tick().await;
            let answer = self.session.list().await;
            let now = Instant::now();
            match (answer, before.take()) {
                (Ok(list), None) => before = Some((now, list)),
                (Ok(list), Some((at, old))) => {
                    self.draw(&between(&old, &list, (now - at).as_secs_f64()).render(style::stdout()));
                    before = Some((now, list));
                }
                (Err(failure), old) => {
                    self.draw(&format!("no newer figures: {}\n", out::harmless(&failure.message)));
                    before = old;
                }
            }
        }
    }

    fn draw(&mut self, text: &str) {
        let up = match (self.drawn_lines, style::interactive()) {
            (0, _) => String::new(),
            (lines, true) => format!("\x1b[{lines}A\x1b[J"),
            (_, false) => "\n".to_owned(),
        };
        out::text(&format!("{up}{text}"));
        self.drawn_lines = text.lines().count();
    }
}
