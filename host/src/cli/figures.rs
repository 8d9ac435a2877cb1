//! Figures of a running process over a window of time, and their live table.
//!
//! Invariant: a window begins and ends right after a step of the leading component, when its counters agree with its time
//! grid; in between it may be late, and the machine may be busy, without a count being off.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::runtime::Handle;
use trocar_model::ComponentId;

use super::table::Table;
use super::units;
use crate::lcm::{Detail, Lcm, LinkDetail};

/// Between two looks for a step.
const LOOK: Duration = Duration::from_micros(50);
/// Two looks and the time between them must not have taken longer to place a step.
const SHARP: Duration = Duration::from_micros(400);
/// A component that makes no step for this long is read as it is.
const PATIENCE: Duration = Duration::from_millis(500);

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
    pub(super) components: Vec<Stepper>,
    pub(super) wires: Vec<Wire>,
}

/// One component to look at.
#[derive(Clone, Debug)]
pub(super) struct Stepper {
    pub(super) id: ComponentId,
    /// Of its grid, ns; 0 = it has none.
    pub(super) period_ns: u64,
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
        let at = Instant::now();
        let mut components = Vec::with_capacity(self.components.len());
        for stepper in &self.components {
            components.push(self.lcm.detail(stepper.id.clone()).await.unwrap_or_default());
        }
        let all = self.lcm.links().await.unwrap_or_default();
        let links =
            self.wires.iter().map(|w| all.iter().find(|l| l.connection == w.id).cloned().unwrap_or_default());
        Reading { at, components, links: links.collect() }
    }

    /// Reads everything, component `i` right after one of its steps; blocks the calling thread. A look that was itself
    /// held up says nothing about the time it was taken: the next step is waited for.
    pub(super) fn read_after_step(&self, i: usize, runtime: &Handle) -> Reading {
        let look = || {
            let at = Instant::now();
            let id = self.components[i].id.clone();
            (at, runtime.block_on(self.lcm.detail(id)).unwrap_or_default())
        };
        let begin = Instant::now();
        let mut last = look();
        loop {
            std::thread::sleep(LOOK);
            let now = look();
            let sharp = last.0.elapsed() < SHARP;
            let stepped = now.1.executed + now.1.skipped != last.1.executed + last.1.skipped;
            if (sharp && stepped) || begin.elapsed() > PATIENCE {
                let mut reading = runtime.block_on(self.read());
                (reading.at, reading.components[i]) = now;
                return reading;
            }
            last = now;
        }
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
    /// Of component `i` between two readings. `late` is how much later than wanted the second one was taken: periods that
    /// began in it are not of the window.
    pub(super) fn between(a: &Reading, b: &Reading, i: usize, period_ns: u64, late: Duration) -> Self {
        let (from, to) = (&a.components[i], &b.components[i]);
        let seconds = (b.at - a.at).as_secs_f64();
        let executed = to.executed.saturating_sub(from.executed);
        let skipped = to.skipped.saturating_sub(from.skipped);
        let beyond =
            if period_ns > 0 { (late.as_nanos() as f64 / period_ns as f64).round() as u64 } else { 0 };
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
    for (i, stepper) in watched.components.iter().enumerate() {
        let s = Steps::between(a, b, i, stepper.period_ns, Duration::ZERO);
        let d = &b.components[i];
        steps.row([
            stepper.id.to_string(),
            units::rate(s.rate_hz),
            units::measured(s.lateness_p50_ns),
            units::measured(s.lateness_p99_ns),
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
            units::measured(to.latency_p50_ns),
            units::measured(to.latency_p99_ns),
            to.dropped.to_string(),
        ]);
    }
    format!("{}\n{}", steps.render(0, colour), wires.render(0, colour))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_that_began_after_the_window_are_not_counted() {
        let at = Instant::now();
        let reading = |at, executed, skipped| Reading {
            at,
            components: vec![Detail { executed, skipped, ..Detail::default() }],
            links: Vec::new(),
        };
        let a = reading(at, 100, 1);
        let b = reading(at + Duration::from_millis(1003), 1101, 3);
        let steps = Steps::between(&a, &b, 0, 1_000_000, Duration::from_millis(3));
        assert_eq!((steps.executed, steps.skipped), (998, 2), "{steps:?}");
    }
}
