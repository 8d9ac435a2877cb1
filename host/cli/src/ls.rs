//! `trocar ls`: processes, components, connections and classes.
//!
//! Invariant: one question to the GCM; it answers in under 50 ms.

use std::collections::BTreeSet;

use clap::Args;

use super::failure::{Done, Exit};
use super::session::Session;
use super::table::Table;
use super::view::SystemView;
use super::{out, style, units};

/// Longest reason of a fault shown, characters.
const FAULT: usize = 60;

/// Lists processes, components and connections.
#[derive(Args, Debug)]
pub(super) struct LsArgs {
    /// Only this process, component or glob.
    #[arg(default_value = "", hide_default_value = true)]
    path: String,
    /// Also the classes that components can be made of.
    #[arg(long)]
    classes: bool,
}

pub(super) async fn run(args: LsArgs, session: &Session) -> Done {
    let view = session.list_of(&args.path).await?;
    if session.json() {
        return session.print_json(&view);
    }
    // A component or a glob does not ask for what else its process could make.
    let of_processes = !args.path.contains(['/', '*']);
    let classes = match args.classes {
        true => Classes::Listed,
        false if of_processes => Classes::Counted,
        false => Classes::LeftOut,
    };
    out::text(&render(&view, classes, style::stdout()));
    view.warnings.iter().for_each(|warning| out::complain("warning", warning));
    Ok(Exit::Ok)
}

/// The classes in a list: a hundred of them beside a demo push what runs out of sight.
#[derive(Clone, Copy, PartialEq)]
enum Classes {
    Listed,
    /// One line; listed where nothing was made of them yet.
    Counted,
    LeftOut,
}

fn render(view: &SystemView, shown: Classes, colour: bool) -> String {
    let mut text = String::new();
    let mut part = |title: &str, table: &Table| {
        if !table.is_empty() {
            let gap = if text.is_empty() { "" } else { "\n" };
            text.push_str(&format!(
                "{gap}{}\n{}",
                style::paint(title, style::HEAD, colour),
                table.render(2, colour)
            ));
        }
    };
    part("Processes", &processes(view));
    part("Components", &components(view));
    part("Connections", &connections(view));
    part("Halves between processes", &proxies(view));
    let empty = view.components.is_empty();
    if shown == Classes::Listed || shown == Classes::Counted && empty {
        part("Classes", &classes(view));
    } else if let (Classes::Counted, n @ 1..) = (shown, names(view).len()) {
        let n = units::count(n as u64, "class");
        text.push_str(&format!("\n{n} to make components of: `trocar ls --classes`\n"));
    }
    text.push_str(&format!("\nrevision {}\n", view.revision));
    text
}

fn plain(text: impl Into<String>) -> (String, anstyle::Style) {
    (text.into(), style::PLAIN)
}

fn processes(view: &SystemView) -> Table {
    let mut heads = vec!["NAME", "STATE", "PID", "EPOCH", "ENDPOINT", "RESTARTS", "LAST EXIT"];
    let warned = view.processes.iter().any(|p| !p.warnings.is_empty());
    heads.extend(warned.then_some("WARNINGS"));
    let mut table = Table::new(&heads);
    for p in &view.processes {
        let state = (p.state.clone(), style::of_state(&p.state));
        let cells = [
            plain(&p.name),
            state,
            plain(p.pid.to_string()),
            plain(p.epoch.to_string()),
            plain(p.place()),
            plain(p.restarts.to_string()),
            plain(shortened(&p.last_exit)),
        ];
        let warnings = warned.then(|| (p.warnings.join("; "), style::WARN));
        table.styled(cells.into_iter().chain(warnings));
    }
    table
}

fn components(view: &SystemView) -> Table {
    let mut table = Table::new(&[
        "PATH", "CLASS", "VERSION", "STATE", "HEALTH", "RUNS", "STEPS", "SKIPPED", "OVERRUNS", "LATE p99",
        "LOAD",
    ]);
    for c in &view.components {
        let state = if c.fault.is_empty() {
            c.state.clone()
        } else {
            format!("{}: {}", c.state, shortened(&c.fault))
        };
        let s = &c.stats;
        table.styled([
            plain(&c.path),
            plain(&c.class),
            plain(&c.plugin_version),
            (state, style::of_state(&c.state)),
            (c.health.clone(), style::of_state(&c.health)),
            plain(c.runs()),
            plain(s.executed.to_string()),
            plain(s.skipped.to_string()),
            plain(s.overruns.to_string()),
            plain(units::measured(s.lateness_p99_ns)),
            plain(units::percent(s.load)),
        ]);
    }
    table
}

/// Cuts a fault to the width of a column; `trocar describe` shows all of it.
fn shortened(fault: &str) -> String {
    match fault.char_indices().nth(FAULT) {
        None => fault.to_owned(),
        Some((end, _)) => format!("{}…", &fault[..end]),
    }
}

fn connections(view: &SystemView) -> Table {
    let mut table = Table::new(&[
        "ID",
        "SERVER",
        "CLIENT",
        "CARRIER",
        "PASSED",
        "DROPPED",
        "SKIPPED (newest only)",
        "FAILED",
        "LATENCY p50",
        "p99",
    ]);
    for c in &view.connections {
        table.row([
            c.id.to_string(),
            c.server.clone(),
            c.client.clone(),
            c.way(),
            c.passed.to_string(),
            c.dropped.to_string(),
            c.skipped.to_string(),
            c.failed.to_string(),
            units::measured(c.latency_p50_ns),
            units::measured(c.latency_p99_ns),
        ]);
    }
    table
}

/// The halves of connections between processes, as each process has them.
fn proxies(view: &SystemView) -> Table {
    let mut table = Table::new(&["PROCESS", "END", "OF", "CARRIER", "EPOCH", "LINKED"]);
    for (c, p) in view.connections.iter().flat_map(|c| c.proxies.iter().map(move |p| (c, p))) {
        let linked = if p.linked { plain("yes") } else { (shortened(&p.why_not), style::WARN) };
        table.styled([
            plain(&p.process),
            plain(p.end.to_lowercase()),
            plain(c.id.to_string()),
            plain(if p.carrier.is_empty() { "-" } else { &p.carrier }),
            plain(if p.epoch == 0 { "-".to_owned() } else { p.epoch.to_string() }),
            linked,
        ]);
    }
    table
}

/// Names of all classes, each once.
fn names(view: &SystemView) -> BTreeSet<&String> {
    view.processes.iter().flat_map(|p| &p.classes).collect()
}

fn classes(view: &SystemView) -> Table {
    let mut table = Table::new(&["CLASS", "IN"]);
    for name in names(view) {
        let holders = view.processes.iter().filter(|p| p.classes.contains(name)).map(|p| p.name.as_str());
        table.row([name.clone(), holders.collect::<Vec<_>>().join(", ")]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::view::{ComponentView, ProcessView};
    use super::*;

    #[test]
    fn a_fault_is_shown_with_its_reason_and_empty_parts_are_left_out() {
        let view = SystemView {
            revision: 7,
            processes: vec![ProcessView {
                name: "host".into(),
                classes: vec!["sine/sine".into()],
                ..ProcessView::default()
            }],
            components: vec![ComponentView {
                path: "host/s".into(),
                state: "FAULT".into(),
                fault: "panicked at src/lib.rs:3".into(),
                plugin_version: "1.2.0-rc1".into(),
                ..ComponentView::default()
            }],
            ..SystemView::default()
        };
        let text = render(&view, Classes::Listed, false);
        assert!(text.contains("FAULT: panicked at src/lib.rs:3"), "{text}");
        assert!(!text.contains("Connections"), "{text}");
        let heads: Vec<&str> =
            text.lines().filter(|line| !line.starts_with(' ') && !line.is_empty()).collect();
        assert_eq!(
            heads,
            ["Processes", "Components", "Classes", "revision 7"],
            "what there is before what could be"
        );
        let row = text.lines().find(|line| line.contains("host/s ")).unwrap_or_default();
        assert!(row.contains("1.2.0-rc1"), "{text}");
        assert!(text.ends_with("revision 7\n"), "{text}");

        let text = render(&view, Classes::Counted, false);
        assert!(!text.contains("sine/sine") && text.contains("1 class to make components of"), "{text}");
        let empty = SystemView { components: Vec::new(), ..view };
        let text = render(&empty, Classes::Counted, false);
        assert!(text.contains("sine/sine"), "there is nothing else to see: {text}");
    }

    #[test]
    fn a_long_fault_does_not_push_the_columns_behind_it_away() {
        let fault = "µ".repeat(512);
        let view = SystemView {
            components: vec![ComponentView { state: "FAULT".into(), fault, ..ComponentView::default() }],
            ..SystemView::default()
        };
        let text = render(&view, Classes::Counted, false);
        assert!(text.contains(&format!("FAULT: {}…", "µ".repeat(FAULT))), "{text}");
        assert!(text.lines().all(|line| line.chars().count() < 200), "{text}");
    }
}
