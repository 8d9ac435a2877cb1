//! Managers that lead, follow, are killed, stand still, and end.

use rustix::process::Signal;
use serde_json::{Value, json};
use trocar_tests::{Grpcurl, Trocar, eventually};

use super::{Lab, leads, listed, send, told};

fn health(grpc: &Grpcurl, service: &str) -> Value {
    let answer = grpc.call("grpc.health.v1.Health/Check", json!({ "service": service }));
    answer.map_or_else(|refused| json!(refused.code), |answer| answer["status"].clone())
}

#[test]
fn one_of_three_leads_and_the_others_name_it() {
    let lab = Lab::new(1, 3);
    let leader = lab.leader();
    let address = lab.gcms[leader].address();
    for at in (0..3).filter(|at| *at != leader) {
        let grpc = lab.grpc(at);
        for method in
            ["GcmService/List", "GcmService/Stop", "PluginService/ListPlugins", "AttachService/Tell"]
        {
            let refused = grpc.refused(method, json!({}));
            assert_eq!((refused.code, refused.reason.as_str()), ("UNAVAILABLE", "NOT_LEADER"), "{refused}");
            assert_eq!(told(&refused, "leader"), address, "{refused}");
            assert!(refused.message.contains(address), "{refused}");
        }
        assert_eq!(health(&grpc, "trocar.v1.GcmService"), "NOT_SERVING");
        assert!(grpc.ask_reflection(&["list"]).contains("trocar.v1.GcmService"));
    }
    let grpc = lab.grpc(leader);
    eventually("the leader says that it serves", || match health(&grpc, "trocar.v1.GcmService") {
        serving if serving == "SERVING" => Ok(()),
        other => Err(other),
    });
    // Whichever is named first.
    for first in 0..3 {
        let order: Vec<&str> = (0..3).map(|at| lab.gcms[(first + at) % 3].address()).collect();
        Trocar::at(&lab.world, &order.join(",")).run(&["ls"]).ends_with(0);
    }
    let follower = (leader + 1) % 3;
    let said = Trocar::at(&lab.world, lab.gcms[follower].address()).run(&["ls"]);
    assert!(said.code != 0 && said.stderr.contains(&format!("--gcm {address}")), "{said:?}");
}

#[test]
fn a_leader_that_is_killed_loses_nothing_that_was_answered() {
    let mut lab = Lab::new(3, 3);
    let _host = lab.host("left");
    let mut made = vec!["left/server".to_owned()];
    for round in 0..2 {
        let leader = lab.leader_but(&(0..round).collect::<Vec<_>>());
        lab.gcms.swap(round, leader);
        let grpc = lab.grpc(round);
        eventually("the host is attached", || super::is_attached(&grpc, "left"));
        for count in 0..5 {
            let path = format!("left/made{round}x{count}");
            grpc.create(&path, "Server", json!({}));
            made.push(path);
        }
        lab.gcms[round].kill();
        let next = lab.leader_but(&(0..=round).collect::<Vec<_>>());
        lab.assert_runs_on(next, "left");
        let mut there = listed(&lab.grpc(next));
        there.sort();
        made.sort();
        assert_eq!(there, made);
    }
}

#[test]
fn a_request_id_is_known_to_the_next_leader() {
    let mut lab = Lab::new(1, 2);
    let _host = lab.host("left");
    let leader = lab.leader();
    let ask = json!({ "path": "left/once", "class": "Server", "request_id": "7" });
    let first = lab.grpc(leader).ok("GcmService/Create", ask.clone());
    lab.gcms[leader].kill();
    let next = lab.leader_but(&[leader]);
    let second = lab.grpc(next).ok("GcmService/Create", ask);
    assert_eq!(first["revision"], second["revision"]);
}

#[test]
fn a_leader_that_stood_still_decides_nothing_when_it_goes_on() {
    let lab = Lab::new(1, 3);
    let _host = lab.host("left");
    let old = lab.leader();
    send(lab.gcms[old].pid(), Signal::STOP);
    let next = lab.leader_but(&[old]);
    lab.assert_runs_on(next, "left");
    lab.grpc(next).create("left/later", "Server", json!({}));
    let before = listed(&lab.grpc(next));
    send(lab.gcms[old].pid(), Signal::CONT);
    // From its first moment on.
    let refused =
        lab.grpc(old).refused("GcmService/Create", json!({ "path": "left/other", "class": "Server" }));
    assert_eq!(refused.reason, "NOT_LEADER", "{refused}");
    eventually("the old one follows", || match lab.grpc(old).refused("GcmService/List", json!({})) {
        refused if told(&refused, "leader") == lab.gcms[next].address() => Ok(()),
        refused => Err(refused),
    });
    lab.assert_runs_on(next, "left");
    assert_eq!(listed(&lab.grpc(next)), before);
    assert!(leads(&lab.grpc(next)).is_ok());
}

#[test]
fn a_leader_that_ends_in_order_hands_over() {
    let mut lab = Lab::new(1, 2);
    let _host = lab.host("left");
    let leader = lab.leader();
    let ended = lab.gcms[leader].terminate();
    assert!(ended.success(), "{ended}");
    lab.assert_runs_on(lab.leader_but(&[leader]), "left");
}

#[test]
fn a_leader_is_named_by_the_address_that_it_advertises() {
    let mut lab = Lab::new(1, 0);
    let elsewhere = ["--advertise", "lab.example:50551"];
    lab.gcms = (0..2).map(|at| lab.manager_with(at, "127.0.0.1:0", &elsewhere)).collect();
    lab.add_manager();
    assert_eq!(lab.leader(), 0);
    let refusal = |at: usize| lab.grpc(at).refused("GcmService/List", json!({}));
    assert_eq!(told(&refusal(2), "leader"), "lab.example:50551");
    // It would send its callers to itself.
    let beside = eventually("the other of that address says so", || match refusal(1) {
        said if said.message.contains("--advertise") => Ok(said),
        said => Err(said),
    });
    assert_eq!((beside.reason.as_str(), told(&beside, "leader").as_str()), ("NOT_LEADER", ""), "{beside}");
}

#[test]
fn a_place_that_cannot_be_read_is_refused_with_what_is_wrong() {
    let lab = Lab::new(1, 0);
    let trocar = Trocar::new(&lab.world);
    let store = lab.etcd.place("lab7");
    for (more, why) in [
        (["--listen", "0.0.0.0:0"], "--advertise HOST:PORT"),
        (["--advertise", "lab.example"], "has no port"),
        (["--advertise", "lab.example:0"], "from 1 to 65535"),
    ] {
        let refused = trocar.run(&[&["gcm", "--store", &store][..], &more].concat());
        assert!(refused.code == 2 && refused.stderr.contains(why), "{more:?}: {refused:?}");
    }
    for (store, why) in [
        ("127.0.0.1:2379/lab7", "begin with etcd://"),
        ("etcd://127.0.0.1:2379", "no prefix"),
        ("etcd://127.0.0.1/lab7", "has no port"),
    ] {
        let refused = trocar.run(&["gcm", "--listen", "127.0.0.1:0", "--store", store]);
        assert!(refused.code == 2 && refused.stderr.contains(why), "{store}: {refused:?}");
    }
    let both = trocar.run(&["gcm", "--fresh", "--store", "etcd://127.0.0.1:1/a"]);
    assert!(both.code == 2 && both.stderr.contains("--fresh"), "{both:?}");
}
