//! Which changes of a plan are done side by side.
//!
//! Invariant: pure. Two changes stay in the order of the plan unless they are of one kind, neither sets
//! anything in motion or brings it to rest, and they are about different processes.

use std::collections::BTreeMap;
use std::ops::Range;

use trocar_model::{Change, Name};

use super::changes::id_of;

/// Kinds of changes that do not need each other, where they are about different processes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A component is made, and gets its first settings.
    Make,
    Connect,
    Disconnect,
    Destroy,
    /// Order counts: servers move before their clients, and rest after them.
    InOrder,
}

fn kind(change: &Change) -> Kind {
    match change {
        Change::Create { .. } => Kind::Make,
        Change::Configure { from_state, .. } if *from_state == trocar_model::State::Created => Kind::Make,
        Change::Connect { .. } => Kind::Connect,
        Change::Disconnect { .. } => Kind::Disconnect,
        Change::Destroy { .. } => Kind::Destroy,
        Change::Configure { .. } | Change::Run { .. } => Kind::InOrder,
    }
}

/// Returns the processes that a change is about: those of both ends of a connection.
fn lane(change: &Change) -> (Name, Name) {
    match change {
        Change::Connect { connection } | Change::Disconnect { connection, .. } => {
            (connection.client.component.process.clone(), connection.server.component.process.clone())
        }
        _ => (id_of(change).process.clone(), id_of(change).process.clone()),
    }
}

/// Cuts a plan into parts that are done one after the other. Returns the numbers of the changes of each part
/// by lanes: those of a lane are done in order, lanes side by side.
pub(super) fn parts(changes: &[Change]) -> Vec<Vec<Vec<usize>>> {
    let mut parts = Vec::new();
    let mut from = 0;
    while from < changes.len() {
        let of = kind(&changes[from]);
        let is_same = |change: &&Change| of != Kind::InOrder && kind(change) == of;
        let to = from + changes[from..].iter().take_while(is_same).count().max(1);
        parts.push(lanes(changes, from..to));
        from = to;
    }
    parts
}

fn lanes(changes: &[Change], part: Range<usize>) -> Vec<Vec<usize>> {
    let mut lanes: BTreeMap<(Name, Name), Vec<usize>> = BTreeMap::new();
    for at in part {
        lanes.entry(lane(&changes[at])).or_default().push(at);
    }
    lanes.into_values().collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use serde_json::Value;
    use trocar_model::{
        Component, ConnectOptions, Connection, ConnectionId, PortId, State, StopReason, Verb,
    };

    use super::super::fake::id;
    use super::super::reconcile::nameless;
    use super::*;

    fn create(path: &str) -> Change {
        let component = Component { ports: Arc::default(), ..nameless(State::Created) };
        Change::Create { id: id(path), component: Box::new(component) }
    }

    fn configure(path: &str, stands: State) -> Change {
        let (from, to) = (Value::Null, Value::Null);
        Change::Configure { id: id(path), from, to, from_state: stands, to_state: State::Ready }
    }

    fn run(path: &str) -> Change {
        Change::Run { id: id(path), verb: Verb::Start, from: State::Ready, to: State::Active }
    }

    fn connect(number: u64, client: &str, server: &str) -> Change {
        let port = |text| PortId::parse(text).unwrap();
        let (client, server, options) = (port(client), port(server), ConnectOptions::default());
        Change::Connect { connection: Connection { id: ConnectionId(number), client, server, options } }
    }

    #[test]
    fn processes_are_made_side_by_side_and_each_in_order() {
        let made = |path: &str| configure(path, State::Created);
        let plan = [create("b/x"), made("b/x"), create("a/x"), made("a/x"), create("b/y"), made("b/y")];
        assert_eq!(parts(&plan), [[vec![2, 3], vec![0, 1, 4, 5]]]);
    }

    #[test]
    fn connections_of_one_pair_of_processes_stay_in_order() {
        let plan = [
            connect(1, "a/x/in", "a/y/out"),
            connect(2, "a/x/peer", "b/x/ctl"),
            connect(3, "a/y/peer", "b/x/ctl"),
            connect(4, "b/x/peer", "a/x/ctl"),
        ];
        assert_eq!(parts(&plan), [[vec![0], vec![1, 2], vec![3]]]);
    }

    #[test]
    fn what_moves_or_rests_is_done_in_the_order_of_the_plan_alone() {
        let rests = State::Stopped(StopReason::Requested);
        let plan = [create("a/x"), run("a/x"), run("b/x"), configure("b/x", rests), create("b/y")];
        assert_eq!(parts(&plan), [[[0]], [[1]], [[2]], [[3]], [[4]]]);
        assert_eq!(parts(&[]), Vec::<Vec<Vec<usize>>>::new());
    }
}
