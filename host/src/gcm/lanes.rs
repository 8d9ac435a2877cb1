//! Which changes of a plan are done side by side.
//!
//! Invariant: pure. Side by side are only changes of one kind: components of different processes, and
//! connections to servers in different processes, since an untyped output has its type by the first of its
//! connections. What moves, rests, or takes the place of something is done in the order of the plan.

use std::collections::BTreeMap;
use std::ops::Range;

use trocar_model::{Change, Name, State};

use super::changes::id_of;

/// Kinds of changes; those of one kind may be done side by side.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A component is made, and gets its first settings.
    Make,
    Connect,
    Disconnect,
    Destroy,
    /// Servers move before their clients, and rest after them; what loses its source for another one gets
    /// that next.
    InOrder,
}

fn kind(change: &Change) -> Kind {
    match change {
        Change::Create { .. } | Change::Configure { from_state: State::Created, .. } => Kind::Make,
        Change::Connect { .. } => Kind::Connect,
        Change::Disconnect { replaced: false, .. } => Kind::Disconnect,
        Change::Destroy { .. } => Kind::Destroy,
        Change::Disconnect { .. } | Change::Configure { .. } | Change::Run { .. } => Kind::InOrder,
    }
}

/// Returns the process whose changes of a kind are done one after the other.
fn lane(change: &Change) -> &Name {
    match change {
        Change::Connect { connection } | Change::Disconnect { connection, .. } => {
            &connection.server.component.process
        }
        _ => &id_of(change).process,
    }
}

/// Cuts a plan into parts that are done one after the other. Returns the numbers of the changes of each part
/// by lanes, the lane of the first change first: those of a lane are done in order, lanes side by side.
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
    let mut lanes: BTreeMap<&Name, Vec<usize>> = BTreeMap::new();
    for at in part {
        lanes.entry(lane(&changes[at])).or_default().push(at);
    }
    let mut lanes: Vec<Vec<usize>> = lanes.into_values().collect();
    lanes.sort_by_key(|lane| lane[0]);
    lanes
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
        assert_eq!(parts(&plan), [[vec![0, 1, 4, 5], vec![2, 3]]]);
    }

    #[test]
    fn connections_to_the_servers_of_one_process_stay_in_order() {
        let plan = [
            connect(1, "a/x/in", "b/any/out"),
            connect(2, "a/x/peer", "a/y/ctl"),
            connect(3, "b/x/in", "b/any/out"),
            connect(4, "b/x/peer", "a/x/ctl"),
        ];
        assert_eq!(parts(&plan), [[vec![0, 2], vec![1, 3]]]);
    }

    #[test]
    fn what_loses_its_source_for_another_one_gets_that_next() {
        let cut = |number, client: &str, server: &str, replaced| match connect(number, client, server) {
            Change::Connect { connection } => Change::Disconnect { connection, replaced },
            other => other,
        };
        let others = (0..20).map(|n| connect(100 + n, &format!("a{n}/x/in"), &format!("a{n}/y/out")));
        let first = [
            cut(1, "z/x/in", "z/y/out", false),
            cut(2, "z/arm/in", "z/y/out", true),
            connect(3, "z/arm/in", "z/z/out"),
        ];
        let plan: Vec<Change> = first.into_iter().chain(others).collect();
        let parts = parts(&plan);
        assert_eq!(parts[..2], [[[0]], [[1]]]);
        assert_eq!((parts.len(), parts[2].len(), &parts[2][0]), (3, 21, &vec![2]), "it is among the first");
    }

    #[test]
    fn what_moves_or_rests_is_done_in_the_order_of_the_plan_alone() {
        let rests = State::Stopped(StopReason::Requested);
        let plan = [create("a/x"), run("a/x"), run("b/x"), configure("b/x", rests), create("b/y")];
        assert_eq!(parts(&plan), [[[0]], [[1]], [[2]], [[3]], [[4]]]);
        assert_eq!(parts(&[]), Vec::<Vec<Vec<usize>>>::new());
    }
}
