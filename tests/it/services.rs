//! Dynamic component services: a component builds, changes and takes apart the system it is part of.
//!
//! Promise: what a component asks for is what grpcurl would have asked for; it never waits, may stop or
//! remove itself, is refused from `step`, and hears of every request but those it is no longer there for.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually, number};

/// A host with an architect in it, `PROCESS/architect`.
struct Site {
    grpc: Grpcurl,
    path: String,
    host: HostProcess,
    gcm: Option<HostProcess>,
    _world: World,
}

impl Site {
    /// In a host with a GCM of its own.
    fn new() -> Self {
        let world = World::with_plugins(&["fixture_architect"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        Self::with(grpc, "host", host, None, world)
    }

    /// In a host that is attached to a GCM elsewhere.
    fn attached() -> Self {
        let world = World::with_plugins(&["fixture_architect"]);
        let gcm = HostProcess::start_gcm(&world);
        let host = HostProcess::start_with(&world, "site", &["--gcm", gcm.address()]);
        Self::with(gcm.grpcurl(), "site", host, Some(gcm), world)
    }

    fn with(grpc: Grpcurl, process: &str, host: HostProcess, gcm: Option<HostProcess>, world: World) -> Self {
        let path = format!("{process}/architect");
        grpc.await_class(process, "architect");
        grpc.create(&path, "architect", json!({}));
        grpc.start(&path);
        Self { grpc, path, host, gcm, _world: world }
    }

    fn ctl(&self, command: &str, arg: Value) -> Value {
        self.grpc.invoke(&format!("{}/ctl/{command}", self.path), arg)
    }

    /// What the component knows.
    fn knows(&self) -> Value {
        self.grpc.ok("InteractService/Read", json!({ "path": self.path }))["json"].clone()
    }

    fn until(&self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        eventually(what, || {
            let known = self.knows();
            if wanted(&known) { Ok(known) } else { Err(known.to_string()) }
        })
    }

    /// Asks for anything and waits for the reply.
    fn ask(&self, request: &Value) -> Value {
        self.ask_text(&request.to_string())
    }

    fn ask_text(&self, request: &str) -> Value {
        let before = number(&self.knows()["token"]);
        assert_eq!(self.ctl("ask", json!(request)), json!("Queued"), "{request}");
        let known = self.until("the reply arrives", |known| number(&known["token"]) > before);
        let reply = known["last"].as_str().unwrap();
        serde_json::from_str(reply).unwrap_or_else(|e| panic!("{e}: {reply}"))
    }

    fn exists(&self, path: &str) -> bool {
        self.grpc.call("GcmService/GetState", json!({ "path": path })).is_ok()
    }
}

fn builds_and_tears_down(site: &Site) {
    let process = site.path.split('/').next().unwrap().to_owned();
    for round in 1..=3 {
        site.ctl("build", json!(null));
        site.until("the graph is built", |known| number(&known["finished"]) == 2 * round - 1);
        for name in ["left", "right"] {
            assert_eq!(site.grpc.state(&format!("{process}/{name}")), "ACTIVE", "{name}");
        }
        let right = site.grpc.ok("GcmService/Describe", json!({ "path": format!("{process}/right") }));
        assert_eq!(right["connections"].as_array().map(Vec::len), Some(1), "{right}");
        site.ctl("tear_down", json!(null));
        let known = site.until("the graph is gone", |known| number(&known["finished"]) == 2 * round);
        assert_eq!(number(&known["refused"]), 0, "{known}");
        assert!(!site.exists(&format!("{process}/left")) && !site.exists(&format!("{process}/right")));
    }
}

#[test]
fn a_component_builds_a_graph_and_tears_it_down() {
    builds_and_tears_down(&Site::new());
}

#[test]
fn a_component_builds_a_graph_through_a_gcm_in_another_process() {
    let site = Site::attached();
    builds_and_tears_down(&site);
    let printed = site.gcm.as_ref().unwrap().printed();
    assert!(printed.contains("site/architect through "), "the audit line names the component:\n{printed}");
}

#[test]
fn the_audit_line_names_the_component_that_asked() {
    let site = Site::new();
    site.ask(&json!({ "verb": "Create", "path": "host/b", "class": "brick" }));
    let printed = site.host.printed();
    assert!(printed.contains("host/architect asked "), "{printed}");
}

#[test]
fn a_reply_is_what_grpcurl_would_have_been_told() {
    let site = Site::new();
    let reply = site.ask(&json!({ "verb": "GetState", "path": "host/architect" }));
    assert_eq!(reply["ok"], json!(true), "{reply}");
    assert_eq!(reply["response"]["component"]["state"], json!("COMPONENT_STATE_ACTIVE"), "{reply}");
    let refused = site.ask(&json!({ "verb": "GetState", "path": "host/nobody" }));
    let told = site.grpc.refused("GcmService/GetState", json!({ "path": "host/nobody" }));
    assert_eq!(refused["ok"], json!(false));
    assert_eq!(refused["code"], json!(told.code));
    assert_eq!(refused["reason"], json!(told.reason));
    assert_eq!(refused["message"], json!(told.message));
}

#[test]
fn the_same_request_id_gets_the_same_answer_and_nothing_is_done_twice() {
    let site = Site::new();
    let create = json!({ "verb": "Create", "path": "host/b", "class": "brick", "requestId": "once" });
    let (first, revision) = (site.ask(&create), site.grpc.revision());
    let again = site.ask(&create);
    assert_eq!(first, again);
    assert_eq!(site.grpc.revision(), revision, "nothing was done twice");
}

#[test]
fn asking_from_step_is_refused_and_the_component_goes_on() {
    let site = Site::new();
    site.ctl("ask_from_step", json!(null));
    let known = site.until("it has asked", |known| known["from_step"] != "");
    assert_eq!(known["from_step"], json!("WouldBlock"));
    assert_eq!(site.grpc.state("host/architect"), "ACTIVE");
    assert_eq!(site.ask(&json!({ "verb": "List", "brief": true }))["ok"], json!(true), "commands may ask");
}

#[test]
fn every_entry_but_step_may_ask() {
    let site = Site::new();
    for entry in ["configure", "start", "stop", "resume"] {
        let path = format!("host/asks-in-{entry}");
        site.grpc.create(&path, "architect", json!({ "asks_in": entry }));
        site.grpc.start(&path);
        site.grpc.stop(&path);
        site.grpc.ok("GcmService/Resume", json!({ "path": path }));
        eventually(&format!("{path} is answered"), || {
            let known = site.grpc.ok("InteractService/Read", json!({ "path": path }))["json"].clone();
            if number(&known["granted"]) == 1 { Ok(()) } else { Err(known.to_string()) }
        });
    }
}

#[test]
fn a_panic_in_the_reply_handler_faults_its_component_alone() {
    let site = Site::new();
    site.grpc.create("host/other", "architect", json!({ "panic_on_reply": true, "asks_in": "start" }));
    site.grpc.start("host/other");
    site.grpc.await_state("host/other", "FAULT");
    let fault = site.grpc.component("host/other")["fault"].to_string();
    assert!(fault.contains("on_service"), "{fault}");
    assert_eq!(site.ask(&json!({ "verb": "List", "brief": true }))["ok"], json!(true));
}

#[test]
fn a_thread_of_the_component_may_ask() {
    let site = Site::new();
    assert_eq!(site.ctl("ask_from_thread", json!(null)), json!("Queued"));
    site.until("the reply is handed to the component", |known| number(&known["granted"]) == 1);
}

#[test]
fn what_names_no_service_is_refused_at_once_and_the_verbs_are_listed() {
    let site = Site::new();
    for request in [
        json!("{}"),
        json!("GetState"),
        json!("[]"),
        json!("{\"verb\":\"Destroy\"}"),
        json!("{\"verb\":\"List\""),
        json!(""),
    ] {
        assert_eq!(site.ctl("ask", request.clone()), json!("InvalidArgument"), "{request}");
    }
    let lines = eventually("the log names the verbs", || {
        let printed = site.host.printed();
        if printed.contains("Disconnect, Apply, GetState") { Ok(printed) } else { Err(printed) }
    });
    assert!(lines.contains("host/architect"), "{lines}");
    assert_eq!(number(&site.knows()["token"]), 0, "no reply follows a refusal");
}

#[test]
fn a_known_verb_with_wrong_fields_is_refused_in_the_reply() {
    let site = Site::new();
    for (request, part) in [
        (r#"{"verb":"Create","pth":"host/b"}"#, "pth"),
        (r#"{"verb":"Create","path":5}"#, "string"),
        (r#"{"verb":"Create","path":"host/b","class":"brick",}"#, "JSON"),
        (r#"{"verb":"Create","path":"host/b"}"#, "class"),
        (r#"{"verb":"Watch"}"#, "WaitFor"),
    ] {
        let reply = site.ask_text(request);
        assert_eq!(reply["ok"], json!(false), "{request}: {reply}");
        assert_eq!(reply["code"], json!("INVALID_ARGUMENT"), "{request}: {reply}");
        assert!(reply["message"].as_str().unwrap().contains(part), "{request}: {reply}");
    }
}

#[test]
fn a_component_that_asks_without_end_is_told_that_its_queue_is_full() {
    let site = Site::new();
    assert_eq!(site.ctl("flood", json!(1000)), json!(64));
    site.until("every request that was taken is answered", |known| number(&known["granted"]) == 64);
    assert_eq!(site.ctl("flood", json!(10)), json!(10), "there is room again");
}

#[test]
fn a_component_may_stop_itself_and_hears_of_it() {
    let site = Site::new();
    assert_eq!(site.ctl("stop_self", json!(null)), json!("Queued"));
    site.grpc.await_state("host/architect", "STOPPED");
    site.until("the reply arrives in STOPPED", |known| number(&known["granted"]) == 1);
    site.grpc.ok("GcmService/Resume", json!({ "path": "host/architect" }));
    assert_eq!(site.ask(&json!({ "verb": "List", "brief": true }))["ok"], json!(true));
}

#[test]
fn a_component_may_remove_itself() {
    let site = Site::new();
    assert_eq!(site.ctl("remove_self", json!(null)), json!("Queued"));
    eventually("it is gone", || if site.exists("host/architect") { Err("still there") } else { Ok(()) });
    site.grpc.create("host/architect", "architect", json!({}));
    assert_eq!(number(&site.knows()["granted"]), 0, "the reply is not handed to its successor");
}

#[test]
fn a_component_may_reset_itself_and_its_successor_hears_nothing() {
    let site = Site::new();
    let reset = json!({ "verb": "Reset", "path": "host/architect" }).to_string();
    assert_eq!(site.ctl("ask", json!(reset)), json!("Queued"));
    site.grpc.await_state("host/architect", "READY");
    site.grpc.start("host/architect");
    // Its own first answered request comes after whatever the reply to Reset would have been.
    assert_eq!(site.ask(&json!({ "verb": "List", "brief": true }))["ok"], json!(true));
    assert_eq!(number(&site.knows()["granted"]), 1);
}

#[test]
fn a_lost_gcm_is_named_in_the_reply() {
    let mut site = Site::attached();
    assert_eq!(site.ask(&json!({ "verb": "List", "brief": true }))["ok"], json!(true));
    // From now on it is asked past its GCM, at its own process's port.
    site.grpc = site.host.grpcurl();
    site.gcm.as_mut().unwrap().kill();
    let reply = site.ask(&json!({ "verb": "List", "brief": true }));
    assert_eq!((&reply["code"], &reply["reason"]), (&json!("UNAVAILABLE"), &json!("NO_GCM")), "{reply}");
    assert!(reply["message"].as_str().unwrap().contains(site.gcm.as_ref().unwrap().address()), "{reply}");
}
