//! The place in its period at which each component on a grid steps, so that a reader takes what its writer
//! has just written: sources first, each reader behind the components that feed it.
//!
//! Invariant: pure, and the same for the same graph. A phase that was asked for is kept. Between two
//! components of one period the reader steps at least the writer's step and a margin behind it, modulo the
//! period, and a margin before the writer's next step; where that cannot be, it is said.

use std::collections::{BTreeMap, BTreeSet};

use crate::plan::{host_of, is_stream};
use crate::{ComponentId, Connection, ExecutionModel, SystemGraph};

/// The margin for a thread that is late, in eighths of the period, and the longest one, ns. With an eighth
/// for the step the reader stands in the middle: either may be late by as much.
const MARGIN_EIGHTHS: u64 = 3;
const MARGIN_NS: u64 = 1_000_000;
/// Time kept for a step that was not measured: this part of the period, and at most so many ns.
const UNKNOWN_PART: u64 = 8;
const UNKNOWN_NS: u64 = 500_000;

/// Time a step takes at most but for rare ones, by component, ns; nothing for one that was not measured yet.
pub type StepTimes = BTreeMap<ComponentId, u64>;

/// The place of a component in its period.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Phase {
    /// Behind each multiple of the period on the monotonic clock, ns.
    pub phase_ns: u64,
    /// The reason why it does not fit, in a sentence; empty: samples arrive in the period in which they are
    /// written.
    pub note: String,
}

/// Returns the phases of all components that have a thread on a grid and were given no phase.
pub fn phases(graph: &SystemGraph, steps: &StepTimes) -> BTreeMap<ComponentId, Phase> {
    let wheels = wheels(graph, steps);
    let edges = edges(graph, &wheels);
    let circles = groups(wheels, &edges).into_iter().map(|wheels| {
        let edges = edges.iter().filter(|edge| wheels.contains_key(&edge.from)).collect();
        Circle::new(wheels, edges)
    });
    circles.flat_map(|circle| circle.fit()).collect()
}

/// Tells whether any phase depends on what steps take: samples pass between threads of one period, and one of
/// them was given no phase.
pub fn steps_matter(graph: &SystemGraph) -> bool {
    let wheels = wheels(graph, &StepTimes::new());
    let auto = |id: &ComponentId| wheels.get(id).is_some_and(|wheel| wheel.fixed_ns.is_none());
    edges(graph, &wheels).iter().any(|edge| auto(&edge.from) || auto(&edge.to))
}

/// A thread on a grid.
#[derive(Clone)]
struct Wheel {
    period_ns: u64,
    /// Phase that was asked for.
    fixed_ns: Option<u64>,
    /// Time kept for its step, ns.
    step_ns: u64,
}

/// Samples between two threads of one period.
struct Edge {
    from: ComponentId,
    to: ComponentId,
    /// The reader need not step behind the writer: the connection says `delay`, or closes a circle.
    cut: bool,
}

type Wheels = BTreeMap<ComponentId, Wheel>;

fn wheels(graph: &SystemGraph, steps: &StepTimes) -> Wheels {
    let mut measured: BTreeMap<ComponentId, u64> = BTreeMap::new();
    for (id, step_ns) in steps {
        if let Some(head) = head(graph, id) {
            *measured.entry(head).or_default() += step_ns;
        }
    }
    let heads = graph.components.iter().filter_map(|(id, component)| {
        let execution = &component.execution;
        let own = host_of(execution).is_none() && execution.model.is_some_and(ExecutionModel::has_grid);
        let period_ns = execution.period_ns.filter(|ns| own && *ns > 0)?;
        let step_ns = room(measured.get(id).copied().unwrap_or(0), period_ns);
        let fixed_ns = execution.phase_ns.map(|ns| ns % period_ns);
        Some((id.clone(), Wheel { period_ns, fixed_ns, step_ns }))
    });
    heads.collect()
}

/// Returns the time kept for a step that takes this long: doubled until it is enough, so that a wavering
/// figure moves nothing.
fn room(step_ns: u64, period_ns: u64) -> u64 {
    let mut room = (period_ns / UNKNOWN_PART).min(UNKNOWN_NS);
    while room < step_ns.min(period_ns) {
        room = (room * 2).max(1);
    }
    room.min(period_ns)
}

/// Returns the component whose thread runs this one.
fn head(graph: &SystemGraph, id: &ComponentId) -> Option<ComponentId> {
    let mut at = id.clone();
    // The graph holds no circle, but a walk that trusts no input ends anyway.
    for _ in 0..=graph.components.len() {
        match host_of(&graph.components.get(&at)?.execution) {
            Some(host) => at = host,
            None => return Some(at),
        }
    }
    None
}

fn edges(graph: &SystemGraph, wheels: &Wheels) -> Vec<Edge> {
    let ends = |c: &Connection| {
        let [from, to] = [&c.server, &c.client].map(|end| head(graph, &end.component));
        let (from, to) = (from?, to?);
        let one_grid = wheels.get(&from)?.period_ns == wheels.get(&to)?.period_ns;
        (one_grid && from != to && is_stream(graph, c)).then_some((from, to))
    };
    let mut behind: BTreeMap<ComponentId, BTreeSet<ComponentId>> = BTreeMap::new();
    let mut edges = Vec::new();
    // By number: it is the newest connection that closes a circle.
    for connection in graph.connections.values() {
        let Some((from, to)) = ends(connection) else { continue };
        let cut = connection.options.delay || leads(&behind, &to, &from);
        if !cut {
            behind.entry(from.clone()).or_default().insert(to.clone());
        }
        edges.push(Edge { from, to, cut });
    }
    edges
}

/// Tells whether a way leads from `from` to `to`.
fn leads(
    behind: &BTreeMap<ComponentId, BTreeSet<ComponentId>>,
    from: &ComponentId,
    to: &ComponentId,
) -> bool {
    let (mut seen, mut next) = (BTreeSet::from([from]), vec![from]);
    while let Some(at) = next.pop() {
        if at == to {
            return true;
        }
        next.extend(behind.get(at).into_iter().flatten().filter(|id| seen.insert(*id)));
    }
    false
}

/// Orders each thread behind all that feed it, without the cut edges; in the order of their names where that
/// leaves a choice.
fn sources_first(
    wheels: &Wheels,
    into: &BTreeMap<&ComponentId, Vec<&Edge>>,
    out_of: &BTreeMap<&ComponentId, Vec<&Edge>>,
) -> Vec<ComponentId> {
    let feeders = |id: &ComponentId| into.get(id).into_iter().flatten().filter(|e| !e.cut).count();
    let mut waits: BTreeMap<&ComponentId, usize> = wheels.keys().map(|id| (id, feeders(id))).collect();
    let mut ready: BTreeSet<&ComponentId> =
        waits.iter().filter(|(_, n)| **n == 0).map(|(id, _)| *id).collect();
    let mut order = Vec::with_capacity(wheels.len());
    // A rest without a first thread would be a circle, and circles are cut.
    while let Some(id) = ready.pop_first().or_else(|| waits.keys().next().copied()) {
        if waits.remove(id).is_none() {
            continue;
        }
        order.push(id.clone());
        for edge in out_of.get(id).into_iter().flatten().filter(|e| !e.cut) {
            if let Some(left) = waits.get_mut(&edge.to) {
                *left -= 1;
                if *left == 0 {
                    ready.insert(&edge.to);
                }
            }
        }
    }
    order
}

/// Splits the threads into groups that are connected, directly or through others.
fn groups(mut all: Wheels, edges: &[Edge]) -> Vec<Wheels> {
    let mut beside: BTreeMap<&ComponentId, Vec<&ComponentId>> = BTreeMap::new();
    for edge in edges {
        beside.entry(&edge.from).or_default().push(&edge.to);
        beside.entry(&edge.to).or_default().push(&edge.from);
    }
    let mut groups = Vec::new();
    while let Some((id, wheel)) = all.pop_first() {
        let (mut group, mut next) = (Wheels::new(), vec![id.clone()]);
        group.insert(id, wheel);
        while let Some(at) = next.pop() {
            for other in beside.get(&at).into_iter().flatten() {
                if let Some((id, wheel)) = all.remove_entry(*other) {
                    next.push(id.clone());
                    group.insert(id, wheel);
                }
            }
        }
        groups.push(group);
    }
    groups
}

/// Connected threads of one period, round which their phases lie.
struct Circle<'a> {
    period_ns: u64,
    wheels: Wheels,
    edges: Vec<&'a Edge>,
    /// Edges by the end they have at each thread.
    into: BTreeMap<&'a ComponentId, Vec<&'a Edge>>,
    out_of: BTreeMap<&'a ComponentId, Vec<&'a Edge>>,
    /// Sources first.
    order: Vec<ComponentId>,
}

/// A way to lay the phases.
#[derive(Default)]
struct Layout {
    at: BTreeMap<ComponentId, Place>,
    tight: BTreeSet<ComponentId>,
}

/// The place at which a thread steps.
#[derive(Clone, Copy, Default)]
struct Place {
    /// Counted on over whole periods, ns.
    at_ns: u64,
    /// The place of the first of its chain, ns.
    first_ns: u64,
}

impl Layout {
    fn at(&self, id: &ComponentId) -> Option<u64> {
        self.at.get(id).map(|place| place.at_ns)
    }

    /// Time from the step of the first of its chain to its own, ns.
    fn behind(&self, id: &ComponentId) -> u64 {
        self.at.get(id).map_or(0, |place| place.at_ns - place.first_ns)
    }
}

impl<'a> Circle<'a> {
    fn new(wheels: Wheels, edges: Vec<&'a Edge>) -> Circle<'a> {
        let period_ns = wheels.values().map(|wheel| wheel.period_ns).min().unwrap_or(1);
        let (mut into, mut out_of) = (BTreeMap::new(), BTreeMap::new());
        for edge in &edges {
            into.entry(&edge.to).or_insert_with(Vec::new).push(*edge);
            out_of.entry(&edge.from).or_insert_with(Vec::new).push(*edge);
        }
        let order = sources_first(&wheels, &into, &out_of);
        Circle { period_ns, wheels, edges, into, out_of, order }
    }

    /// Uses the longest margin with which all fit into one period; else one with which they fit round it.
    fn fit(&self) -> BTreeMap<ComponentId, Phase> {
        let margin_ns = (self.period_ns / 8 * MARGIN_EIGHTHS).min(MARGIN_NS);
        let lay = |part| self.lay(margin_ns / part);
        let within = |layout: &Layout| layout.at.keys().all(|id| layout.behind(id) < self.period_ns);
        let fits = |layout: &Layout| layout.tight.is_empty();
        let mut laid: Vec<Layout> = [1, 2].map(lay).into();
        let best = laid.iter().position(|l| fits(l) && within(l)).or_else(|| laid.iter().position(fits));
        let layout = match best {
            Some(best) => laid.swap_remove(best),
            None => [4, 8].into_iter().map(lay).find(fits).unwrap_or_else(|| laid.swap_remove(0)),
        };
        let auto = self.wheels.iter().filter(|(_, wheel)| wheel.fixed_ns.is_none());
        auto.map(|(id, _)| {
            let at = layout.at(id).unwrap_or(0);
            let note = self.note(&layout, id);
            (id.clone(), Phase { phase_ns: at % self.period_ns, note })
        })
        .collect()
    }

    fn note(&self, layout: &Layout, id: &ComponentId) -> String {
        if layout.tight.contains(id) {
            return "its period has no room for the steps of what feeds it, its own and those of what it feeds: samples \
                between them may be left out; give it a lower rate, or set phases yourself (phase)"
                .to_owned();
        }
        match layout.behind(id) / self.period_ns {
            0 => String::new(),
            1 => "the steps before it take longer than a period together: it takes samples one period later"
                .to_owned(),
            n => format!(
                "the steps before it take longer than {n} periods together: it takes samples {n} periods later"
            ),
        }
    }

    /// Lays the phases, sources first, each at the earliest place that is right for all its neighbours that
    /// have one.
    fn lay(&self, margin_ns: u64) -> Layout {
        let mut layout = Layout::default();
        for (id, wheel) in &self.wheels {
            layout.at.extend(wheel.fixed_ns.map(|ns| (id.clone(), Place { at_ns: ns, first_ns: ns })));
        }
        for id in &self.order {
            if self.wheels.get(id).is_some_and(|wheel| wheel.fixed_ns.is_none()) {
                let place = self.place(&layout, id, margin_ns);
                layout.at.insert(id.clone(), place);
            }
        }
        let asked = |id: &ComponentId| self.wheels.get(id).is_none_or(|wheel| wheel.fixed_ns.is_some());
        let tight = self.edges.iter().filter(|e| !self.arrives(&layout, e, margin_ns));
        // A pair of phases that were both asked for is kept as it is.
        let tight = tight.filter(|e| !(asked(&e.from) && asked(&e.to)));
        layout.tight = tight.flat_map(|e| [e.from.clone(), e.to.clone()]).collect();
        layout
    }

    /// Returns the earliest place behind all that feed it that leaves each neighbour its room, or the
    /// earliest one there is.
    fn place(&self, layout: &Layout, id: &ComponentId, margin_ns: u64) -> Place {
        let step = |id: &ComponentId| self.wheels.get(id).map_or(0, |wheel| wheel.step_ns);
        let feeds = self.into.get(id).into_iter().flatten();
        let last = feeds.clone().filter(|e| !e.cut).filter_map(|e| {
            let place = layout.at.get(&e.from)?;
            Some((place.at_ns + step(&e.from) + margin_ns, Some(place.first_ns)))
        });
        let (earliest, first) = last.max().unwrap_or((0, None));
        // Arcs that belong to other threads, as (begin, length) on the circle.
        let before = feeds.filter_map(|e| {
            let at = layout.at(&e.from)?;
            Some((self.on(at, margin_ns), 2 * margin_ns + step(&e.from)))
        });
        let behind = self.out_of.get(id).into_iter().flatten().filter_map(|e| {
            let at = layout.at(&e.to)?;
            Some((self.on(at, margin_ns + step(id)), 2 * margin_ns + step(id)))
        });
        let arcs: Vec<(u64, u64)> = before.chain(behind).collect();
        let free = |at: u64| {
            arcs.iter().all(|(begin, length)| {
                let into = self.on(at, *begin);
                into == 0 || into >= *length
            })
        };
        let ends = arcs.iter().map(|(begin, length)| earliest + self.on(begin + length, earliest));
        let mut places: Vec<u64> = ends.chain([earliest]).collect();
        places.sort_unstable();
        let at_ns = places.into_iter().find(|at| free(*at)).unwrap_or(earliest);
        Place { at_ns, first_ns: first.unwrap_or(at_ns) }
    }

    /// Distance from `from` on to `at` on the circle.
    fn on(&self, at: u64, from: u64) -> u64 {
        (at % self.period_ns + self.period_ns - from % self.period_ns) % self.period_ns
    }

    /// Tells whether the samples of this edge are taken in each period: read behind the step that writes
    /// them, and before the next one.
    fn arrives(&self, layout: &Layout, edge: &Edge, margin_ns: u64) -> bool {
        let (Some(from), Some(to)) = (layout.at(&edge.from), layout.at(&edge.to)) else {
            return true;
        };
        let (Some(writer), Some(_)) = (self.wheels.get(&edge.from), self.wheels.get(&edge.to)) else {
            return true;
        };
        let behind = self.on(to, from);
        behind >= writer.step_ns + margin_ns && behind + margin_ns <= self.period_ns
    }
}
