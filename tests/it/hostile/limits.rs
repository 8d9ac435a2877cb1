//! A machine that gives no files and no memory: refused with a sentence, nothing half made, and well again
//! when there is some.

use std::process::Command;

use serde_json::json;
use trocar_tests::{HostProcess, Trocar, eventually};

use super::stranger::Stranger;
use super::{Lab, holds};

/// Sets a limit of a running process.
pub(super) fn limit(host: &HostProcess, what: &str, value: &str) {
    let done = Command::new("prlimit")
        .args(["--pid", &host.pid().to_string(), &format!("--{what}={value}")])
        .status();
    assert!(done.is_ok_and(|status| status.success()), "prlimit --{what}={value}");
}

#[test]
fn a_host_that_may_open_no_more_files_says_so_and_links_when_it_may() {
    let lab = Lab::new();
    let (mut left, right) = (lab.host("left"), lab.host("right"));
    lab.furnish("left");
    lab.furnish("right");
    lab.start("left");
    let before = holds(left.pid());
    limit(&left, "nofile", &format!("{}:4096", before.files));
    let refused = lab.refused(&json!({ "client": "right/e/sample", "server": "left/s/value" }));
    assert!(refused.message.contains("open files"), "{refused}");
    assert!(lab.connections().is_empty(), "{:#?}", lab.connections());
    lab.await_steps("left/s", 10);
    limit(&left, "nofile", "4096:4096");
    eventually("it connects when there are files", || {
        let body = json!({ "client": "right/e/sample", "server": "left/s/value" });
        lab.grpc.call("GcmService/Connect", body).map(|_| ()).map_err(|e| e.to_string())
    });
    lab.start("right");
    lab.await_flow("right/e/sample");
    assert!(left.is_alive());
    drop(right);
}

#[test]
fn memory_longer_than_a_file_may_be_refuses_the_connection_and_ends_nobody() {
    let lab = Lab::new();
    let (mut left, _right) = (lab.host("left"), lab.host("right"));
    lab.furnish("left");
    lab.furnish("right");
    // Room for the page of a session, and for no queue.
    limit(&left, "fsize", "4096:unlimited");
    let refused = lab.refused(&json!({ "client": "right/e/sample", "server": "left/s/value" }));
    assert_eq!(refused.reason, "UNREACHABLE", "{refused}");
    assert!(refused.message.contains("ulimit -f"), "{refused}");
    assert!(left.is_alive(), "{}", left.printed());
    limit(&left, "fsize", "unlimited:unlimited");
    lab.connect("right", "left");
    lab.start("left");
    lab.start_all("right");
    lab.await_flow("right/e/sample");
}

#[test]
fn a_second_process_of_a_name_and_a_second_one_in_a_directory_are_refused() {
    let lab = Lab::new();
    let left = lab.host("left");
    let trocar = Trocar::at(&lab.world, lab.gcm.address());
    let host = |name: &str, state: &str| {
        let state = lab.world.state().join(state);
        let state = state.to_string_lossy().into_owned();
        trocar.run(&[
            "host",
            "--name",
            name,
            "--listen",
            "127.0.0.1:0",
            "--gcm",
            lab.gcm.address(),
            "--state",
            &state,
        ])
    };
    let same_name = host("left", "elsewhere");
    assert_ne!(same_name.code, 0, "{same_name:#?}");
    let same_place = host("other", "left");
    assert_ne!(same_place.code, 0, "{same_place:#?}");
    same_place.says("in use by process");
    // The socket is still the first one's.
    let stranger = Stranger::at(&lab.world.state().join("left/links.sock"));
    stranger.say(b"hello?", &[]);
    assert!(stranger.hears().contains("nothing of ours"));
    drop(left);
}
