//! The wanted part of a system: a fold of what was decided, apart from what is seen.

use proptest::prelude::*;
use trocar_model::*;

use crate::invariants::any_request;
use crate::scene::*;

const STOPPED: State = State::Stopped(StopReason::Requested);

/// Returns what a request puts on record, when it is accepted.
fn entry(request: &Request, plan: &Plan, revision: u64, decision: u64) -> Entry {
    match request {
        Request::Stop { targets } => Entry::Stopped { revision, decision, targets: targets.clone() },
        _ => Entry::Changed { revision, decision, changes: plan.changes.clone() },
    }
}

fn came(process: &str, epoch: u64) -> Entry {
    let incarnation = Incarnation { instance: u128::from(epoch), epoch };
    Entry::Came { process: Name::parse(process).unwrap(), incarnation }
}

/// The wanted part with one running arm of that decision.
fn running(decision: u64) -> Wanted {
    let (mut graph, mut wanted) = (empty(), Wanted::default());
    wanted.on(&came("host", 7));
    for request in [create("host/r1", "eyerobot"), Request::Start { targets: vec![target("host/r1")] }] {
        let plan = plan(&graph, &request).unwrap();
        graph.apply(&plan);
        wanted.on(&entry(&request, &plan, graph.revision, decision));
    }
    wanted
}

fn arm(wanted: &Wanted) -> (State, Option<Grant>) {
    let arm = &wanted.components[&id("host/r1")];
    (arm.state, arm.grant)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn the_fold_is_what_the_graph_was_made_to_be(requests in prop::collection::vec(any_request(), 1..60)) {
        let mut graph = SystemGraph { next_connection: 1, ..empty() };
        let mut wanted = Wanted::default();
        graph.processes.keys().for_each(|name| wanted.on(&came(name.as_str(), 7)));
        let (mut entries, mut middle) = (Vec::new(), wanted.clone());
        for (decision, request) in (1..).zip(&requests) {
            let Ok(plan) = plan(&graph, request) else { continue };
            graph.apply(&plan);
            let entry = entry(request, &plan, graph.revision, decision);
            wanted.on(&entry);
            entries.push(entry);
        }
        let unseen = wanted.unseen();
        prop_assert_eq!(&unseen.connections, &graph.connections);
        prop_assert_eq!((unseen.revision, unseen.next_connection), (graph.revision, graph.next_connection));
        let parts = |graph: &SystemGraph| -> Vec<_> {
            let all = graph.components.iter();
            all.map(|(id, c)| (id.clone(), c.class.full_name(), c.config.clone(), c.execution.clone(), c.state)).collect()
        };
        prop_assert_eq!(parts(&unseen), parts(&graph));
        for (id, component) in &wanted.components {
            prop_assert_eq!(component.grant.is_some(), component.state == State::Active, "{}", id);
            prop_assert_eq!(wanted.is_granted(id, 7), component.state == State::Active, "{}", id);
            prop_assert!(!wanted.is_granted(id, 8), "{} runs in another incarnation", id);
        }
        // Whoever begins in the middle comes to the same.
        for entry in &entries[..entries.len() / 2] {
            middle.on(entry);
        }
        let mut later = middle.clone();
        entries[entries.len() / 2..].iter().for_each(|entry| later.on(entry));
        prop_assert_eq!(later, wanted);
    }
}

#[test]
fn a_stop_takes_the_grants_of_earlier_decisions_whenever_it_is_entered() {
    for (decision, state) in [(6, STOPPED), (5, State::Active), (4, State::Active)] {
        let mut wanted = running(5);
        wanted.on(&Entry::Stopped { revision: 3, decision, targets: vec![target("host/*")] });
        assert_eq!(arm(&wanted).0, state, "a Stop of decision {decision} after a Start of decision 5");
        assert_eq!(arm(&wanted).1.is_some(), state == State::Active);
    }
}

#[test]
fn a_grant_is_for_one_incarnation_and_a_failure_ends_it() {
    let mut wanted = running(5);
    assert!(wanted.is_granted(&id("host/r1"), 7) && wanted.may_run(&id("host/r1"), 7));
    for (safety, goes_on) in [(Safety::Sensor, true), (Safety::Actuator, false)] {
        let arm = wanted.components.get_mut(&id("host/r1")).unwrap();
        std::sync::Arc::make_mut(&mut arm.class).safety = safety;
        assert_eq!(wanted.may_run(&id("host/r1"), 8), goes_on, "{safety:?}");
        assert!(!wanted.is_granted(&id("host/r1"), 8), "{safety:?}");
    }
    wanted.on(&Entry::Failed { component: id("host/r1") });
    assert_eq!(arm(&wanted), (State::Fault, None));
}

#[test]
fn what_is_told_of_an_incarnation_that_is_over_takes_nothing_from_the_next_one() {
    let gone = |epoch| Entry::Gone { revision: 4, process: Name::parse("host").unwrap(), epoch };
    let mut wanted = running(5);
    wanted.on(&came("host", 9));
    wanted.on(&gone(7));
    assert_eq!(wanted.components.len(), 1, "another one has come");
    wanted.on(&gone(9));
    assert!(wanted.components.is_empty() && wanted.processes.is_empty());
}
