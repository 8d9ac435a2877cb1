//! How a component is brought to each of its entries, so that it misbehaves there.
//!
//! Invariant: everything up to the entry goes well; the last request of a way is the one that meets what is
//! told.

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, eventually};

/// What came of the request that met the entry.
pub(super) type Told = Result<Value, Failure>;

/// Entries met by a Configure, after the component was made and configured once.
const CONFIGURED: [&str; 3] = ["configure", "describe", "bind"];

/// Entries it meets after it has run for a while. A step may take five of its periods: at 100 Hz a machine
/// that keeps it waiting for 50 ms would bring it into FAULT before it comes there.
const RUN_UNTIL: [&str; 3] = ["stop", "make_safe", "resume"];

/// Makes a component that will misbehave in `entry` once [`reach`] comes there, and what that needs.
pub(super) fn make(grpc: &Grpcurl, path: &str, entry: &str, config: &Value) {
    let class = match entry {
        "describe" | "bind" => "shifty",
        "callback" => "hangs_in_callback",
        _ => "chaos",
    };
    let later = CONFIGURED.contains(&entry) || entry == "callback";
    let config = if later { json!({}) } else { config.clone() };
    if RUN_UNTIL.contains(&entry) {
        grpc.create_with(path, class, config, json!({ "model": "periodic", "rate_hz": 2 }));
    } else {
        grpc.create(path, class, config);
    }
    if entry == "on_event" {
        let peer = peer(path);
        grpc.create(&peer, "chaos", json!({}));
        grpc.connect(&format!("{path}/peer"), &format!("{peer}/ctl"));
        grpc.start(&peer);
    }
}

/// Brings it to the entry. Of one that hangs there this may wait as long as the server lets it, 60 s.
pub(super) fn reach(grpc: &Grpcurl, path: &str, entry: &str, config: &Value) -> Told {
    let call = |verb: &str| grpc.call(&format!("GcmService/{verb}"), json!({ "path": path }));
    let invoke = |command: &str| grpc.call("InteractService/Invoke", json!({ "path": command }));
    if CONFIGURED.contains(&entry) {
        return grpc.call("GcmService/Configure", json!({ "path": path, "config": config }));
    }
    let started = call("Start");
    match entry {
        "command" => invoke(&format!("{path}/ctl/poke")),
        "on_service" => invoke(&format!("{path}/ctl/ask")),
        "on_event" => invoke(&format!("{}/ctl/poke", peer(path))),
        "read" => eventually("a read is refused", || match invoke(&format!("{path}/ctl/steps")) {
            Err(refused) => Ok(Err(refused)),
            Ok(answer) => Err(answer),
        }),
        "stop" | "make_safe" => call("Stop"),
        "resume" => call("Stop").and_then(|_| call("Resume")),
        _ => started,
    }
}

/// Takes it away, and what was made with it.
pub(super) fn clear(grpc: &Grpcurl, path: &str) -> Told {
    let removed = grpc.call("GcmService/Remove", json!({ "path": path, "force": true }));
    // Most have none.
    let _ = grpc.call("GcmService/Remove", json!({ "path": peer(path), "force": true }));
    removed
}

fn peer(path: &str) -> String {
    format!("{path}-peer")
}
