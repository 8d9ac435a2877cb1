//! The paper's Fig. 4, replayed: a `Server` with `Void`, `Write`, `Read` and events, a `Client` connected to
//! it.
//!
//! Promise: what the figure shows can be done with grpcurl alone, without a proto file.

use serde_json::json;
use trocar_tests::{HostProcess, World, eventually};

#[test]
fn write_30_then_read_answers_30() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");

    grpc.invoke("host/server/Provided/Write", json!(30));

    // Read is answered from the last published row, which the write has just published.
    assert_eq!(grpc.invoke("host/server/Provided/Read", json!(null)), json!(30));
}

#[test]
fn the_events_of_write_and_void_reach_a_subscriber() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");
    let selections = json!({ "selections": [
        { "path": "host/server/Provided/SetPointReached" },
        { "path": "host/server/Provided/VoidCalled" },
        { "path": "host/server" },
    ]});
    let mut events = grpc.stream("InteractService/Subscribe", &selections);
    // The component's state is sent at once: from then on no event is missed.
    events.until("the present state of host/server", |item| item["kind"] == "ITEM_KIND_STATE");

    grpc.invoke("host/server/Provided/Write", json!(30));
    let reached = events.until("SetPointReached", |item| {
        item["path"].as_str().is_some_and(|p| p.ends_with("/SetPointReached"))
    });
    assert_eq!(reached["json"], json!(30), "{reached}");
    assert_eq!(reached["kind"], "ITEM_KIND_EVENT");

    grpc.invoke("host/server/Provided/Void", json!(null));
    events.until("VoidCalled", |item| item["path"].as_str().is_some_and(|p| p.ends_with("/VoidCalled")));
}

#[test]
fn a_connected_client_commands_the_server() {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.create("host/client", "Client", json!({}));
    grpc.connect("host/client/Required", "host/server/Provided");
    grpc.start("host/**");
    grpc.await_state("host/client", "ACTIVE");

    eventually("the client has called the server", || {
        let calls = trocar_tests::number(&grpc.component("host/server")["stats"]["commands"]);
        if calls > 2 { Ok(()) } else { Err(format!("{calls} commands so far")) }
    });
}
