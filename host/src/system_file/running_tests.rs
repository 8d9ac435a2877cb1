//! A system as a file and back, and a system made what another file says.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use proptest::prelude::*;
use serde_json::json;
use trocar_model::{ClassInfo, ProcessState, Programs, Request, State, StopReason, SystemGraph, plan_all};

use super::judge_tests::processes_of;
use super::{Difference, Running, SystemFile};

/// The class `arm` with settings of every kind, and another one like it.
fn classes() -> Vec<Arc<ClassInfo>> {
    let arm = ClassInfo {
        config_schema: json!({
            "type": "object",
            "additionalProperties": false,
            "properties": {
                "gain": { "type": "number", "minimum": 0, "default": 1.5, "live": true },
                "grip": { "type": "string", "default": "open" },
                "log_file": { "type": "string", "default": "" },
                "limits": { "type": "object", "properties": { "force": { "type": "number", "default": 8 } } },
                "serial": { "type": "integer" },
            },
        }),
        ..(*crate::gcm::fake::class()).clone()
    };
    let leg = ClassInfo { name: "leg".into(), ..arm.clone() };
    // The hand moves nothing without what it requires.
    let mut hand = ClassInfo { name: "hand".into(), ..arm.clone() };
    hand.ports.required[0].optional = false;
    [arm, leg, hand].into_iter().map(Arc::new).collect()
}

fn processes(names: &[&str]) -> SystemGraph {
    processes_of(names, &classes())
}

fn parse(text: &str) -> SystemFile {
    SystemFile::parse("system.json", text.to_owned()).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// The system a file makes.
fn made(file: &SystemFile, names: &[&str]) -> SystemGraph {
    let mut graph = processes(names);
    let plan = plan_all(&graph, &file.requests()).unwrap_or_else(|e| panic!("{e}"));
    graph.apply(&plan);
    graph
}

fn saved(graph: &SystemGraph) -> (String, Vec<String>) {
    let plugins = [("host".parse().unwrap(), BTreeSet::from([PathBuf::from("/lab/plugins")]))].into();
    let (picture, notes) =
        Running { graph, held: &BTreeSet::new(), plugins: &plugins }.picture(Path::new("/lab"));
    (picture.text(), notes)
}

fn difference(file: &SystemFile, graph: &SystemGraph) -> Difference {
    file.difference(graph, &BTreeSet::new(), true).unwrap_or_else(|e| panic!("{e}"))
}

const RICH: &str = r#"{
  "version": 1,
  "processes": { "host": { "plugins": ["plugins"] } },
  "components": {
    "host/a": { "class": "toy/arm" },
    "host/b": { "class": "toy/arm", "config": { "gain": 2 }, "execution": { "rate_hz": 30 } },
    "host/c": { "class": "toy/arm", "start": false },
    "host/d": {
      "class": "toy/arm",
      "config": { "grip": "a name that is too long for one line with all of the others" },
      "execution": { "history": 3, "inside": "host/b" }
    }
  },
  "connections": [
    { "client": "host/b/input", "server": "host/a/value", "queue": { "fifo": 4 }, "max_age_ms": 2.5 },
    { "client": "host/c/robot", "server": "host/b/arm" }
  ]
}
"#;

#[test]
fn a_system_is_saved_as_a_person_would_write_it() {
    let graph = made(&parse(RICH), &["host"]);
    let (text, notes) = saved(&graph);
    assert_eq!(text, RICH, "{text}");
    assert!(notes.len() == 1 && notes[0].contains("the GCM does not know these settings"), "{notes:?}");
}

#[test]
fn a_process_that_may_start_programs_is_saved_so() {
    let mut graph = made(&parse(RICH), &["host"]);
    for (programs, may) in [(Programs::None, false), (Programs::Refused, false), (Programs::Allowed, true)] {
        let class = ClassInfo { programs, ..(*classes()[0]).clone() };
        let class = Arc::new(class);
        graph.processes.change(|_, _| true, |process| process.classes.push(class.clone()));
        assert_eq!(parse(&saved(&graph).0).processes[0].allow_exec, may, "{programs:?}");
    }
}

#[test]
fn what_stood_still_at_someones_request_is_saved_so_and_what_failed_is_not() {
    let mut graph = made(&parse(RICH), &["host"]);
    set_state(&mut graph, "host/a", State::Stopped(StopReason::Requested));
    set_state(&mut graph, "host/b", State::Fault);
    let file = parse(&saved(&graph).0);
    let starts: Vec<bool> = file.components.iter().map(|c| c.start).collect();
    assert_eq!(starts, [false, true, false, true]);
}

#[test]
fn paths_that_mean_another_file_elsewhere_are_named() {
    let with = |path: &str| RICH.replace(r#""gain": 2"#, &format!(r#""gain": 2, "log_file": "{path}""#));
    let notes = saved(&made(&parse(&with("runs/a.txt")), &["host"])).1;
    assert!(notes[1].contains(r#"host/b.log_file = "runs/a.txt""#), "{notes:?}");
    assert_eq!(saved(&made(&parse(&with("/lab/a.txt")), &["host"])).1.len(), 1);
}

#[test]
fn of_a_process_that_is_lost_all_is_saved_but_its_plugin_directories() {
    let mut graph = made(&parse(RICH), &["host"]);
    graph.processes.change(|_, _| true, |process| process.state = ProcessState::Lost);
    let running = Running { graph: &graph, held: &BTreeSet::new(), plugins: &[].into() };
    let (picture, notes) = running.picture(Path::new("/lab"));
    assert_eq!(picture.text(), RICH.replace(r#"{ "plugins": ["plugins"] }"#, "{}"));
    assert!(notes[0].contains("process host is not there to tell"), "{notes:?}");
}

#[test]
fn a_guest_and_what_hangs_on_it_is_left_out_and_named() {
    let mut graph = made(&parse(RICH), &["host"]);
    let mut guest = graph.processes.values().next().unwrap().clone();
    guest.guest = "a Python session".into();
    graph.processes.insert("shell".parse().unwrap(), guest);
    let mut visitor = graph.components.values().next().unwrap().clone();
    visitor.state = State::Active;
    graph.components.insert("shell/me".parse().unwrap(), visitor);
    let (text, notes) = saved(&graph);
    assert_eq!(text, RICH);
    assert!(notes[0].contains("guests are not in it") && notes[0].contains("shell"), "{notes:?}");
    // Nor is it taken away.
    assert_eq!(difference(&parse(RICH), &graph), Difference::default());
}

#[test]
fn an_isolated_component_is_saved_under_its_written_name_and_made_in_a_process_of_its_own() {
    let text = RICH.replace(r#""class": "toy/arm" }"#, r#""class": "toy/arm", "isolation": "process" }"#);
    let file = parse(&text);
    let graph = made(&file, &["host", "host.a"]);
    assert_eq!(saved(&graph).0, text);
    assert_eq!(difference(&file, &graph), Difference::default());
    // In a system that has neither, a person has to make the process.
    let new = difference(&file, &processes(&["host"]));
    let isolated = new
        .requests
        .iter()
        .any(|r| matches!(r, Request::CreateIsolated { home, .. } if home.as_str() == "host"));
    assert!(isolated && new.left.is_empty(), "{new:#?}");
}

#[test]
fn each_difference_has_a_line_and_what_no_request_does_is_said() {
    let mut graph = made(&parse(RICH), &["host"]);
    let changed = RICH
        .replace(r#""gain": 2"#, r#""gain": 3, "grip": "shut""#)
        .replace(r#""rate_hz": 30"#, r#""rate_hz": 30.0"#)
        .replace(r#""fifo": 4"#, r#""fifo": 5"#)
        .replace(r#", "start": false"#, "")
        .replace(r#""host/a": { "class": "toy/arm" }"#, r#""host/a": { "class": "toy/leg" }"#)
        .replace(
            r#"    { "client": "host/c/robot", "server": "host/b/arm" }"#,
            r#"    { "client": "host/d/input", "server": "host/e/value" }"#,
        )
        .replace(r#""host/d": {"#, r#""host/e": { "class": "leg" }, "host/d": {"#)
        .replace(r#""history": 3, "#, "");
    let file = parse(&changed);
    let found = difference(&file, &graph);
    assert_eq!(
        found.lines,
        [
            "~ host/a: class toy/arm → toy/leg (made anew)",
            "~ host/b: gain: 2 → 3, grip: \"open\" → \"shut\"",
            "~ host/c: READY, and the file starts it",
            "+ host/e (toy/leg)",
            "~ host/d: history: 3 → unset (made anew)",
            "~ host/a/value → host/b/input: queue: {\"fifo\":4} → {\"fifo\":5}",
            "+ host/e/value → host/d/input",
            "- host/b/arm → host/c/robot",
        ]
    );
    let plan = plan_all(&graph, &found.requests).unwrap();
    graph.apply(&plan);
    assert_eq!(difference(&file, &graph), Difference::default());
    // Not asked to, nothing is taken away.
    let kept = parse(RICH).difference(&graph, &BTreeSet::new(), false).unwrap();
    assert!(kept.lines.contains(&"- host/e (toy/leg)".to_owned()), "{:?}", kept.lines);
    assert!(
        !kept
            .requests
            .iter()
            .any(|r| matches!(r, Request::Remove { id, .. } if id.component.as_str() == "e"))
    );
    let absent = difference(&parse(&RICH.replace("host", "gui")), &graph);
    assert!(
        absent.lines[0] == "+ process gui" && absent.left[0].contains("trocar host --name gui"),
        "{absent:?}"
    );
    graph.components.get_mut(&"host/b".parse().unwrap()).unwrap().state = State::Fault;
    let broken = difference(&file, &graph);
    assert!(broken.requests.is_empty() && broken.left[0].contains("trocar reset host/b"), "{broken:#?}");
}

fn set_state(graph: &mut SystemGraph, id: &str, state: State) {
    graph.components.get_mut(&id.parse().unwrap()).unwrap().state = state;
}

fn starts(found: &Difference) -> Vec<String> {
    let all = found.requests.iter().filter_map(|r| match r {
        Request::Start { targets } => Some(targets.iter().map(ToString::to_string)),
        _ => None,
    });
    all.flatten().collect()
}

#[test]
fn what_waits_for_a_person_is_not_moved_and_it_is_said_what_that_person_does() {
    let file = parse(RICH);
    let other = parse(&RICH.replace(r#""class": "toy/arm" }"#, r#""class": "toy/leg" }"#));
    for reason in [StopReason::Interlock, StopReason::PeerLost, StopReason::Restarted] {
        let mut graph = made(&file, &["host"]);
        set_state(&mut graph, "host/a", State::Stopped(reason));
        let found = difference(&file, &graph);
        assert_eq!((found.lines.len(), starts(&found).len()), (1, 0), "{found:#?}");
        assert!(found.left[0].contains("trocar resume host/a"), "{:?}", found.left);
        // Made anew it is at rest, too.
        let found = difference(&other, &graph);
        assert!(starts(&found).is_empty() && found.left[0].contains("trocar start host/a"), "{found:#?}");
    }
    let mut graph = made(&file, &["host"]);
    set_state(&mut graph, "host/a", State::Fault);
    let found = difference(&other, &graph);
    assert!(starts(&found).is_empty() && found.left[0].contains("trocar start host/a"), "{found:#?}");
    // A file is applied after a person's own Stop.
    set_state(&mut graph, "host/a", State::Stopped(StopReason::Requested));
    assert_eq!(starts(&difference(&file, &graph)), ["host/a"]);
    let resumes =
        parse(&RICH.replace(r#""class": "toy/arm" }"#, r#""class": "toy/arm", "resume": "auto" }"#));
    set_state(&mut graph, "host/a", State::Stopped(StopReason::Restarted));
    let found = difference(&resumes, &graph);
    assert_eq!(starts(&found), ["host/a"]);
    assert!(found.left[0].contains("resume of components is not compared"), "{:?}", found.left);
}

#[test]
fn an_actuator_that_runs_on_keeps_what_it_requires() {
    let text = RICH.replace(
        r#""host/c": { "class": "toy/arm", "start": false }"#,
        r#""host/c": { "class": "toy/hand" }"#,
    );
    let graph = made(&parse(&text), &["host"]);
    let slower = parse(&text.replace(r#""rate_hz": 30"#, r#""rate_hz": 40"#));
    let found = difference(&slower, &graph);
    let refused = found.refused.map(|refusal| refusal.to_string()).unwrap_or_default();
    assert!(refused.contains("host/c") && refused.contains("host/b"), "{refused}");
    // At rest the change does no harm.
    let mut graph = graph;
    set_state(&mut graph, "host/c", State::Stopped(StopReason::Requested));
    let found = difference(&slower, &graph);
    assert_eq!(found.refused, None);
    let plan = plan_all(&graph, &found.requests).unwrap();
    graph.apply(&plan);
    assert_eq!(difference(&slower, &graph), Difference::default());
}

#[test]
fn one_input_has_one_server_in_a_file_whatever_runs() {
    let two = RICH.replace(
        r#"{ "client": "host/c/robot", "server": "host/b/arm" }"#,
        r#"{ "client": "host/c/robot", "server": "host/b/arm" }, { "client": "host/c/robot", "server": "host/a/arm" }"#,
    );
    let refused =
        parse(&two).difference(&made(&parse(RICH), &["host"]), &BTreeSet::new(), false).unwrap_err();
    assert_eq!(refused.reason(), "ALREADY_CONNECTED", "{refused}");
}

#[test]
fn a_component_that_moves_into_a_process_of_its_own_does_not_run_twice() {
    let isolated = RICH.replace(r#""class": "toy/arm" }"#, r#""class": "toy/arm", "isolation": "process" }"#);
    for (from, to, names) in
        [(RICH, isolated.as_str(), ["host", "gui"]), (isolated.as_str(), RICH, ["host", "host.a"])]
    {
        let graph = made(&parse(from), &names);
        let found = parse(to).difference(&graph, &BTreeSet::new(), false).unwrap();
        let gone = found.requests.iter().filter(|r| matches!(r, Request::Remove { .. })).count();
        let new = found
            .requests
            .iter()
            .filter(|r| matches!(r, Request::Create { .. } | Request::CreateIsolated { .. }));
        assert_eq!((gone, new.count()), (1, 1), "{found:#?}");
        assert!(
            found.lines.iter().any(|line| line.contains("in another process than the file says")),
            "{found:#?}"
        );
    }
}

#[test]
fn nobody_elses_component_is_taken_away_for_a_name_that_is_like_one_apart() {
    // A person's own process, called so, beside a component of that name.
    let text = RICH.replace(
        r#""host/a": { "class": "toy/arm" }"#,
        r#""host/a": { "class": "toy/arm" }, "host.a/a": { "class": "toy/leg" }"#,
    );
    let text = text.replace(r#""processes": {"#, r#""processes": { "host.a": {},"#);
    let graph = made(&parse(&text), &["host", "host.a"]);
    for prune in [false, true] {
        let found = parse(RICH).difference(&graph, &BTreeSet::new(), prune).unwrap();
        assert_eq!(found, Difference::default(), "prune: {prune}");
    }
    // Nor is one of the home process, where the isolated one is there.
    let isolated = RICH.replace(r#""class": "toy/arm" }"#, r#""class": "toy/arm", "isolation": "process" }"#);
    let found = parse(&isolated).difference(&graph, &BTreeSet::new(), false).unwrap();
    let gone: Vec<String> = found
        .requests
        .iter()
        .filter_map(|r| match r {
            Request::Remove { id, .. } => Some(id.to_string()),
            _ => None,
        })
        .collect();
    assert_eq!(gone, ["host.a/a"], "it is made anew, of the file's class: {found:#?}");
}

#[test]
fn what_a_program_holds_is_neither_saved_nor_taken_away() {
    let graph = made(&parse(RICH), &["host"]);
    let held: BTreeSet<_> = ["host/c".parse().unwrap()].into();
    let plugins = [("host".parse().unwrap(), BTreeSet::from([PathBuf::from("/lab/plugins")]))].into();
    let (picture, notes) =
        Running { graph: &graph, held: &held, plugins: &plugins }.picture(Path::new("/lab"));
    assert!(!picture.text().contains("host/c"), "{}", picture.text());
    assert!(notes[0].contains("what programs hold is not in it") && notes[0].contains("host/c"), "{notes:?}");
    let found = parse(&picture.text()).difference(&graph, &held, true).unwrap();
    assert_eq!(found, Difference::default());
}

#[test]
fn a_process_that_is_not_heard_is_compared_by_what_it_had() {
    let mut graph = made(&parse(RICH), &["host"]);
    let only = graph.processes.keys().next().unwrap().clone();
    let host = graph.processes.get_mut(&only).unwrap();
    host.state = ProcessState::Lost;
    host.classes.clear();
    let found = difference(&parse(RICH), &graph);
    assert_eq!((found.lines.len(), found.requests.len()), (0, 0), "{found:#?}");
    assert!(found.left[0].contains("process host is LOST"), "{:?}", found.left);
    // Nothing is taken away that may not be there.
    let less = parse(&RICH.replace("host/a", "host/z"));
    let found = difference(&less, &graph);
    assert!(found.left.iter().any(|why| why.contains("trocar forget host")), "{found:#?}");
    assert!(!found.requests.iter().any(|r| matches!(r, Request::Remove { .. })), "{found:#?}");
}

/// Any system of a few arms and legs.
fn any_file() -> impl Strategy<Value = String> {
    let rate = prop::sample::select(vec!["", r#""rate_hz": 500"#, r#""period_us": 333.333, "priority": 3"#]);
    let config =
        prop::sample::select(vec!["", r#""gain": 1.5"#, r#""gain": 4, "serial": 7"#, r#""grip": "shut""#]);
    let one = (prop::sample::select(vec!["arm", "toy/leg"]), config, rate, any::<bool>(), 0..6_usize);
    let all = prop::collection::btree_map("[a-e]", one, 0..5);
    let ties = prop::collection::btree_map("[a-e]", ("[a-e]", any::<bool>(), any::<bool>()), 0..4);
    (all, ties).prop_map(|(all, ties)| {
        let name = |id: &String| format!("\"host/{id}\"");
        let names: Vec<&String> = all.keys().collect();
        let components = all.iter().map(|(id, (class, config, rate, start, host))| {
            // Inside one that comes before it in the alphabet, so that there is no circle.
            let host = names.get(*host).filter(|host| **host < id).map(|h| format!(r#""inside": {}"#, name(h)));
            let execution = host.unwrap_or_else(|| (*rate).to_owned());
            format!(
                r#"{}: {{ "class": "{class}", "config": {{ {config} }}, "execution": {{ {execution} }}, "start": {start} }}"#,
                name(id)
            )
        });
        let there = ties.iter().filter(|(a, (b, ..))| a != &b && all.contains_key(*a) && all.contains_key(b));
        let connections = there.map(|(a, (b, stream, deep))| match stream {
            true => format!(
                r#"{{ "client": "host/{a}/input", "server": "host/{b}/value"{} }}"#,
                if *deep { r#", "queue": { "fifo": 9, "drop_oldest": true }"# } else { "" }
            ),
            false => format!(
                r#"{{ "client": "host/{a}/robot", "server": "host/{b}/arm"{} }}"#,
                if *deep { r#", "mailbox": 9"# } else { "" }
            ),
        });
        let (components, connections): (Vec<_>, Vec<_>) = (components.collect(), connections.collect());
        format!(
            r#"{{ "version": 1, "processes": {{ "host": {{ "plugins": ["plugins"] }} }}, "components": {{ {} }}, "connections": [ {} ] }}"#,
            components.join(", "),
            connections.join(", ")
        )
    })
}

/// A file that can be made, and the system it makes.
fn any_system() -> impl Strategy<Value = (SystemFile, SystemGraph)> {
    any_file().prop_filter_map("it cannot be made", |text| {
        let (file, mut graph) = (parse(&text), processes(&["host"]));
        let plan = plan_all(&graph, &file.requests()).ok()?;
        graph.apply(&plan);
        Some((file, graph))
    })
}

proptest! {
    #[test]
    fn what_is_written_is_read_as_it_was((file, _) in any_system()) {
        let text = file.picture().text();
        prop_assert_eq!(parse(&text).picture(), file.picture(), "{}", text);
    }

    #[test]
    fn a_saved_system_makes_the_same_system((file, graph) in any_system()) {
        let (text, _) = saved(&graph);
        let again = parse(&text);
        prop_assert_eq!(difference(&again, &graph), Difference::default(), "{}", text);
        prop_assert_eq!(difference(&file, &graph), Difference::default());
        let twin = made(&again, &["host"]);
        prop_assert_eq!(&twin.components, &graph.components, "{}", text);
        let ends = |graph: &SystemGraph| {
            let all = graph.connections.values();
            let mut all: Vec<_> = all.map(|c| (c.client.clone(), c.server.clone(), format!("{:?}", c.options))).collect();
            all.sort();
            all
        };
        prop_assert_eq!(ends(&twin), ends(&graph));
        // And it is written in the same words.
        prop_assert_eq!(saved(&twin).0, text);
    }

    #[test]
    fn any_system_becomes_what_any_file_says((_, mut graph) in any_system(), (file, _) in any_system()) {
        let found = difference(&file, &graph);
        let plan = plan_all(&graph, &found.requests);
        prop_assert!(plan.is_ok(), "{:?}: {:#?}", plan, found);
        graph.apply(&plan.unwrap());
        prop_assert_eq!(difference(&file, &graph), Difference::default(), "{:#?}", found);
    }
}
