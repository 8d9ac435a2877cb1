//! Reads from outside that do not come back: plugin code that nobody can end.
//!
//! Promise: each caller is answered, the control plane goes on, the server is named, nobody else misses a
//! cycle, and the host ends.

use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl};

use super::super::manners::is_warning;
use super::Counted;

const WORDS: &str = "its reads did not come back in time and their callers got DEADLINE";

fn read(grpc: &Grpcurl, path: &str, name: &str) -> Result<Value, Failure> {
    let body = json!({ "path": format!("{path}/ctl/{name}"), "deadline": "0.3s" });
    grpc.call("InteractService/Invoke", body)
}

#[test]
fn more_reads_hang_than_there_are_processors_and_everything_else_goes_on() {
    let mut scene = Counted::new();
    let many = thread::available_parallelism().map_or(1, std::num::NonZero::get) + 2;
    let mut round = 0;
    scene.bystander.undisturbed_by("reads that hang", || {
        round += 1;
        let path = format!("host/hanging-{round}");
        scene.grpc.create(&path, "chaos", json!({ "hang_in": "read" }));
        let mut events = scene.warnings_of(&path);
        scene.grpc.start(&path);
        scene.grpc.await_state(&path, "ACTIVE");
        let callers: Vec<_> = (0..many)
            .map(|_| {
                let (grpc, path) = (scene.grpc.clone(), path.clone());
                thread::spawn(move || read(&grpc, &path, "steps"))
            })
            .collect();
        // While they hang and afterwards.
        scene.grpc.ok("GcmService/List", json!({}));
        events.until(WORDS, |item| is_warning(item, WORDS) && is_warning(item, "ctl/steps"));
        for caller in callers {
            let refused = caller.join().unwrap().expect_err("a read that hangs has no value");
            // Whoever came late enough was told at once that there is no use in waiting.
            assert!(["DEADLINE", "COMMAND_FAILED"].contains(&refused.reason.as_str()), "{refused}");
        }
        let again = read(&scene.grpc, &path, "steps").expect_err("an earlier one has not come back");
        assert!(again.message.contains("the read ctl/steps of host/hanging-"), "{again}");
        let component = scene.grpc.component(&path);
        assert!(component["stats"]["warnings"].to_string().contains(WORDS), "{component}");
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "no read ever entered it: {component}");
        scene.grpc.ok("GcmService/List", json!({}));
        scene.grpc.stop(&path);
        scene.grpc.ok("GcmService/Remove", json!({ "path": path }));
    });
    let status = scene.host.terminate();
    assert!(status.success(), "it ends although reads still hang: {status}\n{}", scene.host.printed());
}
