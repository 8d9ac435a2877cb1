//! The control plane as a script meets it: real grpcurl, no proto file, every promise of the requests.
//!
//! Promise: dry runs change nothing, repeated ids do nothing twice, stale revisions are refused, and every
//! refusal of the error table (`errors.rs` beside this file) has its code and reason, and a help that helps
//! (`helps.rs`).

#[path = "control_plane/errors.rs"]
mod errors;
#[path = "control_plane/helps.rs"]
mod helps;
#[path = "control_plane/stage.rs"]
mod stage;
#[path = "control_plane/waiting.rs"]
mod waiting;

use std::cell::Cell;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Told, World, eventually, number};

const SERVICES: [&str; 4] =
    ["trocar.v1.GcmService", "trocar.v1.InteractService", "trocar.v1.PluginService", "grpc.health.v1.Health"];

fn host_with(plugins: &[&str]) -> (World, HostProcess, Grpcurl) {
    let world = World::with_plugins(plugins);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    (world, host, grpc)
}

#[test]
fn the_whole_life_of_a_component_goes_by_grpcurl_alone() {
    let (_world, _host, grpc) = host_with(&["eyerobot"]);
    let class = grpc.await_class("host", "eyerobot");
    assert_eq!(class, "eyerobot/eyerobot");

    let created = grpc.ok(
        "GcmService/Create",
        json!({ "process": "host", "class": "eyerobot", "name": "robot", "execution": { "rate_hz": 1000 } }),
    );
    assert_eq!(created["path"], "host/robot", "{created}");
    assert_eq!(grpc.state("host/robot"), "READY");

    grpc.ok("GcmService/Start", json!({ "paths": ["host/robot"] }));
    assert_eq!(grpc.state("host/robot"), "ACTIVE");
    let waited =
        grpc.ok("GcmService/WaitFor", json!({ "path": "host/robot", "states": ["COMPONENT_STATE_ACTIVE"] }));
    assert_eq!(waited["component"]["path"], "host/robot");

    let joints = grpc.invoke("host/robot/arm/measured_js", json!(null));
    assert!(joints["position"].is_array(), "measured_js answers joint positions: {joints}");

    let list = grpc.ok("GcmService/List", json!({}));
    assert_eq!(list["components"][0]["path"], "host/robot", "{list}");
    eventually("it steps", || {
        let list = grpc.ok("GcmService/List", json!({}));
        if number(&list["components"][0]["stats"]["executed"]) > 0 { Ok(()) } else { Err(list) }
    });

    grpc.stop("host/robot");
    assert_eq!(grpc.state("host/robot"), "STOPPED");
    grpc.ok("GcmService/Resume", json!({ "path": "host/robot" }));
    assert_eq!(grpc.state("host/robot"), "ACTIVE");
    grpc.stop("host/robot");
    grpc.ok("GcmService/Reset", json!({ "path": "host/robot" }));
    assert_eq!(grpc.state("host/robot"), "READY");
    grpc.ok("GcmService/Remove", json!({ "path": "host/robot" }));
    assert_eq!(
        grpc.refused("GcmService/GetState", json!({ "path": "host/robot" })).reason,
        "COMPONENT_NOT_FOUND"
    );
}

#[test]
fn a_change_answers_each_component_once_without_its_ports_and_each_warning_once() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let execution = json!({ "cpus": [4000] });
    let created =
        grpc.ok("GcmService/Create", json!({ "path": "host/s", "class": "sine", "execution": execution }));
    let reports = created["components"].as_array().cloned().unwrap_or_default();
    assert_eq!(reports.len(), 1, "{created}");
    assert_eq!(reports[0]["state"], "COMPONENT_STATE_READY", "as it stands in the end: {created}");
    assert!(reports[0]["ports"].is_null(), "ports are for Describe: {created}");
    let said = created["warnings"].as_array().cloned().unwrap_or_default();
    assert_eq!(said.len(), 1, "a processor that does not exist, once: {created}");
    let started = grpc.start("host/s");
    assert!(started["warnings"].as_array().is_none_or(Vec::is_empty), "it was told before: {started}");
    assert!(started["components"][0]["ports"].is_null(), "{started}");
}

#[test]
fn describe_tells_docs_units_and_kinds() {
    let (_world, _host, grpc) = host_with(&["example"]);
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    let answer = grpc.ok("GcmService/Describe", json!({ "path": "host/server/Provided/Write" }));
    let write = &answer["ports"]["provided"][0]["commands"][0];
    assert_eq!(write["name"], "Write", "only the member asked for: {answer}");
    assert_eq!(answer["ports"]["provided"][0]["commands"].as_array().map(Vec::len), Some(1), "{answer}");
    assert_eq!(write["kind"], "COMMAND_KIND_WRITE", "{answer}");
    assert_eq!(write["arg"]["unit"], "mm", "{answer}");
    assert_eq!(write["arg"]["max"].as_f64(), Some(100.0), "{answer}");
    assert!(write["doc"].as_str().is_some_and(|doc| !doc.is_empty()), "Write has a documentation: {answer}");
}

#[test]
fn validate_only_answers_the_plan_and_changes_nothing() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let before = grpc.revision();
    let create = json!({ "path": "host/s", "class": "sine", "validate_only": true });
    let answer = grpc.ok("GcmService/Create", create);
    let plan = answer["plan"].to_string();
    assert!(
        plan.contains("create") && plan.contains("host/s"),
        "the plan tells what would be done: {answer}"
    );
    assert_eq!(grpc.revision(), before);
    assert_eq!(
        grpc.refused("GcmService/GetState", json!({ "path": "host/s" })).reason,
        "COMPONENT_NOT_FOUND"
    );

    let bad = json!({ "path": "host/s", "class": "sinus", "validate_only": true });
    assert_eq!(
        grpc.refused("GcmService/Create", bad).reason,
        "CLASS_NOT_FOUND",
        "a dry run refuses as the real one"
    );
}

#[test]
fn a_repeated_request_id_gets_the_same_answer_and_does_nothing_twice() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let create = json!({ "path": "host/s", "class": "sine", "request_id": "once" });
    let first = grpc.ok("GcmService/Create", create.clone());
    let again = grpc.ok("GcmService/Create", create);
    assert_eq!(first, again);
    assert_eq!(grpc.revision(), number(&first["revision"]));
}

#[test]
fn every_accepted_change_raises_the_revision_by_one() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let created = number(&grpc.create("host/s", "sine", json!({}))["revision"]);
    let started = number(&grpc.start("host/s")["revision"]);
    let stopped = number(&grpc.stop("host/s")["revision"]);
    assert_eq!((started, stopped), (created + 1, created + 2));
    grpc.refused("GcmService/Start", json!({ "path": "host/nobody" }));
    assert_eq!(grpc.revision(), stopped, "a refused request changes nothing");
}

#[test]
fn stop_is_never_refused_for_a_stale_revision() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    grpc.start("host/s");
    let stale = json!({ "path": "host/s", "expected_revision": 0 });
    assert_eq!(grpc.refused("GcmService/Reset", stale.clone()).reason, "REVISION_CONFLICT");
    grpc.ok("GcmService/Stop", stale);
    assert_eq!(grpc.state("host/s"), "STOPPED");
}

#[test]
fn apply_is_all_or_nothing() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let step =
        |name: &str, class: &str| json!({ "create": { "path": format!("host/{name}"), "class": class } });
    let before = grpc.revision();
    let refused =
        grpc.refused("GcmService/Apply", json!({ "steps": [step("a", "sine"), step("b", "cosine")] }));
    assert_eq!(refused.reason, "CLASS_NOT_FOUND");
    assert_eq!(grpc.revision(), before);
    assert_eq!(components(&grpc), Vec::<String>::new());

    grpc.ok("GcmService/Apply", json!({ "steps": [step("a", "sine"), step("b", "sine")] }));
    assert_eq!(components(&grpc), ["host/a", "host/b"]);
}

#[test]
fn watch_sends_a_snapshot_and_then_each_change() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let mut watch = grpc.stream("GcmService/Watch", &json!({}));
    let first = watch.until("the snapshot", |_| true);
    assert!(first["snapshot"].is_object(), "the first message is the whole graph: {first}");

    let created = number(&grpc.create("host/s", "sine", json!({}))["revision"]);
    let delta = watch.until("host/s", |item| item.to_string().contains("host/s"));
    assert!(delta["delta"]["components"].is_array(), "later messages are differences: {delta}");
    if number(&delta["revision"]) < created {
        watch.until("the revision that Create answered", |item| number(&item["revision"]) >= created);
    }

    grpc.ok("GcmService/Remove", json!({ "path": "host/s" }));
    watch.until("that host/s is gone", |item| {
        item["delta"]["removedComponents"].as_array().is_some_and(|gone| gone.contains(&json!("host/s")))
    });
}

#[test]
fn a_watch_goes_on_where_a_list_or_another_watch_ended() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let listed = grpc.ok("GcmService/List", json!({ "brief": true }));
    grpc.create("host/s", "sine", json!({}));
    grpc.create("host/gone", "sine", json!({}));
    grpc.start("host/s");
    grpc.ok("GcmService/Remove", json!({ "path": "host/gone" }));
    let first = |after: &Value| {
        let mut watch = grpc.stream("GcmService/Watch", &json!({ "after": after }));
        watch.until("the first message", |_| true)
    };
    let missed = first(&listed["cursor"]);
    let components = missed["delta"]["components"].as_array();
    let [s] = &components.expect("only what has changed")[..] else { panic!("one is there: {missed}") };
    assert_eq!((&s["path"], &s["state"]), (&json!("host/s"), &json!("COMPONENT_STATE_ACTIVE")), "{missed}");
    let again = first(&missed["cursor"]);
    assert_eq!(again["delta"]["components"], json!([]), "nothing has changed since: {again}");
    let refused = grpc.refused("GcmService/Watch", json!({ "after": "yesterday" }));
    assert_eq!(refused.reason, "ARGUMENT_INVALID");
    assert!(
        refused.message.contains("\"yesterday\" is no cursor: give that of an answer of Watch or List"),
        "{refused:?}"
    );
}

#[test]
fn subscribe_follows_outputs_at_the_rate_asked_for() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    grpc.start("host/s");
    let selections = json!({ "selections": [{ "path": "host/s/value", "max_rate_hz": 50 }] });
    let mut stream = grpc.stream("InteractService/Subscribe", &selections);
    let first = stream.until("a sample", |item| item["kind"] == "ITEM_KIND_STREAM");
    let second = stream.until("another sample", |item| item["kind"] == "ITEM_KIND_STREAM");
    assert!(number(&second["seq"]) > number(&first["seq"]), "{first} then {second}");
    assert!(number(&second["stampNs"]) > number(&first["stampNs"]), "{first} then {second}");
}

#[test]
fn one_subscribe_follows_so_many_selections_and_refuses_one_more_with_what_to_do() {
    const MOST: usize = 256;
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    grpc.create("host/s", "sine", json!({}));
    let selecting = |n: usize| json!({ "selections": vec![json!({ "path": "host/s" }); n] });
    let refused = grpc.refused("InteractService/Subscribe", selecting(MOST + 1));
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        ("INVALID_ARGUMENT", "ARGUMENT_INVALID"),
        "{refused}"
    );
    assert_eq!(refused.violated_fields(), ["selections"], "{refused}");
    let says = "it selects 257, and one Subscribe follows 256 at most: follow the rest by another";
    assert!(refused.message.contains(says), "{refused}");
    assert!(Told::by(&refused).help.contains("ask again"), "{refused:?}");

    // Each selection begins with the present state, so that all are counted.
    let follow = |n: usize| {
        let mut stream = grpc.stream("InteractService/Subscribe", &selecting(n));
        let seen = Cell::new(0);
        stream.until(&format!("{n} states"), |item| {
            assert_eq!(item["kind"], "ITEM_KIND_STATE", "{item}");
            seen.set(seen.get() + 1);
            seen.get() == n
        });
        stream
    };
    let most = follow(MOST);
    let rest = follow(1);
    drop(most);
    let again = follow(MOST);
    drop((rest, again));
}

#[test]
fn reflection_lists_and_describes_every_service() {
    let (_world, _host, grpc) = host_with(&[]);
    let list = grpc.ask_reflection(&["list"]);
    for service in SERVICES {
        assert!(list.lines().any(|line| line == service), "grpcurl list does not name {service}:\n{list}");
    }
    // grpcurl 1.8.6 itself speaks v1alpha; newer tools speak v1.
    for version in ["grpc.reflection.v1alpha.ServerReflection", "grpc.reflection.v1.ServerReflection"] {
        assert!(list.lines().any(|line| line == version), "{version} is not served:\n{list}");
    }
    let create = grpc.ask_reflection(&["describe", "trocar.v1.GcmService.Create"]);
    assert!(create.contains("CreateRequest"), "{create}");
}

#[test]
fn health_is_serving_for_every_service() {
    let (_world, _host, grpc) = host_with(&[]);
    for service in ["", "trocar.v1.GcmService", "trocar.v1.InteractService", "trocar.v1.PluginService"] {
        let answer = grpc.ok("grpc.health.v1.Health/Check", json!({ "service": service }));
        assert_eq!(answer["status"], "SERVING", "health of {service:?}: {answer}");
    }
}

#[test]
fn whole_numbers_beyond_two_to_the_53_survive_as_strings() {
    let (_world, _host, grpc) = host_with(&["fixture_echo"]);
    grpc.await_class("host", "echo");
    grpc.create("host/e", "echo", json!({}));
    grpc.start("host/e");
    let big = "9007199254740993";
    assert_eq!(grpc.invoke("host/e/ctl/write_return_u64", json!(big)), json!(big));
}

#[test]
fn a_refusal_on_the_terminal_reads_as_one_sentence_with_what_exists() {
    let (_world, _host, grpc) = host_with(&["sine"]);
    grpc.await_class("host", "sine");
    let text = grpc.printed("GcmService/Create", &json!({ "path": "host/s", "class": "sin" }));
    assert!(text.contains("did you mean `sine`? There is sine"), "it names what exists:\n{text}");
    assert!(text.contains("CLASS_NOT_FOUND"), "grpcurl resolves the details by reflection:\n{text}");
}

fn components(grpc: &Grpcurl) -> Vec<String> {
    let list = grpc.ok("GcmService/List", json!({ "brief": true }));
    let all = list["components"].as_array().cloned().unwrap_or_default();
    all.iter().filter_map(|c: &Value| c["path"].as_str().map(str::to_owned)).collect()
}
