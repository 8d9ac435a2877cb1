//! Members of etcd that are gone.

use serde_json::json;
use trocar_tests::eventually;

use super::{Lab, leads};

#[test]
fn a_member_that_is_gone_costs_nothing_that_was_answered() {
    let mut lab = Lab::new(3, 2);
    let _host = lab.host("left");
    for gone in 0..3 {
        lab.etcd.kill(gone);
        let path = format!("left/made{gone}");
        // The cluster elects a leader of its own meanwhile, so that a change may be refused.
        eventually("a change is made", || {
            let leader = lab.leader();
            match lab.grpc(leader).call("GcmService/Create", json!({ "path": path, "class": "Server" })) {
                Ok(_) => Ok(()),
                Err(refused) if refused.reason == "COMPONENT_EXISTS" => Ok(()),
                Err(refused) => Err(refused),
            }
        });
        lab.etcd.restart(gone);
        eventually("the member is back", || if lab.etcd.is_healthy(gone) { Ok(()) } else { Err("not yet") });
    }
    lab.assert_runs_on(lab.leader(), "left");
}

#[test]
fn without_a_quorum_changes_are_refused_and_stop_works() {
    let mut lab = Lab::new(3, 2);
    let _host = lab.host("left");
    let old = lab.leader();
    for gone in [0, 1] {
        lab.etcd.kill(gone);
    }
    let refused = eventually("a change is refused", || {
        let ask = json!({ "path": "left/more", "class": "Server", "request_id": "1" });
        match lab.grpc(old).call("GcmService/Create", ask) {
            Err(refused) if refused.reason == "NOT_LEADER" => Ok(refused),
            Err(refused) => Err(refused.to_string()),
            Ok(answer) => Err(answer.to_string()),
        }
    });
    assert!(refused.message.contains("in doubt") && refused.message.contains("etcd"), "{refused}");
    assert!(leads(&lab.grpc(1 - old)).is_err());
    // It acts first, whoever leads.
    let stopped = lab.trocar().run(&["stop", "left/server"]).ends_with(0);
    let said = format!("{}{}", stopped.stdout, stopped.stderr);
    assert!(said.contains("left/server") && said.contains("not on record yet"), "{said}");
    for back in [0, 1] {
        lab.etcd.restart(back);
    }
    let leader = lab.leader();
    eventually("the host is attached", || super::is_attached(&lab.grpc(leader), "left"));
    // Nothing has set it in motion again.
    let grpc = lab.grpc(leader);
    assert_eq!(grpc.state("left/server"), "STOPPED");
    eventually("what waited is on record", || {
        grpc.call("GcmService/Start", json!({ "path": "left/server" })).map_err(|refused| refused.to_string())
    });
    assert_eq!(grpc.state("left/server"), "ACTIVE");
}
