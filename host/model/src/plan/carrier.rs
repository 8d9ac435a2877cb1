//! Tells which carriers a connection can have where its ends run.
//!
//! Invariant: a connection gets the carrier that was asked for, or the request is refused with those there
//! are; a change of threads is judged as a new connection is.

use super::circle::is_stream;
use super::host_of;
use crate::refusal::brief;
use crate::{ComponentId, Connection, ExecutionModel, Refusal, SystemGraph};

const KNOWN: [&str; 4] = ["inline", "heap", "memfd", "net"];

/// Refuses a carrier the connection was pinned to and cannot have; `what` was asked.
pub(super) fn check(graph: &SystemGraph, what: &str, connection: &Connection) -> Result<(), Refusal> {
    let asked = connection.options.carrier.as_str();
    if asked.is_empty() {
        return Ok(());
    }
    let bad = |why: String| {
        let (what, field) = (format!("{what} {}", connection.client), "options.carrier".to_owned());
        Err(Refusal::ArgumentInvalid { what, why: format!("carrier: {why}"), field })
    };
    let list = |names: &[&str]| names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
    if !KNOWN.contains(&asked) {
        return bad(format!("\"{}\" is none of {}", brief(asked), list(&KNOWN)));
    }
    let (possible, why) = possible(graph, connection);
    if possible.contains(&asked) {
        return Ok(());
    }
    bad(format!("\"{asked}\" cannot be had here, as {why}: possible is {}", list(possible)))
}

/// Returns the possible carriers, the best one first, and why there are no others.
fn possible(graph: &SystemGraph, c: &Connection) -> (&'static [&'static str], String) {
    let (client, server) = (&c.client.component, &c.server.component);
    if !c.is_near() {
        let why = format!("the ends are in two processes, {} and {}", server.process, client.process);
        return (&["memfd", "net"], why);
    }
    let stream = is_stream(graph, c);
    let passive =
        graph.components.get(server).is_some_and(|s| s.execution.model == Some(ExecutionModel::None));
    let one_thread = thread_of(graph, client) == thread_of(graph, server);
    match (stream, one_thread || passive) {
        (true, true) => {
            (&["inline", "heap", "memfd"], format!("both ends are in process {}", client.process))
        }
        (false, true) => {
            let why = if one_thread {
                format!("{server} and {client} share a thread, in which commands are called directly")
            } else {
                format!("{server} is passive, so it is called in its clients' threads")
            };
            (&["inline"], why)
        }
        (_, false) => {
            let why =
                format!("{server} and {client} have threads of their own in process {}", client.process);
            (&["heap", "memfd"], why)
        }
    }
}

/// Returns the component that owns the thread.
fn thread_of(graph: &SystemGraph, id: &ComponentId) -> ComponentId {
    let mut at = id.clone();
    for _ in 0..graph.components.len() {
        let Some(host) = graph.components.get(&at).and_then(|c| host_of(&c.execution)) else { break };
        at = host;
    }
    at
}
