//! What cannot be connected across processes, refused before anything is made.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually};

use super::{connections, is_linked, pair};

fn connect(client: &str, server: &str, options: Value) -> Value {
    json!({ "client": client, "server": server, "options": options })
}

#[test]
fn a_carrier_that_cannot_be_had_is_refused_with_those_that_can() {
    let two = pair();
    two.grpc.create("right/second", "echo", json!({}));
    two.grpc.create("right/s", "sine", json!({}));
    two.grpc.create("right/inside", "sine", json!({}));
    let cases = [
        ("left/s/value", "heap", "possible is \"memfd\"", "two processes"),
        ("left/s/value", "inline", "possible is \"memfd\"", "left and right"),
        ("right/s/value", "inline", "possible is \"heap\", \"memfd\"", "threads of their own"),
        ("right/s/value", "inline", "possible is \"heap\"", "right/s"),
        ("left/s/value", "pigeon", "\"inline\", \"heap\", \"memfd\"", "pigeon"),
    ];
    for (server, carrier, possible, why) in cases {
        let body = connect("right/second/sample", server, json!({ "carrier": carrier }));
        let refused = two.grpc.refused("GcmService/Connect", body);
        assert_eq!(refused.code, "INVALID_ARGUMENT", "{refused}");
        assert_eq!(refused.violated_fields(), ["options.carrier"], "{refused}");
        assert!(refused.message.contains(possible) && refused.message.contains(why), "{carrier}: {refused}");
    }
    assert_eq!(connections(&two.grpc).len(), 2, "nothing was made");
    two.grpc.ok(
        "GcmService/Connect",
        connect("right/second/sample", "left/s/value", json!({ "carrier": "memfd" })),
    );
    let pinned = super::connection(&two.grpc, "right/second/sample");
    assert_eq!((&pinned["carrier"], &pinned["options"]["carrier"]), (&json!("memfd"), &json!("memfd")));
    two.trocar().run(&["describe", "right/second"]).ends_with(0).says("pinned to memfd");
    two.trocar().run(&["disconnect", "right/second/sample"]).ends_with(0);
    two.trocar()
        .run(&["connect", "right/second/sample", "right/s/value", "--carrier", "inline"])
        .ends_with(1)
        .says("possible is \"heap\"");
    two.trocar().run(&["connect", "right/second/sample", "right/s/value", "--carrier", "heap"]).ends_with(0);
}

#[test]
fn memory_that_both_ends_map_can_be_had_inside_one_process_where_it_is_pinned() {
    let two = pair();
    two.grpc.create("right/s", "sine", json!({}));
    two.grpc.create("right/second", "echo", json!({}));
    let shared = || json!({ "carrier": "memfd" });
    two.grpc.ok("GcmService/Connect", connect("right/second/sample", "right/s/value", shared()));
    two.grpc.ok("GcmService/Connect", connect("right/second/peer", "right/e/ctl", shared()));
    two.grpc.start("right/s");
    two.grpc.start("right/second");
    super::await_flow(&two.grpc, "right/second/sample");
    for client in ["right/second/sample", "right/second/peer"] {
        let listed = super::connection(&two.grpc, client);
        assert_eq!(listed["carrier"], "memfd", "{listed}");
        assert!(
            listed["proxies"].as_array().is_none_or(Vec::is_empty),
            "nothing of it is elsewhere: {listed}"
        );
    }
    two.trocar().run(&["disconnect", "right/second/sample"]).ends_with(0);
    two.grpc.ok("GcmService/Connect", connect("right/second/sample", "right/s/value", json!({})));
    assert_eq!(super::connection(&two.grpc, "right/second/sample")["carrier"], "heap");
    two.grpc.stop("right/e");
    let passive = json!({ "path": "right/e", "execution": { "model": "none" } });
    let refused = two.grpc.refused("GcmService/Configure", passive);
    assert!(
        refused.message.contains("possible is \"inline\""),
        "no queue leads to a passive server: {refused}"
    );
}

#[test]
fn a_change_of_thread_that_a_pinned_carrier_cannot_follow_is_refused() {
    let two = pair();
    two.grpc.create("right/s", "sine", json!({}));
    two.grpc.create("right/second", "echo", json!({}));
    two.grpc
        .ok("GcmService/Connect", connect("right/second/peer", "right/e/ctl", json!({ "carrier": "heap" })));
    two.grpc.stop("right/e");
    let passive = json!({ "path": "right/e", "execution": { "model": "none" } });
    let refused = two.grpc.refused("GcmService/Configure", passive);
    assert!(refused.message.contains("possible is \"inline\""), "{refused}");
    assert!(refused.message.contains("right/second/peer"), "it names the connection: {refused}");
}

#[test]
fn what_does_not_fit_between_processes_is_refused_before_anything_is_made() {
    let world = World::with_plugins(&["filters", "sine", "fixture_misfit", "fixture_echo"]);
    let host = HostProcess::start(&world);
    let _right = HostProcess::start_with(&world, "right", &["--gcm", host.address()]);
    let grpc = host.grpcurl();
    grpc.await_class("host", "other_unit");
    grpc.await_class("right", "low_pass");
    grpc.create("host/unit", "fixture-misfit/other_unit", json!({}));
    grpc.create("host/s", "sine", json!({}));
    grpc.create("right/f", "filters/low_pass", json!({}));
    let revision = grpc.revision();
    let unit = grpc.refused("GcmService/Connect", connect("right/f/raw", "host/unit/force", json!({})));
    assert_eq!((unit.reason.as_str(), unit.code), ("TYPE_MISMATCH", "FAILED_PRECONDITION"), "{unit}");
    assert!(unit.message.contains("mN"), "{unit}");
    let kind = grpc.refused("GcmService/Connect", connect("right/f/raw", "host/s/value", json!({})));
    assert_eq!(kind.reason, "TYPE_MISMATCH", "{kind}");
    let port = grpc.refused("GcmService/Connect", connect("right/f/row", "host/unit/force", json!({})));
    assert!(port.reason == "INTERFACE_NOT_FOUND" && port.message.contains("raw"), "{port}");
    assert_eq!(grpc.revision(), revision);
    assert_eq!(connections(&grpc), Vec::<Value>::new());
}

#[test]
fn a_max_age_of_zero_is_refused_and_a_short_one_makes_stale() {
    let two = pair();
    two.grpc.create("right/second", "echo", json!({}));
    for (max_age, why) in [("0s", "0 ns is outside 1 ns to 3600 s"), ("-1s", "-1")] {
        let options = json!({ "max_age": max_age });
        let refused =
            two.grpc.refused("GcmService/Connect", connect("right/second/sample", "left/s/value", options));
        assert_eq!(refused.violated_fields(), ["options.max_age"], "{refused}");
        assert!(refused.message.contains(why), "{refused}");
    }
    for max_age in ["0", "0s", "0.1ns"] {
        let asked = ["connect", "right/second/sample", "left/s/value", "--max-age", max_age];
        two.trocar().run(&asked).ends_with(2).says("--max-age").says("above 0");
    }
    assert_eq!(connections(&two.grpc).len(), 2, "nothing was made");
    let options = json!({ "max_age": "0.05s" });
    two.grpc.ok("GcmService/Connect", connect("right/second/sample", "left/s/value", options));
    two.grpc.start("right/second");
    let health = |wanted: &str| {
        eventually(&format!("right/second is {wanted}"), || match two.grpc.component("right/second") {
            now if now["health"] == wanted => Ok(()),
            now => Err(now["health"].to_string()),
        });
    };
    health("HEALTH_OK");
    two.grpc.stop("left/s");
    health("HEALTH_STALE_INPUT");
}

#[test]
fn a_second_process_of_the_same_name_is_refused_and_the_first_is_undisturbed() {
    let two = pair();
    let before = (two.host("right"), super::connection(&two.grpc, "right/e/sample"));
    let plugins = two.world.plugins();
    let state = two.world.path("second");
    let second = two.trocar().run(&[
        "host",
        "--name",
        "right",
        "--listen",
        "127.0.0.1:0",
        "--plugins",
        plugins.to_str().unwrap(),
        "--state",
        state.to_str().unwrap(),
        "--gcm",
        two.process.address(),
        "--json",
    ]);
    let second = second.ends_with(1);
    assert!(second.stdout.contains("PROCESS_EXISTS") || second.stderr.contains("right"), "{second:#?}");
    let after = super::connection(&two.grpc, "right/e/sample");
    assert_eq!(after["id"], before.1["id"], "{after}");
    assert!(is_linked(&after), "{after}");
    assert_eq!(two.host("right"), before.0);
}
