//! Guests: shells and pages that take a place in the graph from outside, through GuestService.
//!
//! Promise: a guest, its required interfaces and its connections are seen by everybody like any others,
//! disturb nobody, and go with its stream; so does a component that a caller holds.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Stream, World, eventually};

/// A host with the example's `Server`, and a GCM of its own or elsewhere.
struct Site {
    grpc: Grpcurl,
    host: HostProcess,
    gcm: Option<HostProcess>,
    world: World,
}

impl Site {
    fn new() -> Site {
        let world = World::with_plugins(&["example"]);
        let host = HostProcess::start(&world);
        Site { grpc: host.grpcurl(), host, gcm: None, world }.with_server()
    }

    fn attached() -> Site {
        let world = World::with_plugins(&["example"]);
        let gcm = HostProcess::start_gcm(&world);
        let host = HostProcess::start_with(&world, "host", &["--gcm", gcm.address()]);
        Site { grpc: gcm.grpcurl(), host, gcm: Some(gcm), world }.with_server()
    }

    fn with_server(self) -> Site {
        self.grpc.await_class("host", "Server");
        self.grpc.create("host/server", "Server", json!({}));
        self.grpc.start("host/server");
        self
    }

    /// Joins, and answers the stream with the place that was given.
    fn join(&self, process: &str) -> (Stream, Value) {
        let asked = json!({ "process": process, "program": "a test", "pid": 4711 });
        let mut stream = self.grpc.stream("GuestService/Join", &asked);
        let place = stream.until("the place", |item| item["process"].is_string());
        (stream, place)
    }

    fn require(&self, component: &str) -> Value {
        let asked = json!({ "component": component, "server": "host/server/Provided" });
        self.grpc.ok("GuestService/Require", asked)
    }

    fn list(&self) -> Value {
        self.grpc.ok("GcmService/List", json!({}))
    }

    fn connections(&self) -> Vec<Value> {
        self.list()["connections"].as_array().cloned().unwrap_or_default()
    }

    fn has_process(&self, name: &str) -> bool {
        named(&self.list()["processes"], "name", name).is_some()
    }
}

fn named<'v>(all: &'v Value, key: &str, name: &str) -> Option<&'v Value> {
    all.as_array().into_iter().flatten().find(|one| one[key] == name)
}

fn is_seen_and_goes(site: &Site) {
    let before = site.list();
    let (stream, place) = site.join("ire");
    assert_eq!((&place["process"], &place["component"]), (&json!("ire"), &json!("ire/shell")), "{place}");
    let made = site.require("ire/shell");
    assert_eq!(made["client"], "ire/shell/Provided", "{made}");
    let commands = made["provided"]["commands"].as_array().cloned().unwrap_or_default();
    assert!(commands.iter().any(|c| c["name"] == "Write"), "{made}");

    let now = site.list();
    let process = named(&now["processes"], "name", "ire").expect("it is listed");
    assert_eq!((&process["guest"], &process["pid"]), (&json!("a test"), &json!(4711)), "{process}");
    assert_eq!(process["state"], "PROCESS_STATE_ATTACHED", "{process}");
    let component = named(&now["components"], "path", "ire/shell").expect("it is listed");
    assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
    let connection = named(&now["connections"], "client", "ire/shell/Provided").expect("it is listed");
    assert_eq!(connection["server"], "host/server/Provided");
    assert_eq!((&connection["id"], &connection["carrier"]), (&made["connection"], &json!("grpc")));
    assert_eq!(connection["proxies"], json!([]), "nobody has a half of it: {connection}");
    let told = site.grpc.ok("GcmService/Describe", json!({ "path": "ire/shell" }));
    assert_eq!(told["ports"]["required"][0]["name"], "Provided", "{told}");

    // A second one wants the same names.
    let (_other, place) = site.join("ire");
    assert_eq!(place["component"], "ire2/shell", "{place}");
    assert_eq!(site.require("ire2/shell")["client"], "ire2/shell/Provided");
    assert_eq!(site.require("ire2/shell")["client"], "ire2/shell/Provided2");

    drop(stream);
    eventually("the guest has left", || if site.has_process("ire") { Err("it is there") } else { Ok(()) });
    assert!(site.connections().iter().all(|c| c["client"] != "ire/shell/Provided"));
    assert!(site.has_process("ire2"));
    // Nobody was disturbed.
    let server = site.grpc.ok("GcmService/GetState", json!({ "path": "host/server" }));
    assert_eq!(server["component"]["state"], "COMPONENT_STATE_ACTIVE", "{server}");
    assert_eq!(before["term"], site.list()["term"]);
}

#[test]
fn a_guest_is_seen_with_what_it_requires_and_goes_with_its_stream() {
    is_seen_and_goes(&Site::new());
}

#[test]
fn a_guest_of_a_gcm_elsewhere_is_no_different() {
    is_seen_and_goes(&Site::attached());
}

#[test]
fn a_disconnect_takes_the_interface_with_it_and_a_removal_ends_the_place() {
    let site = Site::new();
    let (mut stream, _) = site.join("ire");
    let made = site.require("ire/shell");
    site.grpc.ok("GcmService/Disconnect", json!({ "id": made["connection"] }));
    let told = site.grpc.ok("GcmService/Describe", json!({ "path": "ire/shell" }));
    assert_eq!(told["ports"]["required"], json!([]), "{told}");
    site.require("ire/shell");
    // The server may go: the connection goes with it.
    site.grpc.ok("GcmService/Remove", json!({ "path": "host/server", "force": true }));
    assert_eq!(site.connections(), Vec::<Value>::new());
    // Everything is stopped and started, guests too.
    site.grpc.ok("GcmService/Stop", json!({ "paths": ["**"] }));
    site.grpc.ok("GcmService/Resume", json!({ "paths": ["ire/shell"] }));

    site.grpc.ok("GcmService/Remove", json!({ "path": "ire/shell", "force": true }));
    stream.ended("its place was taken away");
    eventually("the guest has left", || if site.has_process("ire") { Err("it is there") } else { Ok(()) });
}

fn goes_with_its_holder(site: &Site) {
    let has = |path: &str| named(&site.list()["components"], "path", path).is_some();
    let hold = || hold_of(site, "host/mine");
    // Before it is there, so that it is left behind at no time.
    let mut first = hold();
    site.grpc.create("host/mine", "Server", json!({}));
    site.grpc.start("host/mine");
    let second = hold();
    first.ended("another call holds it");
    assert!(has("host/mine"));
    drop(second);
    eventually("it went with its holder", || if has("host/mine") { Err("it is there") } else { Ok(()) });
    assert!(has("host/server"), "nobody was disturbed");

    // Removed by somebody, it is held no more, and one of its name is somebody else's.
    let mut held = hold();
    site.grpc.create("host/mine", "Server", json!({}));
    site.grpc.ok("GcmService/Remove", json!({ "path": "host/mine" }));
    held.ended("it was removed");
    site.grpc.create("host/mine", "Server", json!({}));
    drop(held);
    drop(hold_of(site, "host/other"));
    assert!(has("host/mine"));
}

fn hold_of(site: &Site, component: &str) -> Stream {
    let mut stream = site.grpc.stream("GuestService/Hold", &json!({ "component": component }));
    stream.until("it is held", |item| item["component"] == component);
    stream
}

#[test]
fn a_component_that_is_held_goes_with_its_holder() {
    goes_with_its_holder(&Site::new());
}

#[test]
fn a_component_that_a_gcm_elsewhere_holds_goes_with_its_holder() {
    goes_with_its_holder(&Site::attached());
}

#[test]
fn what_a_guest_cannot_have_is_refused_with_what_there_is() {
    let site = Site::new();
    let (_stream, _) = site.join("ire");
    let refused = |method: &str, body: Value| site.grpc.refused(method, body);
    let why =
        refused("GuestService/Require", json!({ "component": "ire/shell", "server": "host/server/Provide" }));
    assert_eq!(why.reason, "INTERFACE_NOT_FOUND", "{why}");
    assert!(why.to_string().contains("Provided"), "{why}");
    let why =
        refused("GuestService/Require", json!({ "component": "ire/shell", "server": "host/serve/Provided" }));
    assert_eq!(why.reason, "COMPONENT_NOT_FOUND", "{why}");
    let why = refused(
        "GuestService/Require",
        json!({ "component": "host/server", "server": "host/server/Provided" }),
    );
    assert!(why.to_string().contains("only guests"), "{why}");
    let named = json!({ "component": "ire/shell", "server": "host/server/Provided", "name": "arm" });
    site.grpc.ok("GuestService/Require", named.clone());
    let why = refused("GuestService/Require", named);
    assert!(why.to_string().contains("choose another name"), "{why}");
    let why = refused("GuestService/Join", json!({ "process": "../x" }));
    assert_eq!(why.reason, "BAD_PATH", "{why}");
    let why = refused("GcmService/Create", json!({ "path": "ire/other", "class": "Server" }));
    assert_eq!(why.reason, "CLASS_NOT_FOUND", "{why}");
    let why = refused("InteractService/Invoke", json!({ "path": "ire/shell/arm/Write", "json": 1 }));
    assert!(why.to_string().contains("ire/shell"), "{why}");
    // What was refused left nothing behind.
    assert_eq!(site.connections().len(), 1);
}

#[test]
fn too_many_guests_are_told_so() {
    let site = Site::new();
    let guests: Vec<_> = (0..64).map(|_| site.join("page")).collect();
    let why = site.grpc.refused("GuestService/Join", json!({ "process": "page" }));
    assert!(why.to_string().contains("64 guests"), "{why}");
    drop(guests);
    eventually("all have left", || match site.has_process("page") || site.has_process("page64") {
        true => Err("some are there"),
        false => Ok(()),
    });
    site.join("page");
}

#[test]
fn a_guest_keeps_its_connection_when_the_server_is_made_anew() {
    let site = Site::new();
    let (_stream, _) = site.join("ire");
    site.require("ire/shell");
    let kept = |what: &str| {
        let connections = site.connections();
        assert_eq!(connections.len(), 1, "{what}: {connections:?}");
        assert_eq!(connections[0]["client"], "ire/shell/Provided", "{what}");
        let told = site.grpc.ok("GcmService/Describe", json!({ "path": "ire/shell" }));
        assert_eq!(told["ports"]["required"][0]["name"], "Provided", "{what}: {told}");
    };
    site.grpc.ok("GcmService/Stop", json!({ "path": "host/server" }));
    let slower = json!({ "path": "host/server", "execution": { "model": "periodic", "rate_hz": 50 } });
    site.grpc.ok("GcmService/Configure", slower);
    kept("another execution");
    let file = json!({ "version": 1, "components": {
        "host/server": { "class": "example/Server", "execution": { "model": "periodic", "rate_hz": 25 } },
    } });
    site.grpc.ok("GcmService/Apply", json!({ "system": file.to_string(), "prune": true }));
    kept("a file with another execution");
    assert_eq!(site.grpc.component("host/server")["execution"]["period"], "0.040s");
}

#[test]
fn a_guest_keeps_its_connection_while_the_servers_process_is_made_anew() {
    let mut site = Site::attached();
    let (_stream, _) = site.join("ire");
    let made = site.require("ire/shell");
    site.host.kill();
    eventually("the host is lost", || {
        let now = site.list();
        match named(&now["processes"], "name", "host").map(|p| p["state"].clone()) {
            Some(state) if state == "PROCESS_STATE_LOST" => Ok(()),
            other => Err(format!("{other:?}")),
        }
    });
    let gcm = site.gcm.as_ref().expect("it is elsewhere").address().to_owned();
    site.host = HostProcess::start_with(&site.world, "host", &["--gcm", &gcm]);
    eventually("its server is there again", || {
        let now = site.list();
        match named(&now["components"], "path", "host/server") {
            Some(c) if c["health"] == "HEALTH_OK" && c["state"] == "COMPONENT_STATE_ACTIVE" => Ok(()),
            other => Err(format!("{other:?}")),
        }
    });
    let connections = site.connections();
    assert_eq!(connections.len(), 1, "{connections:?}");
    assert_eq!(connections[0]["id"], made["connection"], "{connections:?}");
}
