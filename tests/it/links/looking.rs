//! Where the halves of a connection are seen, and the figures of both together.

use serde_json::{Value, json};
use trocar_tests::{eventually, number};

use super::{await_flow, await_linked, connection, epoch, halves, pair};

fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

#[test]
fn both_halves_are_seen_wherever_the_connection_is() {
    let two = pair();
    let listed = await_linked(&two.grpc, "right/e/sample", 0);
    assert_eq!(listed["carrier"], "memfd", "{listed}");
    let [client, server] = halves(&listed);
    let shape = |half: &Value| {
        (half["process"].as_str().unwrap().to_owned(), half["end"].as_str().unwrap().to_owned())
    };
    assert_eq!(shape(&client), ("right".into(), "CONNECTION_END_CLIENT".into()));
    assert_eq!(shape(&server), ("left".into(), "CONNECTION_END_SERVER".into()));
    assert_eq!((&client["epoch"], &client["carrier"]), (&server["epoch"], &json!("memfd")));
    for path in ["left/s", "right/e"] {
        let state = two.grpc.ok("GcmService/GetState", json!({ "path": path }));
        assert_eq!(state["connections"][0]["proxies"], listed["proxies"], "{state}");
        let described = two.grpc.ok("GcmService/Describe", json!({ "path": path }));
        assert_eq!(described["connections"][0]["proxies"], listed["proxies"], "{described}");
    }
    let part = two.grpc.ok("GcmService/List", json!({ "path": "left" }));
    let part = part["connections"].as_array().unwrap().iter().find(|c| c["client"] == "right/e/sample");
    assert_eq!(part.unwrap()["proxies"], listed["proxies"], "a part of the list knows both ends, too");
    let process = two.grpc.ok("GcmService/Describe", json!({ "path": "left" }));
    assert_eq!(process["connections"].as_array().map(Vec::len), Some(2), "{process}");
    let ls = two.trocar().run(&["ls"]).ends_with(0).says("memfd").says("Halves between processes");
    assert!(!ls.stdout.contains("not linked"), "{ls:#?}");
    two.trocar().run(&["describe", "right/e"]).ends_with(0).says("client half in right: linked, memfd");
    two.trocar().run(&["graph"]).ends_with(0).says("left/s/value → right/e/sample  memfd");
    let json = two.trocar().run(&["ls", "--json"]).ends_with(0).json();
    let proxies = json["connections"][1]["proxies"].as_array().cloned().unwrap();
    assert_eq!((&proxies[0]["end"], &proxies[0]["linked"]), (&json!("CLIENT"), &json!(true)), "{json}");
}

#[test]
fn a_watcher_sees_halves_come_and_go() {
    let two = pair();
    let mut watch = two.grpc.stream("GcmService/Watch", &json!({}));
    let snapshot = watch.until("the snapshot", |item| item["snapshot"].is_object());
    assert_eq!(snapshot["snapshot"]["connections"].as_array().map(Vec::len), Some(2), "{snapshot}");
    let number_of = number(&connection(&two.grpc, "right/e/sample")["id"]);
    two.grpc.ok("GcmService/Disconnect", json!({ "id": number_of }));
    watch.until("it is gone", |item| {
        let removed = item["delta"]["removedConnections"].as_array();
        removed.is_some_and(|all| all.iter().any(|id| number(id) == number_of))
    });
    assert_eq!(two.grpc.ok("GcmService/GetState", json!({ "path": "left/s" }))["connections"], json!([]));
    two.grpc.connect("right/e/sample", "left/s/value");
    let linked = |c: &Value| {
        c["client"] == "right/e/sample"
            && c["proxies"].as_array().is_some_and(|all| all.iter().all(|half| half["linked"] == true))
    };
    watch.until("both halves are linked", |item| {
        item["delta"]["connections"].as_array().is_some_and(|all| all.iter().any(linked))
    });
}

#[test]
fn what_both_halves_count_is_counted_once() {
    let two = pair();
    let row = |path: &str| two.grpc.ok("InteractService/Read", json!({ "path": path }))["json"].clone();
    eventually("an event was handled", || match row("right/client") {
        client if number(&client["events"]) > 0 => Ok(()),
        client => Err(client),
    });
    two.grpc.stop("right/client");
    let (commands, passed, events) = eventually("all that was sent has run", || {
        let commands = number(&two.grpc.component("left/server")["stats"]["commands"]);
        let c = connection(&two.grpc, "right/client/Required");
        let (passed, events) = (number(&c["passed"]), number(&row("right/client")["events"]));
        // What was queued when the client stopped never ran.
        let unexecuted = number(&c["unexecuted"]);
        if commands + events + unexecuted == passed && commands > 0 {
            Ok((commands, passed, events))
        } else {
            Err(format!("{commands} commands and {events} events ran, {passed} passed: {c}"))
        }
    });
    assert!(events > 0 && passed < 2 * (commands + events), "{commands} {events} {passed}");
    two.grpc.stop("left/s");
    let taken = eventually("the last sample is taken", || {
        let c = connection(&two.grpc, "right/e/sample");
        let steps = number(&two.grpc.component("left/s")["stats"]["executed"]);
        let (passed, dropped) = (number(&c["passed"]), number(&c["dropped"]) + number(&c["skipped"]));
        // Connected before it was started: every sample was given to it.
        if passed + dropped == steps { Ok(c) } else { Err(format!("{steps} made: {c}")) }
    });
    assert!(number(&taken["bytes"]) == 16 * number(&taken["passed"]), "a Scalar is 16 bytes: {taken}");
    assert!(number(&taken["latencyP99Ns"]) >= number(&taken["latencyP50Ns"]), "{taken}");
    assert!(number(&taken["latencyP50Ns"]) > 0, "{taken}");
}

#[test]
fn top_shows_carrier_bytes_latency_and_drops_between_processes() {
    let two = pair();
    await_flow(&two.grpc, "right/e/sample");
    let stream = eventually("something passes within an interval", || {
        let top = two.trocar().run(&["top", "--json", "-n", "1", "--interval", "0.3s"]).ends_with(0);
        let figures = &objects(&top.stdout)[0];
        let rows = figures["connections"].as_array().unwrap();
        let stream = rows.iter().find(|c| c["client"] == "right/e/sample").unwrap();
        if stream["rate_hz"].as_f64() > Some(0.0) { Ok(stream.clone()) } else { Err(stream.to_string()) }
    });
    assert_eq!((&stream["carrier"], &stream["linked"]), (&json!("memfd"), &json!(true)), "{stream}");
    for figure in ["rate_hz", "bytes_per_s", "latency_p50_ns", "latency_p99_ns"] {
        assert!(stream[figure].as_f64().is_some_and(|n| n > 0.0), "{figure}: {stream}");
    }
    two.trocar().run(&["top", "-n", "1", "--interval", "0.1s"]).ends_with(0).says("memfd");
}

#[test]
fn any_port_of_any_process_is_followed_through_the_gcm() {
    let two = pair();
    for path in ["left/s/value", "right/e/sample_out", "left/server/Provided/SetPointReached"] {
        let echo = two.trocar().run(&["echo", path, "--json", "-n", "2"]).ends_with(0);
        assert_eq!(objects(&echo.stdout)[0]["path"], path, "{echo:#?}");
        let hz = two.trocar().run(&["hz", path, "--json", "-n", "1"]).ends_with(0);
        assert_eq!(objects(&hz.stdout)[0]["path"], path, "{hz:#?}");
    }
    two.trocar().run(&["echo", "right/client", "--json", "-n", "1"]).ends_with(0).says("ACTIVE");
    two.trocar().run(&["echo", "right/client", "--delayed", "0"]).ends_with(0).says("written");
    two.trocar().run(&["echo", "right/e/sampel_out", "-n", "1"]).ends_with(1).says("sample_out");
    two.trocar()
        .run(&["hz", "left/server/Provided/SetPoint", "-n", "1"])
        .ends_with(1)
        .says("SetPointReached");
    two.trocar().run(&["echo", "middle/s/value", "-n", "1"]).ends_with(1).says("left");
    let epoch_before = epoch(&connection(&two.grpc, "right/e/sample"));
    assert!(epoch_before > 0);
}
