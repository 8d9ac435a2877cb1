//! Start, Stop, Resume, Reset: order, globs, and what each refuses.

use trocar_model::*;

use crate::scene::*;

fn resume(targets: &[&str]) -> Request {
    Request::Resume { targets: targets.iter().map(|t| target(t)).collect() }
}

fn reset(targets: &[&str]) -> Request {
    Request::Reset { targets: targets.iter().map(|t| target(t)).collect() }
}

fn runs(plan: &Plan) -> Vec<String> {
    let run = |c: &Change| match c {
        Change::Run { id, to, .. } => format!("{id} {to}"),
        other => panic!("{other:?} is no run"),
    };
    plan.changes.iter().map(run).collect()
}

fn skipped(plan: &Plan) -> Vec<String> {
    plan.skipped.iter().map(|s| format!("{}: {}", s.id, s.why)).collect()
}

#[test]
fn servers_start_before_clients_and_stop_after_them() {
    let mut graph = theatre();
    let up = plan(&graph, &start(&["host/log", "host/controller", "host/robot"])).unwrap();
    assert_eq!(runs(&up), ["host/robot ACTIVE", "host/controller ACTIVE", "host/log ACTIVE"]);
    graph.apply(&up);
    let down = plan(&graph, &stop(&["**"])).unwrap();
    let want = [
        "host/log STOPPED{requested}",
        "host/controller STOPPED{requested}",
        "host/robot STOPPED{requested}",
    ];
    assert_eq!(runs(&down), want);
}

#[test]
fn the_head_of_a_stream_starts_after_what_runs_in_it_even_unconnected() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/zsource", "image_source"),
            create_in("host/a", "vision/gray", "host/zsource"),
            create("host/other", "image_source"),
            connect("host/a/raw", "host/other/image"),
        ],
    );
    let plan = plan(&graph, &start(&["host/a", "host/zsource", "host/other"])).unwrap();
    assert_eq!(runs(&plan).last().unwrap(), "host/zsource ACTIVE");
}

#[test]
fn start_lists_every_open_end_that_must_be_connected() {
    let mut graph = empty();
    done(&mut graph, &[create("host/controller", "controller"), create("host/log", "logger")]);
    let refusal = refused(&graph, &start(&["host/controller"]));
    assert!(matches!(&refusal, Refusal::Unconnected { ports, .. } if ports == &["robot"]), "{refusal}");
    assert_eq!(
        refused(&graph, &start(&["host/**"])).reason(),
        "UNCONNECTED",
        "a glob does not start half a system"
    );
    done(&mut graph, &[start(&["host/log"])]);
}

#[test]
fn start_by_name_is_refused_where_the_table_says_so_and_lists_what_is_allowed() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/robot"])]);
    let refusal = refused(&graph, &start(&["host/robot"]));
    let text = refusal.to_string();
    assert_eq!(
        text,
        "Start of `host/robot` is not allowed in state ACTIVE: it runs already; allowed are Configure, Stop, Reset, Remove"
    );
    set_state(&mut graph, "host/robot", State::Fault);
    graph.components.get_mut(&id("host/robot")).unwrap().fault = "panic in step".into();
    assert!(refused(&graph, &start(&["host/robot"])).to_string().contains("FAULT: panic in step"));
}

#[test]
fn a_refused_target_leaves_the_others_alone() {
    let mut graph = theatre();
    set_state(&mut graph, "host/log", State::Fault);
    assert_eq!(refused(&graph, &start(&["host/robot", "host/log"])).reason(), "WRONG_STATE");
}

#[test]
fn a_glob_never_starts_or_resumes_what_waits_for_somebody() {
    for reason in [StopReason::Restarted, StopReason::Interlock, StopReason::PeerLost] {
        let mut graph = theatre();
        set_state(&mut graph, "host/robot", State::Stopped(reason));
        for request in [start(&["host/**"]), resume(&["host/**"]), reset(&["host/**"])] {
            let plan = plan(&graph, &request).unwrap();
            let robot = skipped(&plan).into_iter().find(|s| s.starts_with("host/robot: "));
            let robot = robot.unwrap_or_else(|| panic!("{request:?} did not skip the robot: {plan:?}"));
            assert!(robot.contains(&format!("STOPPED{{{reason}}}")) && robot.ends_with("by name"), "{robot}");
        }
        assert_eq!(runs(&plan(&graph, &resume(&["host/robot"])).unwrap()), ["host/robot ACTIVE"]);
        assert_eq!(runs(&plan(&graph, &start(&["host/robot"])).unwrap()), ["host/robot ACTIVE"]);
    }
}

#[test]
fn a_name_beside_a_glob_counts_as_named() {
    let mut graph = theatre();
    set_state(&mut graph, "host/robot", State::Stopped(StopReason::Restarted));
    let plan = plan(&graph, &start(&["host/**", "host/robot"])).unwrap();
    assert!(runs(&plan).contains(&"host/robot ACTIVE".to_owned()), "{plan:?}");
}

#[test]
fn starting_everything_twice_is_harmless() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/**"])]);
    let again = plan(&graph, &start(&["host/**"])).unwrap();
    assert!(again.changes.is_empty());
    assert_eq!(skipped(&again)[0], "host/robot: it is ACTIVE already");
}

#[test]
fn a_glob_that_matches_nothing_says_so_but_stop_everything_always_holds() {
    assert_eq!(refused(&theatre(), &start(&["gui/**"])).reason(), "NOTHING_MATCHES");
    assert_eq!(
        refused(&theatre(), &stop(&["host/robt*"])).reason(),
        "NOTHING_MATCHES",
        "a slip must not look like a stop"
    );
    assert_eq!(plan(&empty(), &stop(&["**"])).unwrap(), Plan::default());
}

#[test]
fn stop_is_refused_only_for_what_does_not_exist() {
    for state in State::ALL {
        for process in [ProcessState::Attached, ProcessState::Lost] {
            let mut graph = theatre();
            set_state(&mut graph, "host/robot", state);
            graph.processes.get_mut(&name("host")).unwrap().state = process;
            let plan = plan(&graph, &stop(&["host/robot"])).unwrap();
            let acts = matches!(state, State::Active | State::Stopped(StopReason::Restarted))
                && process == ProcessState::Attached;
            assert_eq!(
                (plan.changes.len(), plan.skipped.len()),
                if acts { (1, 0) } else { (0, 1) },
                "{state} {process:?}"
            );
        }
    }
    assert_eq!(refused(&theatre(), &stop(&["host/robt"])).reason(), "COMPONENT_NOT_FOUND");
}

#[test]
fn a_lost_process_is_refused_by_name_and_skipped_by_glob() {
    let mut graph = theatre();
    graph.processes.get_mut(&name("host")).unwrap().state = ProcessState::Lost;
    assert_eq!(refused(&graph, &start(&["host/robot"])).reason(), "PROCESS_LOST");
    assert_eq!(plan(&graph, &start(&["host/**"])).unwrap().skipped.len(), 3);
}

#[test]
fn reset_by_name_leads_to_ready_from_everywhere_but_created() {
    for state in State::ALL {
        let mut graph = theatre();
        set_state(&mut graph, "host/robot", state);
        match plan(&graph, &reset(&["host/robot"])) {
            Ok(plan) => assert_eq!(runs(&plan), ["host/robot READY"], "{state}"),
            Err(refusal) => {
                assert!(state == State::Created && refusal.reason() == "WRONG_STATE", "{state}: {refusal}")
            }
        }
    }
}

#[test]
fn a_glob_resets_what_failed_and_leaves_what_runs() {
    let mut graph = theatre();
    set_state(&mut graph, "host/log", State::Fault);
    set_state(&mut graph, "host/robot", State::Active);
    let plan = plan(&graph, &reset(&["host/**"])).unwrap();
    assert_eq!(runs(&plan), ["host/log READY"]);
    assert_eq!(plan.skipped.len(), 2);
}

#[test]
fn no_path_at_all_is_a_mistake() {
    assert_eq!(refused(&theatre(), &start(&[])).reason(), "ARGUMENT_INVALID");
}

#[test]
fn components_that_serve_each_other_still_have_an_order() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create("host/a", "vision/gray"),
            connect("host/a/raw", "host/source/image"),
            connect("host/source/feedback", "host/a/image"),
        ],
    );
    assert_eq!(runs(&plan(&graph, &start(&["**"])).unwrap()).len(), 2);
}

#[test]
fn what_lost_an_end_it_requires_is_not_resumed_until_that_is_connected_again() {
    let mut graph = theatre();
    done(&mut graph, &[start(&["host/robot", "host/controller"])]);
    done(&mut graph, &[Request::Remove { id: id("host/robot"), force: true }]);
    set_state(&mut graph, "host/controller", State::Stopped(StopReason::PeerLost));
    for (request, asked) in [(resume(&["host/controller"]), "resume"), (start(&["host/controller"]), "start")]
    {
        let refusal = refused(&graph, &request);
        assert!(matches!(&refusal, Refusal::Unconnected { ports, .. } if ports == &["robot"]), "{refusal}");
        assert!(refusal.to_string().contains(&format!("cannot {asked}:")), "{refusal}");
    }
    let again = [
        create("host/robot", "eyerobot"),
        start(&["host/robot"]),
        connect("host/controller/robot", "host/robot/arm"),
    ];
    done(&mut graph, &again);
    let plan = plan(&graph, &resume(&["host/controller"])).unwrap();
    assert_eq!(runs(&plan), ["host/controller ACTIVE"]);
}
