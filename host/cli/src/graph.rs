//! `trocar graph`: the system as text, Mermaid, Graphviz or JSON.
//!
//! Invariant: pure functions of one `SystemView`; arrows point the way the data or the call's answer flows,
//! server → client.

use std::fmt::Write as _;

use clap::Args;

use super::failure::{Done, Exit};
use super::out;
use super::session::Session;
use super::view::{ComponentView, ConnectionView, SystemView};

/// Shows components and connections as a graph.
#[derive(Args, Debug)]
pub(super) struct GraphArgs {
    /// Mermaid text, for Markdown files.
    #[arg(long, conflicts_with = "dot")]
    mermaid: bool,
    /// Graphviz text: `trocar graph --dot | dot -Tsvg > graph.svg`.
    #[arg(long)]
    dot: bool,
}

pub(super) async fn run(args: GraphArgs, session: &Session) -> Done {
    let view = session.list().await?;
    let text = match (session.json(), args.mermaid, args.dot) {
        (true, ..) => return session.print_json(&view),
        (_, true, _) => mermaid(&view),
        (_, _, true) => dot(&view),
        _ => plain(&view),
    };
    out::text(&text);
    Ok(Exit::Ok)
}

fn plain(view: &SystemView) -> String {
    let mut text = String::new();
    for process in &view.processes {
        let _ = writeln!(text, "{} ({})", process.name, process.state.to_lowercase());
        for component in in_process(view, &process.name) {
            let _ = writeln!(
                text,
                "  {}  {}  {}  {}",
                component.path,
                component.class,
                component.state,
                component.rate()
            );
            for c in view.connections.iter().filter(|c| c.server_component() == component.path) {
                let _ = writeln!(text, "    {} → {}{}", c.server, c.client, between(c));
            }
        }
    }
    text
}

/// Describes the carrier of a connection between processes, or why there is none.
fn between(c: &ConnectionView) -> String {
    match c.not_linked() {
        _ if c.proxies.is_empty() => String::new(),
        Some(why) => format!("  not linked: {}", out::harmless(why)),
        None => format!("  {}", c.carrier),
    }
}

fn mermaid(view: &SystemView) -> String {
    let mut text = "flowchart LR\n".to_owned();
    for process in &view.processes {
        let _ = writeln!(text, "  subgraph {}[\"{}\"]", id(&process.name), process.name);
        for c in in_process(view, &process.name) {
            let _ =
                writeln!(text, "    {}[\"{}<br/>{}<br/>{}\"]", id(&c.path), short(&c.path), c.class, c.state);
        }
        text.push_str("  end\n");
    }
    for c in &view.connections {
        let (from, to) = (id(c.server_component()), id(c.client_component()));
        let arrow = if c.not_linked().is_some() { "-.->" } else { "-->" };
        let _ = writeln!(text, "  {from} {arrow}|\"{}\"| {to}", c.ports());
    }
    text
}

fn dot(view: &SystemView) -> String {
    let mut text =
        "digraph trocar {\n  rankdir=LR;\n  node [shape=box, fontname=\"sans-serif\"];\n".to_owned();
    for process in &view.processes {
        let _ = writeln!(text, "  subgraph \"cluster_{0}\" {{\n    label=\"{0}\";", process.name);
        for c in in_process(view, &process.name) {
            let _ = writeln!(
                text,
                "    \"{}\" [label=\"{}\\n{}\\n{}\"];",
                c.path,
                short(&c.path),
                c.class,
                c.state
            );
        }
        text.push_str("  }\n");
    }
    for c in &view.connections {
        let (from, to) = (c.server_component(), c.client_component());
        let style = if c.not_linked().is_some() { ", style=dashed" } else { "" };
        let _ = writeln!(text, "  \"{from}\" -> \"{to}\" [label=\"{}\"{style}];", c.ports());
    }
    text.push_str("}\n");
    text
}

fn in_process<'v>(view: &'v SystemView, process: &'v str) -> impl Iterator<Item = &'v ComponentView> {
    view.components.iter().filter(move |c| c.path.split('/').next() == Some(process))
}

/// Returns a Mermaid id. Such ids hold letters, digits and underscores only; other characters become their
/// code, so that ids stay distinct.
fn id(path: &str) -> String {
    let mut id = "n_".to_owned();
    for c in path.chars() {
        match c {
            'a'..='z' | 'A'..='Z' | '0'..='9' => id.push(c),
            '/' => id.push_str("__"),
            other => {
                let _ = write!(id, "_{:x}_", u32::from(other));
            }
        }
    }
    id
}

fn short(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

#[cfg(test)]
mod tests {
    use super::super::view::ProcessView;
    use super::*;

    fn view() -> SystemView {
        let component = |path: &str, class: &str| ComponentView {
            path: path.to_owned(),
            class: class.to_owned(),
            state: "ACTIVE".to_owned(),
            ..ComponentView::default()
        };
        SystemView {
            revision: 3,
            processes: vec![ProcessView {
                name: "host".into(),
                state: "ATTACHED".into(),
                ..ProcessView::default()
            }],
            components: vec![component("host/robot", "eyerobot"), component("host/mo-ver", "joint_mover")],
            connections: vec![ConnectionView {
                id: 1,
                client: "host/mo-ver/robot".into(),
                server: "host/robot/arm".into(),
                ..ConnectionView::default()
            }],
            ..SystemView::default()
        }
    }

    #[test]
    fn mermaid_shows_processes_components_and_arrows_from_server_to_client() {
        assert_eq!(
            mermaid(&view()),
            "flowchart LR\n  subgraph n_host[\"host\"]\n    n_host__robot[\"robot<br/>eyerobot<br/>ACTIVE\"]\n    \
             n_host__mo_2d_ver[\"mo-ver<br/>joint_mover<br/>ACTIVE\"]\n  end\n  \
             n_host__robot -->|\"arm → robot\"| n_host__mo_2d_ver\n"
        );
    }

    #[test]
    fn dot_names_the_same_parts() {
        let text = dot(&view());
        for part in [
            "cluster_host",
            "\"host/robot\" -> \"host/mo-ver\" [label=\"arm → robot\"]",
            "robot\\neyerobot\\nACTIVE",
        ] {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }

    #[test]
    fn plain_lists_each_connection_under_its_server() {
        let text = plain(&view());
        assert!(text.contains("    host/robot/arm → host/mo-ver/robot\n"), "{text}");
    }
}
