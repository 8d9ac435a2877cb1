//! States of a graph: what each of them shows differently than the one before.

use std::collections::BTreeMap;

use proptest::prelude::*;
use trocar_model::*;

use crate::invariants::{any_request, stage};
use crate::scene::*;

/// Something that changes a graph, or leaves it as it is.
#[derive(Clone, Debug)]
enum Edit {
    Ask(Box<Request>),
    /// A process is seen otherwise.
    Process(&'static str, ProcessState),
    /// A half of the connection of that place is told of.
    Half(usize, End, bool),
    /// A component is taken out and put in again, the same or in another state.
    Again(usize, State),
    /// A process goes, and comes back as it was.
    Gone(&'static str),
}

fn any_edit() -> impl Strategy<Value = Edit> {
    let process = || prop::sample::select(vec!["host", "gui"]);
    let end = prop::sample::select(vec![End::Client, End::Server]);
    let state = prop::sample::select(vec![State::Ready, State::Active, State::Fault]);
    prop_oneof![
        6 => any_request().prop_map(|request| Edit::Ask(Box::new(request))),
        2 => (process(), prop::sample::select(ProcessState::ALL.to_vec())).prop_map(|(p, s)| Edit::Process(p, s)),
        2 => (0usize..8, end, any::<bool>()).prop_map(|(at, end, is_there)| Edit::Half(at, end, is_there)),
        2 => (0usize..9, state).prop_map(|(at, state)| Edit::Again(at, state)),
        1 => process().prop_map(Edit::Gone),
    ]
}

fn carry_out(graph: &mut SystemGraph, edit: Edit) {
    match edit {
        Edit::Ask(request) => {
            if let Ok(plan) = plan(graph, &request) {
                graph.apply(&plan);
            }
        }
        Edit::Process(process, state) => {
            if let Some(process) = graph.processes.get_mut(&name(process)) {
                process.state = state;
            }
        }
        Edit::Half(at, end, is_there) => {
            let Some(connection) = graph.connections.values().nth(at).cloned() else { return };
            let process = connection.port(end).component.process.clone();
            let told =
                Proxy { process, epoch: 7, why: String::new(), carrier: "memfd".into(), peer: String::new() };
            match is_there {
                true => graph.proxies.insert((connection.id, end), told),
                false => _ = graph.proxies.remove(&(connection.id, end)),
            }
        }
        Edit::Again(at, state) => {
            let Some((id, component)) = graph.components.iter().nth(at) else { return };
            let (id, component) = (id.clone(), Component { state, ..component.clone() });
            graph.components.remove(&id);
            graph.components.insert(id, component);
        }
        Edit::Gone(process) => {
            let Some(was) = graph.processes.remove(&name(process)) else { return };
            graph.processes.insert(name(process), (*was).clone());
        }
    }
}

/// All that is shown of the connections.
fn shown(graph: &SystemGraph) -> BTreeMap<ConnectionId, (Connection, Vec<(End, Proxy)>)> {
    graph.connections.iter().map(|(id, c)| (*id, (c.clone(), graph.proxies_of(c)))).collect()
}

/// Returns the keys of what is not in both, or not the same.
fn different<'a, K: Ord + Clone + 'a, V: PartialEq + 'a>(
    before: impl IntoIterator<Item = (&'a K, &'a V)>,
    after: impl IntoIterator<Item = (&'a K, &'a V)>,
) -> std::collections::BTreeSet<K> {
    let (before, after): (BTreeMap<_, _>, BTreeMap<_, _>) =
        (before.into_iter().collect(), after.into_iter().collect());
    let all = before.keys().chain(after.keys());
    all.filter(|key| before.get(*key) != after.get(*key)).map(|key| (*key).clone()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn a_state_tells_what_a_comparison_with_the_one_before_would(
        states in prop::collection::vec(prop::collection::vec(any_edit(), 1..4), 1..40)
    ) {
        let mut graph = stage();
        graph.settle();
        // Components of one process, as they were listed with each pair of newest and number.
        let mut tags: BTreeMap<(u64, usize), Table<ComponentId, Component>> = BTreeMap::new();
        for edits in states {
            let before = graph.clone();
            edits.into_iter().for_each(|edit| carry_out(&mut graph, edit));
            let touched = graph.settle();
            prop_assert_eq!(&touched.processes, &different(&before.processes, &graph.processes));
            prop_assert_eq!(&touched.components, &different(&before.components, &graph.components));
            let expected = different(&shown(&before), &shown(&graph));
            prop_assert!(
                touched.connections.is_superset(&expected),
                "{:?} of {:?} are told", touched.connections, expected
            );
            let moved = !touched.processes.is_empty();
            prop_assert!(moved || touched.connections == expected, "{:?} beyond {:?}", touched, expected);
            prop_assert_eq!(graph.seen, before.seen + u64::from(!touched.is_empty()));

            let mut part = graph.components.clone();
            part.retain(|id, _| id.process == name("host"));
            let known = tags.entry((part.newest(), part.len())).or_insert_with(|| part.clone());
            prop_assert_eq!(&*known, &part, "two contents under one tag");
        }
    }

    #[test]
    fn a_copy_is_not_changed_with_its_original(edits in prop::collection::vec(any_edit(), 1..20)) {
        let mut graph = stage();
        let text = format!("{graph:?}");
        let copy = graph.clone();
        edits.into_iter().for_each(|edit| carry_out(&mut graph, edit));
        prop_assert_eq!(format!("{copy:?}"), text);
    }
}
