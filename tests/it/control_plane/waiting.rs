//! WaitFor an event, through real grpcurl: what a component sends while somebody waits reaches them.
//!
//! Promise: with `call` nothing is missed between asking and sending; a component that is made anew is waited
//! for, one that is removed is not; it works the same in a process of its own.

use std::thread;

use serde_json::{Value, json};
use trocar_tests::{Failure, Grpcurl, HostProcess, World, eventually, number};

type Waited = Result<Value, Failure>;

/// A host with an active echo component, `PROCESS/e`.
struct Site {
    grpc: Grpcurl,
    process: &'static str,
    _host: HostProcess,
    _gcm: Option<HostProcess>,
    _world: World,
}

impl Site {
    fn new() -> Self {
        let world = World::with_plugins(&["fixture_echo"]);
        let host = HostProcess::start(&world);
        Self { grpc: host.grpcurl(), process: "host", _host: host, _gcm: None, _world: world }.active()
    }

    /// In a process that is attached to a GCM of its own.
    fn attached() -> Self {
        let world = World::with_plugins(&["fixture_echo"]);
        let gcm = HostProcess::start_gcm(&world);
        let host = HostProcess::start_with(&world, "site", &["--gcm", gcm.address()]);
        let grpc = gcm.grpcurl();
        Self { grpc, process: "site", _host: host, _gcm: Some(gcm), _world: world }.active()
    }

    fn active(self) -> Self {
        self.grpc.await_class(self.process, "echo");
        self.grpc.create(&self.path(""), "echo", json!({}));
        self.grpc.start(&self.path(""));
        self
    }

    fn path(&self, below: &str) -> String {
        format!("{}/e{below}", self.process)
    }

    /// Waits for the event in which `write` says what was written.
    fn wait(&self, more: &Value) -> Waited {
        let mut body = json!({ "path": self.path("/ctl/echoed"), "deadline": "30s" });
        body.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap_or_default());
        self.grpc.call("GcmService/WaitFor", body)
    }

    /// Lets somebody wait, does something, then writes again and again until they are answered.
    fn answered(&self, meanwhile: impl FnOnce()) -> Waited {
        thread::scope(|scope| {
            let waiting = scope.spawn(|| self.wait(&json!({})));
            meanwhile();
            eventually("whoever waits is answered", || {
                let write = json!({ "path": self.path("/ctl/write"), "json": 4.5 });
                // Between Reset and Start nobody can be written to.
                let _ = self.grpc.call("InteractService/Invoke", write);
                if waiting.is_finished() { Ok(()) } else { Err("still waiting") }
            });
            waiting.join().unwrap()
        })
    }
}

fn nothing_is_missed(site: &Site) {
    let mut before = 0;
    for round in 0..10 {
        let call = json!({ "path": site.path("/ctl/write"), "json": f64::from(round) + 0.5 });
        let seen = site.wait(&json!({ "call": call })).unwrap_or_else(|e| panic!("round {round}: {e}"));
        assert_eq!(seen["json"], json!(f64::from(round) + 0.5), "{seen}");
        assert_eq!(seen["component"]["path"], site.path(""), "{seen}");
        assert!(number(&seen["stampNs"]) > before, "each event is stamped when it was sent: {seen}");
        before = number(&seen["stampNs"]);
    }
    let seen = site.answered(|| ()).unwrap();
    assert_eq!(seen["json"], json!(4.5), "{seen}");
}

#[test]
fn the_event_a_call_brings_about_is_not_missed() {
    nothing_is_missed(&Site::new());
}

#[test]
fn an_event_of_an_attached_process_is_waited_for_as_any_other() {
    nothing_is_missed(&Site::attached());
}

#[test]
fn a_component_that_is_reset_meanwhile_is_still_waited_for() {
    let site = Site::new();
    let seen = site.answered(|| {
        site.grpc.ok("GcmService/Reset", json!({ "path": site.path("") }));
        site.grpc.start(&site.path(""));
    });
    assert_eq!(seen.unwrap()["json"], json!(4.5));
}

#[test]
fn whoever_waits_for_a_component_that_is_removed_is_told_at_once() {
    let site = Site::new();
    let ended = site
        .answered(|| {
            site.grpc.ok("GcmService/Remove", json!({ "path": site.path(""), "force": true }));
        })
        .expect_err("nobody is there to send it");
    assert_eq!(ended.reason, "COMPONENT_NOT_FOUND", "{ended}");
}

#[test]
fn a_call_that_is_refused_ends_the_waiting_with_its_reason() {
    let site = Site::new();
    let call = json!({ "path": site.path("/ctl/write"), "json": "much" });
    let refused = site.wait(&json!({ "call": call })).expect_err("`much` is no number");
    assert_eq!(refused.reason, "ARGUMENT_INVALID", "{refused}");
    let unknown = site.grpc.refused("GcmService/WaitFor", json!({ "path": site.path("/ctl/ecoed") }));
    assert_eq!(unknown.reason, "MEMBER_NOT_FOUND", "{unknown}");
    assert!(unknown.message.contains("echoed"), "it names what exists: {unknown}");
    let output = site.grpc.refused("GcmService/WaitFor", json!({ "path": site.path("/sample_out") }));
    assert_eq!(output.reason, "BAD_PATH", "an output is followed, not waited for: {output}");
    let both = json!({ "path": site.path("/ctl/echoed"), "states": ["COMPONENT_STATE_ACTIVE"] });
    assert_eq!(site.grpc.refused("GcmService/WaitFor", both).reason, "ARGUMENT_INVALID");
}
