//! How a thread is told that something has come: woken, or looking by itself at each period.
//!
//! A period of an hour shows the difference without a clock: who is woken answers now, who looks by itself
//! not within any deadline.

use serde_json::{Value, json};
use trocar_tests::Grpcurl;

use super::{await_linked, connection, pair};

fn wakes(connection: &Value) -> (&str, &str) {
    let of = |key: &str| connection[key].as_str().unwrap_or_default();
    (of("clientWake"), of("serverWake"))
}

/// An echo that steps once an hour.
fn hourly(grpc: &Grpcurl, path: &str, wake: Value) {
    let mut execution = json!({ "model": "periodic", "period": "3600s" });
    if !wake.is_null() {
        execution["wake"] = wake;
    }
    grpc.create_with(path, "echo", json!({}), execution);
}

#[test]
fn who_is_woken_answers_between_its_periods_and_who_looks_by_itself_does_not() {
    let two = pair();
    let grpc = &two.grpc;
    for (path, wake) in
        [("right/told", Value::Null), ("right/woken", json!("signal")), ("right/looks", json!("poll"))]
    {
        hourly(grpc, path, wake);
        grpc.start(path);
    }
    let ask = |path: &str, deadline: &str| {
        let body = json!({ "path": format!("{path}/ctl/write_return"), "json": 4.5, "deadline": deadline });
        grpc.call("InteractService/Invoke", body)
    };
    for path in ["right/told", "right/woken"] {
        assert_eq!(ask(path, "40s").unwrap_or_else(|e| panic!("{path}: {e}"))["json"], json!(4.5), "{path}");
    }
    let late = ask("right/looks", "0.05s").expect_err("its next look is within the hour");
    assert_eq!(late.code, "DEADLINE_EXCEEDED", "{late}");
}

#[test]
fn list_shows_how_each_end_of_a_connection_is_told() {
    let two = pair();
    let grpc = &two.grpc;
    let fast = json!({ "model": "periodic", "rate_hz": 1000 });
    grpc.create_with("right/fast", "echo", json!({}), fast);
    hourly(grpc, "right/looks", json!("poll"));
    grpc.create("right/s", "sine", json!({}));
    for (client, server) in [
        ("right/fast/peer", "right/looks/ctl"),
        ("right/looks/peer", "right/e/ctl"),
        ("right/e/peer", "right/fast/ctl"),
        ("right/fast/sample", "right/s/value"),
        ("right/looks/sample", "left/s/value"),
    ] {
        grpc.connect(client, server);
    }
    assert_eq!(wakes(&connection(grpc, "right/fast/peer")), ("poll", "poll"), "1 kHz looks often enough");
    assert_eq!(wakes(&connection(grpc, "right/looks/peer")), ("poll", "signal"));
    assert_eq!(wakes(&connection(grpc, "right/e/peer")), ("signal", "poll"));
    assert_eq!(wakes(&connection(grpc, "right/fast/sample")), ("poll", ""), "nothing comes to an output");
    assert_eq!(wakes(&await_linked(grpc, "right/looks/sample", 0)), ("poll", ""), "each half knows its own");
    assert_eq!(
        wakes(&await_linked(grpc, "right/client/Required", 0)),
        ("signal", "signal"),
        "so do halves of calls"
    );
    two.trocar()
        .run(&["describe", "right/looks"])
        .ends_with(0)
        .says("wake poll")
        .says("wake of the client: poll");
}

#[test]
fn a_wake_that_cannot_be_is_refused_in_its_place() {
    let two = pair();
    let cases = [
        (json!({ "wake": "nudge" }), "nudge"),
        (json!({ "model": "on_signal", "wake": "poll" }), "would never look"),
        (json!({ "model": "none", "wake": "signal" }), "no thread"),
        (json!({ "model": "exec_out", "inside": "right/e", "wake": "signal" }), "right/e"),
    ];
    for (execution, why) in cases {
        let body = json!({ "path": "right/x", "class": "echo", "execution": execution });
        let refused = two.grpc.refused("GcmService/Create", body);
        assert_eq!(refused.violated_fields(), ["execution.wake"], "{refused}");
        assert!(refused.message.contains(why), "{why}: {refused}");
    }
}
