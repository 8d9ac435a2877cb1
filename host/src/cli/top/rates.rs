//! Two answers of List → what happened between them, as rows.
//!
//! Invariant: a counter that went back began anew, and counts from zero; a figure nobody gave is shown as "-", never as 0.

use serde::Serialize;

use super::Sort;
use crate::cli::table::Table;
use crate::cli::view::{ComponentView, ConnectionView, SystemView};
use crate::cli::{style, units};

/// What `--json` prints each interval.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Figures {
    pub(super) revision: u64,
    /// Over which rates are averaged.
    pub(super) seconds: f64,
    pub(super) processes: Vec<ProcessRow>,
    pub(super) components: Vec<ComponentRow>,
    pub(super) connections: Vec<ConnectionRow>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ProcessRow {
    pub(super) name: String,
    pub(super) state: String,
    pub(super) pid: u32,
    pub(super) epoch: u64,
    pub(super) restarts: u32,
    pub(super) last_exit: String,
    pub(super) components: usize,
    /// Of all its components, in processors.
    pub(super) load: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ComponentRow {
    pub(super) path: String,
    pub(super) state: String,
    pub(super) health: String,
    pub(super) fault: String,
    /// Steps per second.
    pub(super) rate_hz: f64,
    /// Compute time over period, 0–1.
    pub(super) load: f64,
    pub(super) lateness_p50_ns: u64,
    pub(super) lateness_p99_ns: u64,
    pub(super) skipped: u64,
    pub(super) skipped_now: u64,
    pub(super) overruns: u64,
    pub(super) overruns_now: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ConnectionRow {
    pub(super) id: u64,
    pub(super) server: String,
    pub(super) client: String,
    pub(super) carrier: String,
    /// Samples, or commands and events, per second.
    pub(super) rate_hz: f64,
    pub(super) bytes_per_s: f64,
    pub(super) latency_p50_ns: u64,
    pub(super) latency_p99_ns: u64,
    pub(super) dropped: u64,
    pub(super) dropped_now: u64,
}

/// What came since; all of it when the counter began anew.
fn since(before: u64, now: u64) -> u64 {
    now.checked_sub(before).unwrap_or(now)
}

pub(super) fn between(before: &SystemView, now: &SystemView, seconds: f64) -> Figures {
    let rate = |count: u64| if seconds > 0.0 { count as f64 / seconds } else { 0.0 };
    let component = |c: &ComponentView| {
        let old = before.components.iter().find(|o| o.path == c.path).map(|o| &o.stats);
        // One that was made anew is compared with nothing.
        let old = old.filter(|o| o.executed <= c.stats.executed).cloned().unwrap_or_default();
        let s = &c.stats;
        ComponentRow {
            path: c.path.clone(),
            state: c.state.clone(),
            health: c.health.clone(),
            fault: c.fault.clone(),
            rate_hz: rate(since(old.executed, s.executed)),
            load: s.load,
            lateness_p50_ns: s.lateness_p50_ns,
            lateness_p99_ns: s.lateness_p99_ns,
            skipped: s.skipped,
            skipped_now: since(old.skipped, s.skipped),
            overruns: s.overruns,
            overruns_now: since(old.overruns, s.overruns),
        }
    };
    let connection = |c: &ConnectionView| {
        let old = before.connections.iter().find(|o| o.id == c.id && o.passed <= c.passed);
        let old = old.cloned().unwrap_or_default();
        ConnectionRow {
            id: c.id,
            server: c.server.clone(),
            client: c.client.clone(),
            carrier: c.carrier.clone(),
            rate_hz: rate(since(old.passed, c.passed)),
            bytes_per_s: rate(since(old.bytes, c.bytes)),
            latency_p50_ns: c.latency_p50_ns,
            latency_p99_ns: c.latency_p99_ns,
            dropped: c.dropped,
            dropped_now: since(old.dropped, c.dropped),
        }
    };
    let components: Vec<ComponentRow> = now.components.iter().map(component).collect();
    let processes = now.processes.iter().map(|p| {
        let prefix = format!("{}/", p.name);
        let mine = || components.iter().filter(|c| c.path.starts_with(&prefix));
        ProcessRow {
            name: p.name.clone(),
            state: p.state.clone(),
            pid: p.pid,
            epoch: p.epoch,
            restarts: p.restarts,
            last_exit: p.last_exit.clone(),
            components: mine().count(),
            load: mine().filter(|c| c.state == "ACTIVE" && c.health != "LOST").map(|c| c.load).sum(),
        }
    });
    Figures {
        revision: now.revision,
        seconds,
        processes: processes.collect(),
        connections: now.connections.iter().map(connection).collect(),
        components,
    }
}

/// 0 is well; the more, the less.
fn ill(c: &ComponentRow) -> u8 {
    match (c.state.as_str(), c.health.as_str()) {
        ("FAULT", _) => 5,
        (_, "LOST") => 4,
        (_, "UNRESPONSIVE") => 3,
        (state, _) if state.starts_with("STOPPED") => 2,
        ("ACTIVE", "OK") => 0,
        _ => 1,
    }
}

impl Figures {
    /// What matters by this measure first; equals keep the order of their paths.
    pub(super) fn sort(&mut self, by: Sort) {
        self.components.sort_by(|a, b| a.path.cmp(&b.path));
        self.connections.sort_by_key(|c| c.id);
        let (components, connections) = (&mut self.components, &mut self.connections);
        match by {
            Sort::Path => {}
            Sort::Health => {
                components.sort_by_key(|c| std::cmp::Reverse(ill(c)));
            }
            Sort::Rate => {
                components.sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
                connections.sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
            }
            Sort::Load => {
                components.sort_by(|a, b| b.load.total_cmp(&a.load));
                connections.sort_by(|a, b| b.bytes_per_s.total_cmp(&a.bytes_per_s));
            }
            Sort::Latency => {
                components.sort_by_key(|c| std::cmp::Reverse(c.lateness_p99_ns));
                connections.sort_by_key(|c| std::cmp::Reverse(c.latency_p99_ns));
            }
            Sort::Drops => {
                components.sort_by_key(|c| std::cmp::Reverse((c.skipped_now, c.skipped + c.overruns)));
                connections.sort_by_key(|c| std::cmp::Reverse((c.dropped_now, c.dropped)));
            }
        }
    }

    /// Three tables; those without rows are left out.
    pub(super) fn render(&self, colour: bool) -> String {
        let parts = [self.process_table(), self.component_table(), self.connection_table()];
        let shown: Vec<String> =
            parts.iter().filter(|t| !t.is_empty()).map(|t| t.render(0, colour)).collect();
        shown.join("\n")
    }

    fn process_table(&self) -> Table {
        let heads = ["PROCESS", "STATE", "PID", "EPOCH", "RESTARTS", "COMPONENTS", "LOAD", "LAST EXIT"];
        let mut table = Table::new(&heads);
        for p in &self.processes {
            table.styled([
                plain(p.name.clone()),
                (p.state.clone(), style::of_state(&p.state)),
                plain(p.pid.to_string()),
                plain(p.epoch.to_string()),
                plain(p.restarts.to_string()),
                plain(p.components.to_string()),
                plain(units::percent(p.load)),
                plain(units::cut(&p.last_exit, 60)),
            ]);
        }
        table
    }

    fn component_table(&self) -> Table {
        let heads =
            ["COMPONENT", "STATE", "HEALTH", "RATE", "LOAD", "LATE p50", "p99", "SKIPPED", "OVERRUNS"];
        let mut table = Table::new(&heads);
        for c in &self.components {
            table.styled([
                plain(c.path.clone()),
                (c.state.clone(), style::of_state(&c.state)),
                (c.health.clone(), style::of_state(&c.health)),
                plain(units::rate(c.rate_hz)),
                plain(units::percent(c.load)),
                plain(units::measured(c.lateness_p50_ns)),
                plain(units::measured(c.lateness_p99_ns)),
                grown(c.skipped, c.skipped_now),
                grown(c.overruns, c.overruns_now),
            ]);
        }
        table
    }

    fn connection_table(&self) -> Table {
        let heads = ["CONNECTION", "CARRIER", "RATE", "BYTES", "LATENCY p50", "p99", "DROPPED"];
        let mut table = Table::new(&heads);
        for c in &self.connections {
            table.styled([
                plain(format!("{} {} → {}", c.id, c.server, c.client)),
                plain(if c.carrier.is_empty() { "-".to_owned() } else { c.carrier.clone() }),
                plain(units::rate(c.rate_hz)),
                plain(units::bytes_per_s(c.bytes_per_s)),
                plain(units::measured(c.latency_p50_ns)),
                plain(units::measured(c.latency_p99_ns)),
                grown(c.dropped, c.dropped_now),
            ]);
        }
        table
    }
}

fn plain(text: String) -> (String, anstyle::Style) {
    (text, style::PLAIN)
}

/// A sum, and what came to it now.
fn grown(sum: u64, now: u64) -> (String, anstyle::Style) {
    if now == 0 { plain(sum.to_string()) } else { (format!("{sum} (+{now})"), style::WARN) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::view::{ProcessView, StatsView};

    fn system(executed: u64, passed: u64, dropped: u64) -> SystemView {
        let component = |path: &str, executed: u64| ComponentView {
            path: path.into(),
            state: "ACTIVE".into(),
            health: "OK".into(),
            stats: StatsView { executed, load: 0.25, ..StatsView::default() },
            ..ComponentView::default()
        };
        SystemView {
            processes: vec![ProcessView { name: "left".into(), ..ProcessView::default() }],
            components: vec![component("left/a", executed), component("left/b", 2 * executed)],
            connections: vec![ConnectionView {
                id: 1,
                passed,
                dropped,
                bytes: 8 * passed,
                ..ConnectionView::default()
            }],
            ..SystemView::default()
        }
    }

    #[test]
    fn rates_are_what_came_between_over_the_time_between() {
        let f = between(&system(1000, 100, 3), &system(3000, 200, 5), 2.0);
        assert_eq!((f.components[0].rate_hz, f.components[1].rate_hz), (1000.0, 2000.0));
        let c = &f.connections[0];
        assert_eq!((c.rate_hz, c.bytes_per_s, c.dropped, c.dropped_now), (50.0, 400.0, 5, 2));
        assert_eq!((f.processes[0].components, f.processes[0].load), (2, 0.5));
    }

    #[test]
    fn what_was_made_anew_counts_from_zero() {
        let f = between(&system(5000, 900, 3), &system(10, 4, 1), 1.0);
        assert_eq!((f.components[0].rate_hz, f.connections[0].rate_hz), (10.0, 4.0));
        assert_eq!(f.connections[0].dropped_now, 1);
        let fresh = between(&SystemView::default(), &system(10, 4, 1), 1.0);
        assert_eq!(fresh.components[0].rate_hz, 10.0);
    }

    #[test]
    fn what_matters_comes_first_and_equals_stay_in_order() {
        let mut f = between(&system(0, 0, 0), &system(1000, 0, 0), 1.0);
        f.sort(Sort::Rate);
        assert_eq!(f.components[0].path, "left/b");
        f.components[0].state = "FAULT".into();
        f.sort(Sort::Path);
        assert_eq!(f.components[0].path, "left/a");
        f.sort(Sort::Health);
        assert_eq!(f.components[0].path, "left/b");
        f.sort(Sort::Load);
        assert_eq!(f.components[0].path, "left/a");
    }

    #[test]
    fn the_tables_say_every_unit_and_what_grew() {
        let text = between(&system(1000, 100, 3), &system(3000, 200, 5), 2.0).render(false);
        for part in ["1000 Hz", "25.0 %", "400 B/s", "5 (+2)", "COMPONENT", "CONNECTION", "PROCESS"] {
            assert!(text.contains(part), "no {part} in\n{text}");
        }
    }
}
