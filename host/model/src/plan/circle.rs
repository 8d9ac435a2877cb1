//! Circles of direct calls, and of components that would have to run before each other.
//!
//! Invariant: a connection is judged by where its ends run, so a change of threads is judged by the same
//! functions as a new connection.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::{ComponentId, Connection, ExecutionModel, Link, Refusal, SystemGraph};

/// Refuses `new` when it closes a circle of direct calls. A wire that it replaces need not be left out: it
/// leaves or enters the very component where the circle would close, so no shortest way uses it.
pub(super) fn check_circle(graph: &SystemGraph, new: &Connection, link: &Link) -> Result<(), Refusal> {
    let stream = matches!(link, Link::Stream { .. });
    let Some((caller, called)) = direct(graph, new, stream) else { return Ok(()) };
    circles(&calls(graph), &caller, &called)?;
    if stream { circles(&order(graph), &caller, &called) } else { Ok(()) }
}

/// Refuses a graph in which a circle of direct calls is closed, as a change of threads may do.
pub(super) fn check_circles(graph: &SystemGraph) -> Result<(), Refusal> {
    for edges in [calls(graph), order(graph)] {
        for (caller, all) in &edges {
            for called in all {
                circles(&edges, caller, called)?;
            }
        }
    }
    Ok(())
}

type Edges = BTreeMap<ComponentId, BTreeSet<ComponentId>>;

/// Returns the calls within one thread: caller to callee.
fn calls(graph: &SystemGraph) -> Edges {
    let mut edges = Edges::new();
    for connection in graph.connections.values() {
        if let Some((from, to)) = direct(graph, connection, is_stream(graph, connection)) {
            edges.entry(from).or_default().insert(to);
        }
    }
    edges
}

/// Returns the order within one cycle, first to next: along the direct streams, exec_in before and exec_out
/// after the one they run inside.
fn order(graph: &SystemGraph) -> Edges {
    let mut edges = Edges::new();
    for connection in graph.connections.values().filter(|c| is_stream(graph, c)) {
        if let Some((from, to)) = direct(graph, connection, true) {
            edges.entry(from).or_default().insert(to);
        }
    }
    for (id, component) in &graph.components {
        let inside = component.execution.inside.as_deref().and_then(|host| ComponentId::parse(host).ok());
        match (component.execution.model, inside) {
            (Some(ExecutionModel::ExecIn), Some(host)) => edges.entry(id.clone()).or_default().insert(host),
            (Some(ExecutionModel::ExecOut), Some(host)) => edges.entry(host).or_default().insert(id.clone()),
            _ => false,
        };
    }
    edges
}

pub(crate) fn is_stream(graph: &SystemGraph, c: &Connection) -> bool {
    let client = graph.components.get(&c.client.component);
    client.is_some_and(|client| client.ports.inputs.iter().any(|i| c.client.port == i.name.as_str()))
}

/// Refuses the edge from `caller` to `called` when `edges` lead back.
fn circles(edges: &Edges, caller: &ComponentId, called: &ComponentId) -> Result<(), Refusal> {
    // Breadth first from the called one back to the caller; `came` is also the set of the visited.
    let mut came: BTreeMap<&ComponentId, Option<&ComponentId>> = BTreeMap::from([(called, None)]);
    let mut queue = VecDeque::from([called]);
    while let Some(at) = queue.pop_front() {
        if at == caller {
            let mut path = vec![at.clone()];
            let mut step = came.get(at).copied().flatten();
            while let Some(id) = step {
                step = came.get(id).copied().flatten();
                path.push(id.clone());
            }
            path.push(caller.clone());
            path.reverse();
            return Err(Refusal::SyncCycle { path });
        }
        for next in edges.get(at).into_iter().flatten() {
            if !came.contains_key(next) {
                came.insert(next, Some(at));
                queue.push_back(next);
            }
        }
    }
    Ok(())
}

/// Returns caller and callee in one thread through this connection: pinned inline, or a stream within one
/// chain that is not pinned to a queue.
fn direct(graph: &SystemGraph, c: &Connection, stream: bool) -> Option<(ComponentId, ComponentId)> {
    let (client, server) = (&c.client.component, &c.server.component);
    let chained = || stream && head(graph, client).is_some_and(|h| Some(h) == head(graph, server));
    match c.options.carrier.as_str() {
        "heap" | "memfd" => None,
        "inline" if !stream => Some((client.clone(), server.clone())),
        "inline" => Some((server.clone(), client.clone())),
        _ => chained().then(|| (server.clone(), client.clone())),
    }
}

/// The head of the stream chain in which a component runs; a head that was removed still holds its chain
/// together, since it may be made again.
fn head(graph: &SystemGraph, id: &ComponentId) -> Option<ComponentId> {
    let mut at = id.clone();
    for _ in 0..=graph.components.len() {
        let Some(component) = graph.components.get(&at) else { return Some(at) };
        match &component.execution.stream_of {
            Some(above) => at = ComponentId::parse(above).ok()?,
            None => return (component.execution.model == Some(ExecutionModel::Stream)).then_some(at),
        }
    }
    None
}
