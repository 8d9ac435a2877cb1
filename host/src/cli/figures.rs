//! Figures of a running process over a window of time, and their live table.
//!
//! Invariant: counters are read with the clock on both sides of the reading, so a window's length is known to a fraction
//! of a millisecond whatever the machine does.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use trocar_model::ComponentId;

use super::table::Table;
use super::units;
use crate::lcm::{Detail, Lcm, LinkDetail};

/// A reading is repeated until it took no longer than this.
const SHARP: Duration = Duration::from_micros(200);
const TRIES: usize = 50;

/// One connection to look at.
#[derive(Clone, Debug)]
pub(super) struct Wire {
    pub(super) id: u64,
    /// `server → client`.
    pub(super) name: String,
}

/// What is looked at.
#[derive(Clone)]
pub(super) struct Watched {
    pub(super) lcm: Arc<dyn Lcm>,
    pub(super) components: Vec<ComponentId>,
    pub(super) wires: Vec<Wire>,
}

/// All counters at one moment.
#[derive(Clone, Debug)]
pub(super) struct Reading {
    pub(super) at: Instant,
    pub(super) components: Vec<Detail>,
    pub(super) links: Vec<LinkDetail>,
}

impl Watched {
    /// Reads everything. What is gone reads as zero.
    pub(super) async fn read(&self) -> Reading {
        let mut last = self.read_once().await;
        for _ in 1..TRIES {
            if last.1 <= SHARP {
                break;
            }
            last = self.read_once().await;
        }
        last.0
    }

    async fn read_once(&self) -> (Reading, Duration) {
        let at = Instant::now();
        let mut components = Vec::with_capacity(self.components.len());
        for id in &self.components {
            components.push(self.lcm.detail(id.clone()).await.unwrap_or_default());
        }
        let took = at.elapsed();
        let all = self.lcm.links().await.unwrap_or_default();
        let links =
            self.wires.iter().map(|w| all.iter().find(|l| l.connection == w.id).cloned().unwrap_or_default());
        (Reading { at, components, links: links.collect() }, took)
    }
}

/// What a component did in a window.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Steps {
    pub(super) executed: u64,
    pub(super) skipped: u64,
    pub(super) overruns: u64,
    pub(super) rate_hz: f64,
    pub(super) lateness_p50_ns: u64,
    pub(super) lateness_p99_ns: u64,
    pub(super) lateness_max_ns: u64,
}

impl Steps {
    /// Between two readings of component `i`. `late` is how much later than wanted the second one was taken: periods
    /// that began in it are not of the window.
    pub(super) fn between(a: &Reading, b: &Reading, i: usize, late: Duration) -> Self {
        let (from, to) = (&a.components[i], &b.components[i]);
        let seconds = (b.at - a.at).as_secs_f64();
        let executed = to.executed.saturating_sub(from.executed);
        let skipped = to.skipped.saturating_sub(from.skipped);
        let beyond = match to.period.avg_ns {
            period if period > 0.0 => (late.as_nanos() as f64 / period).round() as u64,
            _ => 0,
        };
        Self {
            executed: executed.saturating_sub(beyond),
            skipped,
            overruns: to.overruns.saturating_sub(from.overruns),
            rate_hz: if seconds > 0.0 { executed as f64 / seconds } else { 0.0 },
            lateness_p50_ns: to.lateness_p50_ns,
            lateness_p99_ns: to.lateness_p99_ns,
            lateness_max_ns: to.lateness_max_ns,
        }
    }
}

/// The table of one second.
pub(super) fn table(watched: &Watched, a: &Reading, b: &Reading, colour: bool) -> String {
    let mut steps = Table::new(&["COMPONENT", "RATE", "LATE p50", "p99", "SKIPPED", "OVERRUNS", "LOAD"]);
    for (i, id) in watched.components.iter().enumerate() {
        let s = Steps::between(a, b, i, Duration::ZERO);
        let d = &b.components[i];
        steps.row([
            id.to_string(),
            units::rate(s.rate_hz),
            units::time(s.lateness_p50_ns),
            units::time(s.lateness_p99_ns),
            d.skipped.to_string(),
            d.overruns.to_string(),
            units::percent(d.load),
        ]);
    }
    let mut wires = Table::new(&["CONNECTION", "RATE", "LATENCY p50", "p99", "DROPPED"]);
    let seconds = (b.at - a.at).as_secs_f64().max(1e-9);
    for (i, wire) in watched.wires.iter().enumerate() {
        let (from, to) = (&a.links[i], &b.links[i]);
        wires.row([
            wire.name.clone(),
            units::rate(to.passed.saturating_sub(from.passed) as f64 / seconds),
            units::time(to.latency_p50_ns),
            units::time(to.latency_p99_ns),
            to.dropped.to_string(),
        ]);
    }
    format!("{}\n{}", steps.render(0, colour), wires.render(0, colour))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lcm::Spread;

    #[test]
    fn periods_that_began_after_the_window_are_not_counted() {
        let at = Instant::now();
        let reading = |at, executed, skipped| Reading {
            at,
            components: vec![Detail {
                executed,
                skipped,
                period: Spread { avg_ns: 1e6, ..Spread::default() },
                ..Detail::default()
            }],
            links: Vec::new(),
        };
        let a = reading(at, 100, 1);
        let b = reading(at + Duration::from_millis(1003), 1101, 3);
        let steps = Steps::between(&a, &b, 0, Duration::from_millis(3));
        assert_eq!((steps.executed, steps.skipped), (998, 2), "{steps:?}");
    }
}
