//! Absurd staleness, and circles of components that run in one stream.
//!
//! Promise: each is refused with a sentence that names the field or the circle; see `faults/refusals.rs` for
//! periods, histories, depths and circles of calls.

use serde_json::{Value, json};

use super::Scene;

#[test]
fn an_absurd_staleness_of_a_stream_is_refused_with_field_value_and_limits() {
    let scene = Scene::new();
    scene.grpc.create("host/camera", "camera", json!({}));
    scene.grpc.create("host/screen", "screen", json!({}));
    let connect = |options: Value| json!({ "client": "host/screen/frame", "server": "host/camera/frame", "options": options });
    for (age, shown) in [("0s", "0"), ("-1s", "-1"), ("9000000000s", "3600 s")] {
        let refused = scene.grpc.refused("GcmService/Connect", connect(json!({ "max_age": age })));
        assert_eq!(refused.violated_fields(), ["options.max_age"], "{age}: {refused}");
        assert!(refused.code == "INVALID_ARGUMENT" && refused.message.contains(shown), "{age}: {refused}");
    }
    scene.grpc.ok("GcmService/Connect", connect(json!({ "max_age": "0.5s" })));
}

#[test]
fn components_cannot_run_in_each_other_s_streams_in_a_circle() {
    let scene = Scene::new();
    let behind = |head: &str| json!({ "stream_of": head });
    scene.grpc.create("host/a", "brittle", json!({}));
    scene.grpc.create_with("host/b", "brittle", json!({}), behind("host/a"));
    for (path, head) in [("host/a", "host/b"), ("host/a", "host/a")] {
        let before = scene.grpc.component(path)["execution"].clone();
        let refused =
            scene.grpc.refused("GcmService/Configure", json!({ "path": path, "execution": behind(head) }));
        assert_eq!(refused.reason, "SYNC_CYCLE", "{path} behind {head}: {refused}");
        assert!(refused.message.contains(path) && refused.message.contains(head), "{refused}");
        assert_eq!(scene.grpc.component(path)["execution"], before, "a refused Configure changes nothing");
    }
}
