//! Several processes: one GCM, hosts that attach to it.
//!
//! Promise: every host is listed and controlled through the one GCM; a name is taken once; a killed host is
//! shown as lost.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually};

struct Cluster {
    world: World,
    gcm: HostProcess,
    grpc: Grpcurl,
}

impl Cluster {
    fn new(plugins: &[&str]) -> Self {
        let world = World::with_plugins(plugins);
        let gcm = HostProcess::start_gcm(&world);
        let grpc = gcm.grpcurl();
        Self { world, gcm, grpc }
    }

    fn host(&self, name: &str) -> HostProcess {
        let host = HostProcess::start_with(&self.world, name, &["--gcm", self.gcm.address()]);
        eventually(&format!("{name} is attached"), || self.process_state(name, "ATTACHED"));
        host
    }

    fn process_state(&self, name: &str, wanted: &str) -> Result<(), String> {
        let list = self.grpc.ok("GcmService/List", json!({ "brief": true }));
        let processes = list["processes"].as_array().cloned().unwrap_or_default();
        let found = processes.iter().find(|p| p["name"] == name);
        match found.and_then(|p| p["state"].as_str()) {
            Some(state) if state == format!("PROCESS_STATE_{wanted}") => Ok(()),
            other => Err(format!("{other:?} in {list}")),
        }
    }
}

#[test]
fn several_hosts_are_listed_and_controlled_through_one_gcm() {
    let cluster = Cluster::new(&["example", "sine"]);
    let (_left, _right) = (cluster.host("left"), cluster.host("right"));
    for process in ["left", "right"] {
        cluster.grpc.await_class(process, "Server");
        let path = format!("{process}/server");
        cluster.grpc.create(&path, "Server", json!({}));
        cluster.grpc.start(&path);
        cluster.grpc.invoke(&format!("{path}/Provided/Write"), json!(30));
        assert_eq!(cluster.grpc.invoke(&format!("{path}/Provided/Read"), json!(null)), json!(30), "{path}");
    }
    let plugins = cluster.grpc.plugins();
    for process in ["left", "right"] {
        assert!(plugins.iter().any(|p| p["process"] == process && p["name"] == "example"), "{plugins:#?}");
    }
    cluster.grpc.stop("**");
    assert_eq!(cluster.grpc.state("left/server"), "STOPPED");
    assert_eq!(cluster.grpc.state("right/server"), "STOPPED");
}

#[test]
fn events_and_outputs_of_an_attached_host_reach_a_subscriber_of_the_gcm() {
    let cluster = Cluster::new(&["sine"]);
    let _left = cluster.host("left");
    cluster.grpc.await_class("left", "sine");
    cluster.grpc.create("left/s", "sine", json!({}));
    cluster.grpc.start("left/s");
    let mut stream = cluster
        .grpc
        .stream("InteractService/Subscribe", &json!({ "selections": [{ "path": "left/s/value" }] }));
    stream.until("a sample from the other process", |item| item["path"] == "left/s/value");
}

#[test]
fn a_client_calls_a_server_in_another_process_once_they_are_connected() {
    let cluster = Cluster::new(&["example"]);
    let (_left, _right) = (cluster.host("left"), cluster.host("right"));
    cluster.grpc.await_class("left", "Server");
    cluster.grpc.await_class("right", "Client");
    cluster.grpc.create("left/server", "Server", json!({}));
    cluster.grpc.create("right/client", "Client", json!({}));
    let nowhere = json!({ "client": "right/client/Required", "server": "left/server/Provide" });
    assert_eq!(cluster.grpc.refused("GcmService/Connect", nowhere).reason, "INTERFACE_NOT_FOUND");
    let across = json!({ "client": "right/client/Required", "server": "left/server/Provided" });
    cluster.grpc.ok("GcmService/Connect", across.clone());
    assert_eq!(cluster.grpc.refused("GcmService/Connect", across).reason, "CONNECTION_EXISTS");
}

#[test]
fn a_name_that_is_taken_is_refused_to_the_second_host() {
    let cluster = Cluster::new(&["sine"]);
    let mut first = cluster.host("left");
    let state = cluster.world.path("second-state");
    let second = trocar_tests::Trocar::new(&cluster.world).run(&[
        "host",
        "--name",
        "left",
        "--listen",
        "127.0.0.1:0",
        "--gcm",
        cluster.gcm.address(),
        "--plugins",
        &cluster.world.plugins().display().to_string(),
        "--state",
        &state.display().to_string(),
    ]);
    let second = second.ends_with(1).says("left");
    assert!(!second.stderr.is_empty(), "the refusal is an error: {second:#?}");
    assert!(first.is_alive());
    assert_eq!(cluster.process_state("left", "ATTACHED"), Ok(()));
}

#[test]
fn a_killed_host_is_shown_as_lost_and_its_name_is_free_again() {
    let cluster = Cluster::new(&["sine"]);
    let mut left = cluster.host("left");
    cluster.grpc.await_class("left", "sine");
    cluster.grpc.create("left/s", "sine", json!({}));
    cluster.grpc.start("left/s");
    left.kill();
    eventually("left is shown as lost", || cluster.process_state("left", "LOST"));

    let refused = cluster.grpc.refused("GcmService/Create", json!({ "path": "left/t", "class": "sine" }));
    assert_eq!((refused.code, refused.reason.as_str()), ("UNAVAILABLE", "PROCESS_LOST"), "{refused}");
    let lost = cluster.grpc.component("left/s");
    assert_eq!(lost["health"], "HEALTH_LOST", "the last state is kept and marked: {lost}");

    let _again = cluster.host("left");
    let refused_or_made =
        cluster.grpc.call("GcmService/Create", json!({ "path": "left/t", "class": "sine" }));
    assert!(refused_or_made.is_ok(), "the new left takes orders: {refused_or_made:?}");
}

#[test]
fn a_stop_at_the_port_of_a_managed_host_stops_there_with_and_without_its_manager() {
    let mut cluster = Cluster::new(&["sine"]);
    let left = cluster.host("left");
    for name in ["left/a", "left/b"] {
        cluster.grpc.await_class("left", "sine");
        cluster.grpc.create(name, "sine", json!({}));
        cluster.grpc.start(name);
    }
    let stopped = |answer: &Value| {
        let all = answer["components"].as_array().unwrap().iter();
        all.map(|c| format!("{} {}", c["path"], c["state"])).collect::<Vec<_>>()
    };
    let there = left.grpcurl();
    let answer = there.ok("GcmService/Stop", json!({ "path": "left/a" }));
    assert_eq!(stopped(&answer), [r#""left/a" "COMPONENT_STATE_STOPPED""#], "{answer}");
    eventually("the manager hears of it", || match cluster.grpc.state("left/a").as_str() {
        "STOPPED" => Ok(()),
        other => Err(other.to_owned()),
    });
    cluster.gcm.kill();
    let answer = there.ok("GcmService/Stop", json!({ "path": "left/**" }));
    assert_eq!(stopped(&answer), [r#""left/b" "COMPONENT_STATE_STOPPED""#], "{answer}");
    let unknown = there.refused("GcmService/Stop", json!({ "path": "left/c" }));
    assert_eq!(unknown.reason, "COMPONENT_NOT_FOUND", "{unknown}");
}

#[test]
fn a_managed_host_says_where_its_manager_is() {
    let cluster = Cluster::new(&["sine"]);
    let left = cluster.host("left");
    let refused = left.grpcurl().refused("GcmService/Create", json!({ "path": "left/s", "class": "sine" }));
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        ("FAILED_PRECONDITION", "MANAGED_ELSEWHERE"),
        "{refused}"
    );
    assert!(refused.message.contains(cluster.gcm.address()), "it names the GCM's address: {refused}");
    let health: Value = left.grpcurl().ok("grpc.health.v1.Health/Check", json!({}));
    assert_eq!(health["status"], "SERVING");
}
