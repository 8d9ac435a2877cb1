//! Changes of each state of the graph, which its followers are told instead of the whole graph.
//!
//! Invariant: from a state that is kept, everything that is shown differently now is named; of one that is
//! not kept any more, or is another GCM's, nothing is said, and its follower needs the whole graph.

use std::collections::VecDeque;
use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;

use parking_lot::Mutex;
use trocar_model::{SystemGraph, Touched};

/// Most names that are kept, in all states together: about what a follower needs who was away for a while.
const NAMES: usize = 1 << 16;

pub(crate) struct History {
    /// Drawn by this GCM at its start: states of two GCMs cannot be compared.
    of: u64,
    states: Mutex<States>,
}

struct States {
    /// The last state before those that are kept.
    before: u64,
    /// Changes of each state, in order and without a gap.
    kept: VecDeque<Touched>,
    names: usize,
}

impl History {
    pub(super) fn beginning(seen: u64) -> History {
        let states = States { before: seen, kept: VecDeque::new(), names: 0 };
        History { of: RandomState::new().hash_one(seen), states: Mutex::new(states) }
    }

    /// Ends a state of the graph.
    pub(super) fn settle(&self, graph: &mut SystemGraph) {
        let touched = graph.settle();
        if touched.is_empty() {
            return;
        }
        let mut states = self.states.lock();
        states.names += touched.len();
        states.kept.push_back(touched);
        while states.names > NAMES {
            let Some(oldest) = states.kept.pop_front() else { break };
            states.names -= oldest.len();
            states.before += 1;
        }
    }

    /// Returns whatever is shown differently in `graph` than in an earlier state; `None`: it is not kept.
    pub(crate) fn since(&self, seen: u64, graph: &SystemGraph) -> Option<Touched> {
        let states = self.states.lock();
        let first = seen.checked_sub(states.before)?;
        let many = graph.seen.checked_sub(seen)?;
        let mut all = Touched::default();
        for touched in states.kept.iter().skip(first as usize).take(many as usize) {
            all.add(touched);
        }
        Some(all)
    }

    /// Returns a name for a state of the graph, which [`History::seen`] reads.
    pub(crate) fn cursor(&self, graph: &SystemGraph) -> String {
        format!("{:016x}-{}", self.of, graph.seen)
    }

    /// Reads a cursor. `Err`: it is none; `None`: another GCM gave it.
    pub(crate) fn seen(&self, cursor: &str) -> Result<Option<u64>, NoCursor> {
        let (of, seen) = cursor.split_once('-').ok_or(NoCursor)?;
        let of = u64::from_str_radix(of, 16).map_err(|_| NoCursor)?;
        let seen = seen.parse().map_err(|_| NoCursor)?;
        Ok((of == self.of).then_some(seen))
    }

    /// Returns a tag for a part of the graph: two are equal if nothing of it was shown differently between.
    pub(crate) fn tag(&self, part: &SystemGraph) -> String {
        let (p, c, l) = (&part.processes, &part.components, &part.connections);
        // With the newest the same, nothing was added or changed since; with their number, nothing went.
        let newest = p.newest().max(c.newest()).max(l.newest());
        format!("{:016x}-{newest}-{}", self.of, p.len() + c.len() + l.len())
    }
}

/// A text that is no cursor.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NoCursor;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::{ConnectOptions, Connection, ConnectionId, PortId};

    use super::*;

    fn connect(graph: &mut SystemGraph, number: u64) {
        let id = ConnectionId(number);
        let end = |path| PortId::parse(path).unwrap();
        let (client, server) = (end("host/a/in"), end("host/b/out"));
        graph.connections.insert(id, Connection { id, client, server, options: ConnectOptions::default() });
    }

    #[test]
    fn several_states_are_told_as_one_and_the_newest_alone_is_what_there_is() {
        let mut graph = SystemGraph::default();
        let history = History::beginning(graph.seen);
        let mut states = vec![graph.clone()];
        for number in 1..=3 {
            connect(&mut graph, number);
            history.settle(&mut graph);
            states.push(graph.clone());
        }
        let touched = |from: usize, to: usize| {
            let touched = history.since(states[from].seen, &states[to])?;
            Some(touched.connections.into_iter().map(|id| id.0).collect::<Vec<_>>())
        };
        assert_eq!(touched(0, 3), Some(vec![1, 2, 3]));
        assert_eq!(touched(1, 2), Some(vec![2]), "a reader that has an earlier graph hears of that one");
        assert_eq!(touched(3, 3), Some(vec![]));
        assert_eq!(touched(3, 1), None, "what is still to come has not been seen");
        history.settle(&mut graph);
        assert_eq!(graph.seen, states[3].seen, "a state is one that shows something");
    }

    #[test]
    fn what_is_kept_has_a_bound_and_who_was_away_longer_is_told_so() {
        const EACH: u64 = 1 << 10;
        let mut graph = SystemGraph::default();
        let history = History::beginning(graph.seen);
        let most = NAMES as u64 / EACH;
        for round in 0..most + 5 {
            (0..EACH).for_each(|number| connect(&mut graph, round * EACH + number));
            history.settle(&mut graph);
        }
        assert_eq!(history.states.lock().names, NAMES);
        assert!(history.since(4, &graph).is_none(), "it is not kept any more");
        assert_eq!(history.since(5, &graph).unwrap().len(), NAMES);
        // One change of more than that leaves nothing.
        (0..2 * NAMES as u64).for_each(|number| connect(&mut graph, 1 << 40 | number));
        history.settle(&mut graph);
        assert!(history.since(graph.seen - 1, &graph).is_none());
        assert!(history.since(graph.seen, &graph).unwrap().is_empty());
    }
}
