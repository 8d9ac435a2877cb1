//! A queue of one place before a component that does not come on.
//!
//! Promise: whoever finds it full is told at once; what was turned away is counted for the connection and for
//! the component; what was taken runs.

use serde_json::{Value, json};
use trocar_tests::{Stream, number};

use super::Scene;

/// `host/sender` before `host/p`, with room for one command, and a key.
fn one_place() -> Scene {
    let scene = Scene::new();
    scene.pace("host/p", json!({ "rate_hz": 100 }), json!({}));
    scene.grpc.create("host/key", "key", json!({}));
    scene.grpc.create("host/sender", "sender", json!({}));
    let options = json!({ "mailbox": 1 });
    let body = json!({ "client": "host/sender/peer", "server": "host/p/ctl", "options": options });
    scene.grpc.ok("GcmService/Connect", body);
    scene.grpc.start("host/key");
    scene.grpc.start("host/sender");
    scene
}

impl Scene {
    /// Lets `host/p` hang in its step, and comes back when it does.
    pub(super) fn hang(&self, path: &str) -> Stream {
        let mut events = self.follow(path, "warning");
        self.grpc.invoke(&format!("{path}/ctl/hang"), Value::Null);
        let words = "it has not come back out of its step";
        events.until(words, |item| super::says(item, words));
        events
    }

    /// Queued, turned away by a full queue, by a component that is not active, otherwise.
    fn send(&self, times: u64) -> [u64; 4] {
        let answer = self.grpc.invoke("host/sender/ctl/send", json!(times));
        [0, 1, 2, 3].map(|at| number(&answer[at]))
    }
}

#[test]
fn a_queue_of_one_before_a_hanging_component_takes_one_and_counts_the_others() {
    let scene = one_place();
    scene.hang("host/p");
    assert_eq!(scene.send(5), [1, 4, 0, 0], "one place, and nobody empties it");
    assert_eq!(scene.send(2), [0, 2, 0, 0]);

    let connection = scene.connection("host/sender/peer");
    for (figure, expected) in [("depth", 1), ("rejected", 6), ("dropped", 6), ("highWater", 1), ("passed", 1)]
    {
        assert_eq!(number(&connection[figure]), expected, "{figure} of the connection: {connection}");
    }
    for component in [scene.grpc.component("host/p"), scene.listed("host/p")] {
        assert_eq!(number(&component["stats"]["commandsRejected"]), 6, "GetState and List: {component}");
        assert_eq!(component["health"], "HEALTH_UNRESPONSIVE", "{component}");
    }
    let sender = scene.grpc.component("host/sender");
    assert_eq!(sender["health"], "HEALTH_OK", "whoever sends goes on: {sender}");

    scene.grpc.invoke("host/key/ctl/release", Value::Null);
    scene.until("host/p", "pokes", 1);
    scene.until_health("host/p", "OK");
    assert_eq!(scene.send(1), [1, 0, 0, 0], "there is room again");
    scene.until("host/p", "pokes", 2);
    let connection = scene.connection("host/sender/peer");
    assert_eq!((number(&connection["rejected"]), number(&connection["passed"])), (6, 2), "{connection}");
}

#[test]
fn invoke_fills_the_outer_queue_of_a_hanging_component_to_its_depth_and_is_then_refused() {
    let scene = one_place();
    scene.hang("host/p");
    let send = json!({ "path": "host/p/ctl/poke", "json": 1, "send": true });
    let mut taken = 0;
    let refused = loop {
        match scene.grpc.call("InteractService/Invoke", send.clone()) {
            Ok(answer) => assert_eq!(answer["executed"], false, "it is queued: {answer}"),
            Err(refused) => break refused,
        }
        taken += 1;
        assert!(taken <= 65_536, "a queue that is never full");
    };
    assert_eq!((refused.code, refused.reason.as_str()), ("RESOURCE_EXHAUSTED", "QUEUE_FULL"), "{refused}");
    assert!(refused.message.contains(&taken.to_string()), "the depth of {taken} is named: {refused}");
    for more in 2..=4 {
        assert_eq!(scene.grpc.refused("InteractService/Invoke", send.clone()).reason, "QUEUE_FULL");
        assert_eq!(number(&scene.stats("host/p")["commandsRejected"]), more, "each refusal is counted");
    }
    // One that waits for its answer does not wait for a place.
    let waits = json!({ "path": "host/p/ctl/ask", "deadline": "30s" });
    assert_eq!(scene.grpc.refused("InteractService/Invoke", waits).reason, "QUEUE_FULL");
    // The places of its peers are their own.
    assert_eq!(scene.send(1), [1, 0, 0, 0]);

    scene.grpc.invoke("host/key/ctl/release", Value::Null);
    scene.until("host/p", "pokes", taken + 1);
    assert_eq!(
        number(&scene.grpc.invoke("host/p/ctl/ask", Value::Null)),
        taken + 1,
        "each that was taken ran once"
    );
}

#[test]
fn a_stopped_component_answers_that_it_is_not_active_and_fills_no_queue() {
    let scene = one_place();
    scene.grpc.stop("host/p");
    assert_eq!(scene.send(5), [0, 0, 5, 0], "told at once, nothing is kept for later");
    for send in [true, false] {
        let body = json!({ "path": "host/p/ctl/poke", "json": 1, "send": send });
        let refused = scene.grpc.refused("InteractService/Invoke", body);
        assert_eq!(
            (refused.code, refused.reason.as_str()),
            ("FAILED_PRECONDITION", "NOT_ACTIVE"),
            "{refused}"
        );
    }
    let connection = scene.connection("host/sender/peer");
    for figure in ["passed", "rejected", "dropped", "highWater"] {
        assert_eq!(number(&connection[figure]), 0, "{figure}: {connection}");
    }
    assert_eq!(number(&scene.stats("host/p")["commandsRejected"]), 0);
    scene.grpc.ok("GcmService/Resume", json!({ "path": "host/p" }));
    assert_eq!(scene.send(1), [1, 0, 0, 0]);
    scene.until("host/p", "pokes", 1);
}
