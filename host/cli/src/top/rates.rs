//! Two answers of List → what happened between them, as rows.
//!
//! Invariant: a counter that went back began anew, and counts from zero; a figure that is not known is shown
//! as "-", never as 0.

use clap::ValueEnum;
use serde::Serialize;

use crate::table::Table;
use crate::view::{ComponentView, ConnectionView, SystemView};
use crate::{style, units};

/// Sort order of rows: the largest first, paths from a to z.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Sort {
    /// By path; connections by number.
    Path,
    /// Failures first: rows that do not run or are not well.
    Health,
    /// Steps or samples per second.
    Rate,
    /// Load of components, bytes per second of connections.
    Load,
    /// Lateness of components, age of samples.
    Latency,
    /// Periods skipped, samples dropped.
    Drops,
}

impl Sort {
    pub(super) const ALL: [Sort; 6] =
        [Sort::Path, Sort::Health, Sort::Rate, Sort::Load, Sort::Latency, Sort::Drops];

    pub(super) fn name(self) -> &'static str {
        ["path", "health", "rate", "load", "latency", "drops"][self as usize]
    }

    pub(super) fn next(self) -> Sort {
        Sort::ALL[(self as usize + 1) % Sort::ALL.len()]
    }
}

/// Object that `--json` prints in each interval.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Figures {
    pub(super) revision: u64,
    /// Time over which rates are averaged.
    pub(crate) seconds: f64,
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
    pub(super) warnings: Vec<String>,
    pub(super) components: usize,
    /// Load of all its components, in processors.
    pub(super) load: f64,
}

/// `None`: the figure is not known, or there is no earlier one to compare with.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ComponentRow {
    pub(super) path: String,
    pub(super) state: String,
    pub(super) health: String,
    pub(super) fault: String,
    /// Steps per second.
    pub(super) rate_hz: Option<f64>,
    /// Compute time over period, 0–1.
    pub(super) load: Option<f64>,
    pub(super) lateness_p50_ns: u64,
    pub(super) lateness_p99_ns: u64,
    pub(super) skipped: Option<u64>,
    pub(super) skipped_now: u64,
    pub(super) overruns: Option<u64>,
    pub(super) overruns_now: u64,
}

/// `None` as in a component's row.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct ConnectionRow {
    pub(super) id: u64,
    pub(super) server: String,
    pub(super) client: String,
    pub(super) carrier: String,
    /// False: of a connection between processes whose halves are not linked now.
    pub(super) linked: bool,
    /// Samples, or commands and events, per second.
    pub(super) rate_hz: Option<f64>,
    pub(super) bytes_per_s: Option<f64>,
    pub(super) latency_p50_ns: u64,
    pub(super) latency_p99_ns: u64,
    /// Dropped ones, with the rejected ones among them.
    pub(super) dropped: Option<u64>,
    pub(super) dropped_now: u64,
    pub(super) rejected: u64,
    pub(super) rejected_now: u64,
    /// Commands that were only sent, ran and failed.
    pub(super) failed: u64,
    pub(super) failed_now: u64,
}

/// Returns the increase of a counter; all of it when the counter began anew.
pub(crate) fn since(before: u64, now: u64) -> u64 {
    now.checked_sub(before).unwrap_or(now)
}

pub(crate) fn between(before: &SystemView, now: &SystemView, seconds: f64) -> Figures {
    let components: Vec<ComponentRow> =
        now.components.iter().map(|c| component(before, now, c, seconds)).collect();
    let processes = now.processes.iter().map(|p| {
        let prefix = format!("{}/", p.name);
        let mine = || components.iter().filter(|c| c.path.starts_with(&prefix));
        let runs = |c: &&ComponentRow| c.state == "ACTIVE" && c.health != "LOST";
        ProcessRow {
            name: p.name.clone(),
            state: p.state.clone(),
            pid: p.pid,
            epoch: p.epoch,
            restarts: p.restarts,
            last_exit: p.last_exit.clone(),
            warnings: p.warnings.clone(),
            components: mine().count(),
            load: mine().filter(runs).filter_map(|c| c.load).sum(),
        }
    });
    Figures {
        revision: now.revision,
        seconds,
        processes: processes.collect(),
        connections: now.connections.iter().map(|c| connection(before, now, c, seconds)).collect(),
        components,
    }
}

/// The process of a path is another incarnation than before: its counters began anew.
fn is_anew(before: &SystemView, now: &SystemView, path: &str) -> bool {
    let process = path.split('/').next().unwrap_or_default();
    let epoch = |of: &SystemView| of.processes.iter().find(|p| p.name == process).map(|p| p.epoch);
    epoch(before).is_some() && epoch(before) != epoch(now)
}

fn rate(count: u64, seconds: f64) -> Option<f64> {
    (seconds > 0.0).then(|| count as f64 / seconds)
}

fn component(before: &SystemView, now: &SystemView, c: &ComponentView, seconds: f64) -> ComponentRow {
    let row = ComponentRow {
        path: c.path.clone(),
        state: c.state.clone(),
        health: c.health.clone(),
        fault: c.fault.clone(),
        ..ComponentRow::default()
    };
    let s = &c.stats;
    if !c.is_measured {
        return row;
    }
    let row = ComponentRow {
        load: Some(s.load),
        lateness_p50_ns: s.lateness_p50_ns,
        lateness_p99_ns: s.lateness_p99_ns,
        skipped: Some(s.skipped),
        overruns: Some(s.overruns),
        ..row
    };
    let old = before.components.iter().find(|o| o.path == c.path);
    let old = match old {
        // The counts of a component's whole life are no interval.
        Some(old) if !old.is_measured && !is_anew(before, now, &c.path) => return row,
        Some(old) if is_anew(before, now, &c.path) || old.stats.executed > s.executed => None,
        old => old,
    };
    let old = old.map(|o| o.stats.clone()).unwrap_or_default();
    ComponentRow {
        rate_hz: rate(since(old.executed, s.executed), seconds),
        skipped_now: since(old.skipped, s.skipped),
        overruns_now: since(old.overruns, s.overruns),
        ..row
    }
}

fn connection(before: &SystemView, now: &SystemView, c: &ConnectionView, seconds: f64) -> ConnectionRow {
    let row = ConnectionRow {
        id: c.id,
        server: c.server.clone(),
        client: c.client.clone(),
        carrier: c.carrier.clone(),
        linked: c.not_linked().is_none(),
        ..ConnectionRow::default()
    };
    if !c.is_measured() {
        return row;
    }
    let row = ConnectionRow {
        latency_p50_ns: c.latency_p50_ns,
        latency_p99_ns: c.latency_p99_ns,
        dropped: Some(c.dropped),
        rejected: c.rejected,
        failed: c.failed,
        ..row
    };
    let anew = is_anew(before, now, &c.client) || is_anew(before, now, &c.server);
    let old = match before.connections.iter().find(|o| o.id == c.id) {
        Some(old) if !old.is_measured() && !anew => return row,
        Some(old) if anew || old.passed > c.passed => None,
        old => old,
    };
    let old = old.cloned().unwrap_or_default();
    ConnectionRow {
        rate_hz: rate(since(old.passed, c.passed), seconds),
        bytes_per_s: rate(since(old.bytes, c.bytes), seconds),
        dropped_now: since(old.dropped, c.dropped),
        rejected_now: since(old.rejected, c.rejected),
        failed_now: since(old.failed, c.failed),
        ..row
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

/// Orders the largest first, unknown figures last.
fn largest(a: Option<f64>, b: Option<f64>) -> std::cmp::Ordering {
    b.unwrap_or(-1.0).total_cmp(&a.unwrap_or(-1.0))
}

fn sum(of: Option<u64>) -> u64 {
    of.unwrap_or_default()
}

impl Figures {
    /// Sorts by this measure, the most important rows first; equals keep the order of their paths.
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
                components.sort_by(|a, b| largest(a.rate_hz, b.rate_hz));
                connections.sort_by(|a, b| largest(a.rate_hz, b.rate_hz));
            }
            Sort::Load => {
                components.sort_by(|a, b| largest(a.load, b.load));
                connections.sort_by(|a, b| largest(a.bytes_per_s, b.bytes_per_s));
            }
            Sort::Latency => {
                components.sort_by_key(|c| std::cmp::Reverse(c.lateness_p99_ns));
                connections.sort_by_key(|c| std::cmp::Reverse(c.latency_p99_ns));
            }
            Sort::Drops => {
                components
                    .sort_by_key(|c| std::cmp::Reverse((c.skipped_now, sum(c.skipped) + sum(c.overruns))));
                connections.sort_by_key(|c| std::cmp::Reverse((c.dropped_now, sum(c.dropped))));
            }
        }
    }

    /// Three tables; those without rows are left out.
    pub(crate) fn render(&self, colour: bool) -> String {
        self.render_in(usize::MAX, colour)
    }

    /// Renders the rows in so many columns; the last ones are left out where they do not fit.
    pub(crate) fn render_in(&self, columns: usize, colour: bool) -> String {
        let parts = [self.process_table(), self.component_table(), self.connection_table()];
        let shown: Vec<String> = parts
            .into_iter()
            .filter(|t| !t.is_empty())
            .map(|t| t.within(columns).render(0, colour))
            .collect();
        shown.join("\n")
    }

    fn process_table(&self) -> Table {
        let mut heads =
            vec!["PROCESS", "STATE", "PID", "EPOCH", "RESTARTS", "COMPONENTS", "LOAD", "LAST EXIT"];
        let warned = self.processes.iter().any(|p| !p.warnings.is_empty());
        heads.extend(warned.then_some("WARNINGS"));
        let mut table = Table::new(&heads);
        for p in &self.processes {
            let cells = [
                plain(p.name.clone()),
                (p.state.clone(), style::of_state(&p.state)),
                plain(p.pid.to_string()),
                plain(p.epoch.to_string()),
                plain(p.restarts.to_string()),
                plain(p.components.to_string()),
                plain(units::percent(p.load)),
                plain(units::cut(&p.last_exit, 60)),
            ];
            let warnings = warned.then(|| (p.warnings.join("; "), style::WARN));
            table.styled(cells.into_iter().chain(warnings));
        }
        table
    }

    fn component_table(&self) -> Table {
        let mut heads =
            vec!["COMPONENT", "STATE", "HEALTH", "RATE", "LOAD", "LATE p50", "p99", "SKIPPED", "OVERRUNS"];
        let faults = self.components.iter().any(|c| !c.fault.is_empty());
        heads.extend(faults.then_some("FAULT"));
        let mut table = Table::new(&heads);
        for c in &self.components {
            let cells = [
                plain(c.path.clone()),
                (c.state.clone(), style::of_state(&c.state)),
                (c.health.clone(), style::of_state(&c.health)),
                known(c.rate_hz, units::rate),
                known(c.load, units::percent),
                plain(units::measured(c.lateness_p50_ns)),
                plain(units::measured(c.lateness_p99_ns)),
                grown(c.skipped, c.skipped_now),
                grown(c.overruns, c.overruns_now),
            ];
            let fault = faults.then(|| plain(units::cut(&c.fault, 60)));
            table.styled(cells.into_iter().chain(fault));
        }
        table
    }

    fn connection_table(&self) -> Table {
        let mut heads = vec!["CONNECTION", "CARRIER", "RATE", "BYTES", "LATENCY p50", "p99", "DROPPED"];
        let any = |figure: fn(&ConnectionRow) -> u64| self.connections.iter().any(|c| figure(c) > 0);
        let (rejected, failed) = (any(|c| c.rejected), any(|c| c.failed));
        heads.extend(rejected.then_some("REJECTED"));
        heads.extend(failed.then_some("FAILED"));
        let mut table = Table::new(&heads);
        for c in &self.connections {
            let cells = [
                plain(format!("{} {} → {}", c.id, c.server, c.client)),
                match (c.linked, c.carrier.as_str()) {
                    (false, _) => ("not linked".to_owned(), style::WARN),
                    (true, "") => plain("-".to_owned()),
                    (true, carrier) => plain(carrier.to_owned()),
                },
                known(c.rate_hz, units::rate),
                known(c.bytes_per_s, units::bytes_per_s),
                plain(units::measured(c.latency_p50_ns)),
                plain(units::measured(c.latency_p99_ns)),
                grown(c.dropped, c.dropped_now),
            ];
            let more = [
                rejected.then(|| grown(Some(c.rejected), c.rejected_now)),
                failed.then(|| grown(Some(c.failed), c.failed_now)),
            ];
            table.styled(cells.into_iter().chain(more.into_iter().flatten()));
        }
        table
    }
}

fn plain(text: String) -> (String, anstyle::Style) {
    (text, style::PLAIN)
}

/// Formats a figure, or that it is not known.
fn known(figure: Option<f64>, text: fn(f64) -> String) -> (String, anstyle::Style) {
    plain(figure.map_or_else(|| "-".to_owned(), text))
}

/// A sum, and what came to it now.
fn grown(sum: Option<u64>, now: u64) -> (String, anstyle::Style) {
    match sum {
        None => plain("-".to_owned()),
        Some(sum) if now == 0 => plain(sum.to_string()),
        Some(sum) => (format!("{sum} (+{now})"), style::WARN),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{ProcessView, StatsView};

    fn system(executed: u64, passed: u64, dropped: u64) -> SystemView {
        let component = |path: &str, executed: u64| ComponentView {
            path: path.into(),
            state: "ACTIVE".into(),
            health: "OK".into(),
            stats: StatsView { executed, load: 0.25, ..StatsView::default() },
            is_measured: true,
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
                carrier: "heap".into(),
                client: "left/b/in".into(),
                server: "left/a/out".into(),
                ..ConnectionView::default()
            }],
            ..SystemView::default()
        }
    }

    #[test]
    fn rates_are_what_came_between_over_the_time_between() {
        let f = between(&system(1000, 100, 3), &system(3000, 200, 5), 2.0);
        assert_eq!((f.components[0].rate_hz, f.components[1].rate_hz), (Some(1000.0), Some(2000.0)));
        let c = &f.connections[0];
        assert_eq!((c.rate_hz, c.bytes_per_s), (Some(50.0), Some(400.0)));
        assert_eq!((c.dropped, c.dropped_now), (Some(5), 2));
        assert_eq!((f.processes[0].components, f.processes[0].load), (2, 0.5));
    }

    #[test]
    fn what_was_made_anew_counts_from_zero() {
        let f = between(&system(5000, 900, 3), &system(10, 4, 1), 1.0);
        assert_eq!((f.components[0].rate_hz, f.connections[0].rate_hz), (Some(10.0), Some(4.0)));
        assert_eq!(f.connections[0].dropped_now, 1);
        let fresh = between(&SystemView::default(), &system(10, 4, 1), 1.0);
        assert_eq!(fresh.components[0].rate_hz, Some(10.0), "it was not there before");
        // More of them than the one before had counted.
        let mut next = system(9000, 2000, 9);
        next.processes[0].epoch = 2;
        let f = between(&system(5000, 900, 3), &next, 1.0);
        assert_eq!((f.components[0].rate_hz, f.connections[0].rate_hz), (Some(9000.0), Some(2000.0)));
        assert_eq!(f.connections[0].dropped_now, 9);
    }

    #[test]
    fn what_nobody_measured_is_unknown_and_so_is_what_came_since() {
        let (known, mut unknown) = (system(1_000_000, 5000, 3), system(0, 0, 0));
        unknown.components.iter_mut().for_each(|c| c.is_measured = false);
        unknown.connections.iter_mut().for_each(|c| c.carrier.clear());
        let lost = between(&known, &unknown, 1.0);
        assert_eq!((lost.components[0].rate_hz, lost.components[0].load), (None, None));
        assert_eq!((lost.connections[0].rate_hz, lost.connections[0].dropped), (None, None));
        let text = lost.render(false);
        assert!(!text.contains("0 Hz") && !text.contains("0 B/s"), "{text}");
        let back = between(&unknown, &known, 1.0);
        assert_eq!((back.components[0].rate_hz, back.components[0].load), (None, Some(0.25)));
        assert_eq!((back.connections[0].rate_hz, back.connections[0].dropped), (None, Some(3)));
        assert_eq!((back.connections[0].dropped_now, back.components[0].skipped_now), (0, 0));
    }

    #[test]
    fn faults_and_commands_that_went_wrong_have_columns_where_there_are_some() {
        let well = between(&system(1, 1, 0), &system(2, 2, 0), 1.0).render(false);
        assert!(!well.contains("FAULT") && !well.contains("REJECTED") && !well.contains("FAILED"), "{well}");
        let mut ill = system(2, 2, 0);
        ill.components[0].fault = "chaos in step".into();
        (ill.connections[0].rejected, ill.connections[0].failed) = (7, 4);
        let text = between(&system(1, 1, 0), &ill, 1.0).render(false);
        for part in ["FAULT", "chaos in step", "REJECTED", "7 (+7)", "FAILED", "4 (+4)"] {
            assert!(text.contains(part), "no {part} in\n{text}");
        }
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
