//! Processes and GCMs that end, stand still and come back, with connections between them.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually, number};

use super::{
    PAIR, PLUGINS, await_flow, await_linked, connection, connections, epoch, halves, is_linked, pair,
};
use crate::processes::system::{System, gone, kill, pid};

#[test]
fn a_killed_end_comes_back_linked_under_another_number() {
    let two = pair();
    for (name, client) in [("left", "right/e/sample"), ("right", "right/client/Required")] {
        let ends = ["right/e/sample", "right/client/Required"];
        let before = ends.map(|end| await_linked(&two.grpc, end, 0));
        let process = two.host(name);
        kill("-KILL", pid(&process));
        two.await_back(name, &process);
        for (end, before) in ends.iter().zip(&before) {
            let after = await_linked(&two.grpc, end, epoch(before));
            assert_eq!(after["id"], before["id"], "{after}");
            assert_eq!(two.grpc.state("right/client"), "ACTIVE");
        }
        await_flow(&two.grpc, client);
    }
}

#[test]
fn both_ends_killed_at_once_come_back_linked() {
    let two = pair();
    let before = await_linked(&two.grpc, "right/client/Required", 0);
    let (left, right) = (two.host("left"), two.host("right"));
    kill("-KILL", pid(&left));
    kill("-KILL", pid(&right));
    two.await_back("left", &left);
    two.await_back("right", &right);
    for client in ["right/client/Required", "right/e/sample"] {
        await_linked(&two.grpc, client, epoch(&before));
        await_flow(&two.grpc, client);
    }
    assert_eq!(connection(&two.grpc, "right/client/Required")["id"], before["id"]);
}

#[test]
fn what_was_connected_since_the_file_was_read_comes_back_when_the_gcm_is_lost_with_an_end() {
    let two = pair();
    two.grpc.ok("GcmService/Disconnect", json!({ "client": "right/e/sample", "server": "left/s/value" }));
    two.grpc.create("right/late", "echo", json!({}));
    let options = json!({ "queue": { "fifo": 7, "dropOldest": true } });
    let late = json!({ "client": "right/late/sample", "server": "left/s/value", "options": options });
    two.grpc.ok("GcmService/Connect", late);
    two.grpc.start("right/late");
    two.grpc.ok("GcmService/Remove", json!({ "path": "right/e" }));
    await_linked(&two.grpc, "right/late/sample", 0);
    let (left, right) = (two.host("left"), two.host("right"));
    kill("-KILL", two.gcm_pid());
    kill("-KILL", pid(&right));
    let listed = eventually("all that right had is back", || {
        let ls = two.trocar().run(&["ls", "--json"]);
        let listed = if ls.code == 0 { ls.json() } else { Value::Null };
        let is_active = |path: &str| {
            let all = listed["components"].as_array();
            all.is_some_and(|all| all.iter().any(|c| c["path"] == path && c["state"] == "ACTIVE"))
        };
        let connections = listed["connections"].as_array().map_or(0, Vec::len);
        let whole =
            ["right/late", "right/client", "left/s", "left/server"].iter().all(|path| is_active(path));
        if whole && connections == 2 { Ok(listed) } else { Err(format!("{ls:?}")) }
    });
    let back = await_linked(&two.grpc, "right/late/sample", 0);
    assert_eq!(
        (&back["options"]["queue"]["fifo"], &back["options"]["queue"]["dropOldest"]),
        (&json!(7), &json!(true))
    );
    for client in ["right/late/sample", "right/client/Required"] {
        await_linked(&two.grpc, client, 0);
        await_flow(&two.grpc, client);
    }
    let paths: Vec<&str> =
        listed["components"].as_array().unwrap().iter().filter_map(|c| c["path"].as_str()).collect();
    assert!(!paths.contains(&"right/e"), "somebody had removed it: {paths:?}");
    assert_eq!(pid(&two.host("left")), pid(&left), "nobody else was touched");
}

#[test]
fn a_dead_end_is_shown_with_its_reason_and_can_be_disconnected() {
    let once = PAIR.replacen("\"left\": {", "\"left\": { \"restart\": \"never\",", 1);
    let two = System::up_with(&PLUGINS, &once, &[]);
    await_linked(&two.grpc, "right/e/sample", 0);
    kill("-KILL", pid(&two.host("left")));
    let dead = eventually("the server's half is gone", || {
        let now = connection(&two.grpc, "right/e/sample");
        let why = halves(&now)[1]["whyNot"].as_str().unwrap_or_default().to_owned();
        if why == "process left is FAILED" && !is_linked(&now) { Ok(now) } else { Err(now.to_string()) }
    });
    let why = halves(&dead)[0]["whyNot"].as_str().unwrap().to_owned();
    assert!(!why.is_empty(), "the client's half says why it has no link: {dead}");
    two.trocar().run(&["ls"]).ends_with(0).says("not linked").says("process left is FAILED");
    two.trocar().run(&["graph"]).ends_with(0).says("not linked");
    two.trocar().run(&["top", "-n", "1", "--interval", "0.1s"]).ends_with(0).says("not linked");
    two.grpc.ok("GcmService/Disconnect", json!({ "client": "right/e/sample", "server": "left/s/value" }));
    two.grpc.ok("GcmService/Remove", json!({ "path": "right/client", "force": true }));
    assert_eq!(connections(&two.grpc), Vec::<Value>::new());
}

#[test]
fn a_half_that_was_given_up_while_its_process_stood_still_is_cut_when_it_comes_back() {
    let two = pair();
    let before = await_linked(&two.grpc, "right/client/Required", 0);
    let left = two.hold("left");
    let new = two.grpc.refused(
        "GcmService/Connect",
        json!({ "client": "right/e/sample", "server": "left/s/value", "options": { "replace": true } }),
    );
    assert_eq!(new.reason, "PROCESS_LOST", "{new}");
    two.grpc.ok("GcmService/Disconnect", json!({ "client": "right/e/sample", "server": "left/s/value" }));
    kill("-CONT", pid(&left));
    eventually("left is heard again", || match two.host("left") {
        now if now == left => Ok(()),
        now => Err(now.to_string()),
    });
    await_linked(&two.grpc, "right/client/Required", epoch(&before));
    await_flow(&two.grpc, "right/client/Required");
    assert_eq!(connections(&two.grpc).len(), 1, "what was disconnected meanwhile stays so");
    // Its half at the server is gone, too: the output is free for a new one.
    two.grpc.connect("right/e/sample", "left/s/value");
    await_flow(&two.grpc, "right/e/sample");
}

#[test]
fn losing_the_gcm_touches_no_half_and_the_next_one_knows_them_all() {
    let two = pair();
    let clients = ["right/client/Required", "right/e/sample"];
    let before = clients.map(|client| await_linked(&two.grpc, client, 0));
    for round in 0..5 {
        let gcm = two.gcm_pid();
        kill("-KILL", gcm);
        eventually(&format!("round {round}: both are attached to the next GCM"), || {
            if !gone(gcm) {
                return Err("it lives".to_owned());
            }
            let ls = two.trocar().run(&["ls", "--json"]);
            let all = if ls.code == 0 { ls.json() } else { Value::Null };
            let attached = all["processes"]
                .as_array()
                .is_some_and(|all| all.iter().filter(|p| p["state"] == "ATTACHED").count() == 2);
            if attached && all["connections"].as_array().map(Vec::len) == Some(2) {
                Ok(())
            } else {
                Err(format!("{ls:?}"))
            }
        });
        for (client, before) in clients.iter().zip(&before) {
            // A process that is attached may not have told of its half yet.
            eventually(&format!("round {round}: the same link"), || {
                let now = connection(&two.grpc, client);
                let is_same = now["proxies"] == before["proxies"] && now["id"] == before["id"];
                if is_same { Ok(()) } else { Err(format!("{now}, before {before}")) }
            });
            await_flow(&two.grpc, client);
        }
    }
    two.grpc.ok("GcmService/Disconnect", json!({ "client": clients[1], "server": "left/s/value" }));
    two.grpc.connect(clients[1], "left/s/value");
    let new = await_linked(&two.grpc, clients[1], epoch(&before[1]));
    assert!(number(&new["id"]) > number(&before[1]["id"]), "numbers are not used again: {new}");
}

#[test]
fn what_an_end_and_the_gcm_lost_together_is_connected_again_from_the_file() {
    let two = pair();
    let left = two.host("left");
    kill("-KILL", two.gcm_pid());
    kill("-KILL", pid(&left));
    eventually("all connections are linked again", || {
        let ls = two.trocar().run(&["ls", "--json"]);
        let all = if ls.code == 0 { ls.json()["connections"].clone() } else { Value::Null };
        let linked = |c: &Value| {
            c["proxies"].as_array().is_some_and(|all| all.iter().all(|half| half["linked"] == true))
        };
        let all = all.as_array().cloned().unwrap_or_default();
        if all.len() == 2 && all.iter().all(linked) { Ok(()) } else { Err(format!("{ls:?}")) }
    });
    for client in ["right/client/Required", "right/e/sample"] {
        await_flow(&two.grpc, client);
    }
}

#[test]
fn a_process_whose_state_directory_was_removed_is_found_by_one_that_comes_back() {
    let two = pair();
    let clients = ["right/client/Required", "right/e/sample"];
    let before = clients.map(|client| await_linked(&two.grpc, client, 0));
    let right = two.host("right");
    std::fs::remove_dir_all(two.world.path("xdg-state")).unwrap();
    kill("-KILL", pid(&right));
    for (client, before) in clients.iter().zip(&before) {
        await_linked(&two.grpc, client, epoch(before));
        await_flow(&two.grpc, client);
    }
    assert_eq!(two.host("left")["unfit"], false, "its own socket was taken for one that a component closed");
}

#[test]
fn a_process_that_comes_back_at_another_place_is_found_there() {
    let world = World::with_plugins(&PLUGINS);
    let gcm = HostProcess::start_gcm(&world);
    let grpc = gcm.grpcurl();
    let mut left = HostProcess::start_with(&world, "left", &["--gcm", gcm.address()]);
    let _right = HostProcess::start_with(&world, "right", &["--gcm", gcm.address()]);
    grpc.await_class("left", "sine");
    grpc.await_class("right", "echo");
    grpc.create("left/s", "sine", json!({}));
    grpc.create("right/e", "echo", json!({}));
    grpc.connect("right/e/sample", "left/s/value");
    grpc.ok("GcmService/Start", json!({ "path": "**" }));
    let before = await_linked(&grpc, "right/e/sample", 0);
    left.kill();
    eventually("left is lost", || match grpc.ok("GcmService/List", json!({ "path": "left" })) {
        list if list["processes"][0]["state"] == "PROCESS_STATE_LOST" => Ok(()),
        list => Err(list["processes"].to_string()),
    });
    eventually("right says how it lost left", || {
        let all = connections(&grpc);
        let halves = all.iter().filter_map(|c| c["proxies"].as_array()).flatten();
        let said = halves
            .filter_map(|half| half["whyNot"].as_str())
            .any(|why| why.contains("process left: it died"));
        if said { Ok(()) } else { Err(format!("{all:?}")) }
    });
    let elsewhere = world.path("elsewhere");
    let mut args: Vec<std::ffi::OsString> =
        ["host", "--name", "left", "--listen", "127.0.0.1:0", "--gcm", gcm.address(), "--plugins"]
            .map(Into::into)
            .to_vec();
    args.extend([world.plugins().into(), "--state".into(), elsewhere.into()]);
    let _again = HostProcess::spawn(&world, "left-again", &args);
    await_linked(&grpc, "right/e/sample", epoch(&before));
    await_flow(&grpc, "right/e/sample");
}

#[test]
fn an_isolated_component_stays_connected_to_its_neighbours() {
    let file = r#"{
      "version": 1,
      "processes": { "box": { "plugins": ["plugins"] } },
      "components": {
        "box/server": { "class": "example/Server", "isolation": "process" },
        "box/client": { "class": "example/Client" }
      },
      "connections": [ { "client": "box/client/Required", "server": "box/server/Provided" } ]
    }"#;
    let one = System::up_with(&PLUGINS, file, &[]);
    let before = await_linked(&one.grpc, "box/client/Required", 0);
    assert_eq!(before["server"], "box.server/server/Provided", "{before}");
    let (neighbour, own) = (one.host("box"), one.host("box.server"));
    kill("-KILL", pid(&own));
    one.await_back("box.server", &own);
    await_linked(&one.grpc, "box/client/Required", epoch(&before));
    await_flow(&one.grpc, "box/client/Required");
    assert_eq!(one.host("box"), neighbour, "its neighbours went on");
    assert_eq!(one.grpc.state("box/client"), "ACTIVE");
}
