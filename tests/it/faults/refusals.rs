//! Absurd values, each refused with the field, the value and its limits.
//!
//! Promise: nothing is made of a refused request, and the host goes on.

use serde_json::{Value, json};

use super::Scene;

#[test]
fn absurd_executions_are_refused_with_field_value_and_limits() {
    let scene = Scene::new();
    let cases: &[(Value, &str, &[&str])] = &[
        (json!({ "period": "0s" }), "execution.period", &["0 ns", "1 µs to 3600 s"]),
        (json!({ "period": "-1s" }), "execution.period", &["-1"]),
        (json!({ "period": "0.000000001s" }), "execution.period", &["1 ns", "1 µs to 3600 s"]),
        (json!({ "period": "3600.000000001s" }), "execution.period", &["1 µs to 3600 s"]),
        (json!({ "period": "9000000000s" }), "execution.period", &["1 µs to 3600 s"]),
        (json!({ "rate_hz": -5 }), "execution.rate_hz", &["-5"]),
        (json!({ "rate_hz": 1e300 }), "execution.rate_hz", &["1e300 Hz", "one step an hour to 1000000 Hz"]),
        (json!({ "rate_hz": 1e-300 }), "execution.rate_hz", &["1e-300 Hz", "one step an hour to 1000000 Hz"]),
        (json!({ "rate_hz": "NaN" }), "execution.rate_hz", &["NaN"]),
        (json!({ "rate_hz": "Infinity" }), "execution.rate_hz", &["inf"]),
        (json!({ "history": 0 }), "execution.history", &["0 rows", "3 to 65536"]),
        (json!({ "history": 2 }), "execution.history", &["2 rows", "3 to 65536"]),
        (json!({ "history": 4_294_967_295_u32 }), "execution.history", &["4294967295 rows", "3 to 65536"]),
        (json!({ "phase": "10s" }), "execution.phase", &["10 s", "below the period"]),
        (json!({ "phase": "-1s" }), "execution.phase", &["-1"]),
        (json!({ "catch_up": 1001 }), "execution.catch_up", &["1001", "1000"]),
        (json!({ "priority": 0 }), "execution.priority", &["0", "1 to 99"]),
        (json!({ "priority": 4000 }), "execution.priority", &["4000", "1 to 99"]),
        (json!({ "model": "stream", "threads": 0 }), "execution.threads", &["0", "1 to 64"]),
        (json!({ "model": "stream", "threads": 65 }), "execution.threads", &["65", "1 to 64"]),
        (json!({ "max_step": "0s" }), "execution.max_step", &["0", "100 µs to 3600 s"]),
        (json!({ "cpus": [4096] }), "execution.cpus", &["4096", "0 to 4095"]),
        (json!({ "model": "warp" }), "execution.model", &["warp", "periodic"]),
    ];
    scene.grpc.create("host/d", "chaos", json!({}));
    let before = scene.grpc.component("host/d")["execution"].clone();
    let create = json!({ "path": "host/c", "class": "chaos" });
    let configure = json!({ "path": "host/d" });
    let verbs = [("GcmService/Create", create), ("GcmService/Configure", configure)];
    let mut wrong = Vec::new();
    for ((execution, field, words), (verb, body)) in
        cases.iter().flat_map(|c| verbs.iter().map(move |v| (c, v)))
    {
        let mut body = body.clone();
        body["execution"] = execution.clone();
        match scene.grpc.call(verb, body) {
            Ok(answer) => {
                wrong.push(format!("{verb} {execution} was accepted: {answer}"));
                let _ = scene.grpc.call("GcmService/Remove", json!({ "path": "host/c", "force": true }));
            }
            Err(refused) => {
                let fields = refused.violated_fields();
                let named =
                    fields.iter().any(|f| f == field) && words.iter().all(|w| refused.message.contains(w));
                if !named || refused.code != "INVALID_ARGUMENT" {
                    wrong.push(format!(
                        "{verb} {execution}: {field} {words:?} expected: {fields:?} {refused}"
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(scene.grpc.component("host/d")["execution"], before, "a refused Configure changes nothing");
    scene.grpc.start("host/d");
    assert_eq!(scene.grpc.state("host/s"), "ACTIVE", "the host goes on");
}

#[test]
fn a_history_that_takes_too_many_bytes_is_refused_with_rows_bytes_and_the_limit() {
    let scene = Scene::new();
    let rows = |n: u64| json!({ "history": n });
    let wide = |n: u64| json!({ "path": "host/w", "class": "wide", "execution": rows(n) });
    // 32768 rows of 8 KiB are 256 MiB, exactly what is allowed.
    let refused = scene.grpc.refused("GcmService/Create", wide(32_769));
    assert_eq!(refused.violated_fields(), ["execution.history"], "{refused}");
    for word in ["32769 rows of 8192 bytes", "256 MiB"] {
        assert!(refused.message.contains(word), "{refused}");
    }
    scene.grpc.create_with("host/w", "wide", json!({}), rows(16));
    let refused =
        scene.grpc.refused("GcmService/Configure", json!({ "path": "host/w", "execution": rows(65_536) }));
    assert_eq!(refused.violated_fields(), ["execution.history"], "{refused}");
    assert_eq!(scene.grpc.component("host/w")["execution"]["history"], 16, "nothing is changed");
    scene.grpc.start("host/w");
}

#[test]
fn absurd_depths_of_queues_and_mailboxes_are_refused_with_field_value_and_limits() {
    let scene = Scene::new();
    scene.grpc.create("host/a", "chaos", json!({}));
    scene.grpc.create("host/b", "chaos", json!({}));
    let cases: &[(Value, &str, &[&str])] = &[
        (json!({ "mailbox": 0 }), "options.mailbox", &["0", "1 to 65536"]),
        (json!({ "mailbox": 65_537 }), "options.mailbox", &["65537", "1 to 65536"]),
        (json!({ "mailbox": 4_294_967_295_u32 }), "options.mailbox", &["4294967295", "1 to 65536"]),
        (json!({ "queue": { "fifo": 8 } }), "options.queue", &["mailbox"]),
        (json!({ "deadline": "0s" }), "options.deadline", &["1 ns to 3600 s"]),
        (json!({ "deadline": "-1s" }), "options.deadline", &["-1"]),
        (json!({ "deadline": "9000000000s" }), "options.deadline", &["1 ns to 3600 s"]),
        (json!({ "carrier": "pigeon" }), "options.carrier", &["pigeon", "inline"]),
    ];
    let mut wrong = Vec::new();
    for (options, field, words) in cases {
        let body = json!({ "client": "host/a/peer", "server": "host/b/ctl", "options": options });
        match scene.grpc.call("GcmService/Connect", body) {
            Ok(answer) => wrong.push(format!("{options} was accepted: {answer}")),
            Err(refused) => {
                let fields = refused.violated_fields();
                let named =
                    fields.iter().any(|f| f == field) && words.iter().all(|w| refused.message.contains(w));
                if !named || refused.code != "INVALID_ARGUMENT" {
                    wrong.push(format!("{options}: {field} {words:?} expected: {fields:?} {refused}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    scene.grpc.connect("host/a/peer", "host/b/ctl");
}

#[test]
fn an_absurd_depth_of_a_stream_is_refused_with_field_value_and_limits() {
    let scene = Scene::new();
    scene.grpc.await_class("host", "echo");
    scene.grpc.create("host/e", "echo", json!({}));
    for depth in [65_537, u32::MAX] {
        let options = json!({ "queue": { "fifo": depth } });
        let body = json!({ "client": "host/e/sample", "server": "host/s/value", "options": options });
        let refused = scene.grpc.refused("GcmService/Connect", body);
        assert_eq!(refused.violated_fields(), ["options.queue.fifo"], "{refused}");
        let words = format!("room for {depth} is outside 1 to 65536");
        assert!(refused.message.contains(&words), "{refused}");
    }
    scene.grpc.connect("host/e/sample", "host/s/value");
}

#[test]
fn components_cannot_run_inside_each_other_in_a_circle() {
    let scene = Scene::new();
    let inside = |host: &str| json!({ "model": "exec_in", "inside": host });
    scene.grpc.create("host/a", "chaos", json!({}));
    scene.grpc.create_with("host/b", "chaos", json!({}), inside("host/a"));
    scene.grpc.create_with("host/c", "chaos", json!({}), inside("host/b"));
    for (path, host) in
        [("host/a", "host/c"), ("host/a", "host/b"), ("host/a", "host/a"), ("host/b", "host/c")]
    {
        let body = json!({ "path": path, "execution": inside(host) });
        let refused = scene.grpc.refused("GcmService/Configure", body);
        assert_eq!(refused.reason, "SYNC_CYCLE", "{path} inside {host}: {refused}");
        assert!(refused.message.contains(path) && refused.message.contains(host), "{refused}");
    }
    for path in ["host/a", "host/b", "host/c"] {
        scene.grpc.start(path);
    }
    scene.grpc.await_state("host/c", "ACTIVE");
}

#[test]
fn passive_components_that_call_each_other_in_a_circle_neither_hang_nor_call_for_ever() {
    let scene = Scene::new();
    for path in ["host/a", "host/b", "host/c"] {
        scene.grpc.create_with(path, "chaos", json!({}), json!({ "model": "none" }));
    }
    for (client, server) in [("host/a", "host/b"), ("host/b", "host/c"), ("host/c", "host/a")] {
        scene.grpc.connect(&format!("{client}/peer"), &format!("{server}/ctl"));
    }
    for path in ["host/a", "host/b", "host/c"] {
        scene.grpc.start(path);
    }
    // Where the circle closes somebody is inside already, who is not entered again.
    let asked = scene.grpc.invoke("host/a/ctl/relay", Value::Null);
    assert_eq!(
        asked.to_string().trim_matches(['"', '\\']),
        "2",
        "two others are asked, and not the first again"
    );
    for path in ["host/a", "host/b", "host/c"] {
        scene.grpc.invoke(&format!("{path}/ctl/count"), Value::Null);
        assert_eq!(scene.grpc.state(path), "ACTIVE");
    }
}

#[test]
fn inline_connections_cannot_close_a_circle() {
    let scene = Scene::new();
    for path in ["host/a", "host/b", "host/c"] {
        scene.grpc.create_with(path, "chaos", json!({}), json!({ "model": "none" }));
    }
    let inline = |client: &str, server: &str| json!({ "client": client, "server": server, "options": { "carrier": "inline" } });
    scene.grpc.ok("GcmService/Connect", inline("host/a/peer", "host/b/ctl"));
    scene.grpc.ok("GcmService/Connect", inline("host/b/peer", "host/c/ctl"));
    for (server, circle) in
        [("host/a/ctl", ["host/a", "host/b", "host/c"].as_slice()), ("host/c/ctl", &["host/c"])]
    {
        let refused = scene.grpc.refused("GcmService/Connect", inline("host/c/peer", server));
        assert_eq!(refused.reason, "SYNC_CYCLE", "{refused}");
        assert!(circle.iter().all(|member| refused.message.contains(member)), "the whole circle: {refused}");
    }
    assert_eq!(scene.grpc.state("host/s"), "ACTIVE", "the host goes on");
}
