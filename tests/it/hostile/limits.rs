//! A machine that gives no files and no memory: refused with a sentence, nothing half made, and well again when there is some.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::Duration;

use serde_json::json;
use trocar_tests::{HostProcess, Trocar, eventually};

use super::stranger::Stranger;
use super::{Lab, holds, lines};

/// Sets a limit of a running process.
fn limit(host: &HostProcess, what: &str, value: &str) {
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
    let refused = lab
        .grpc
        .refused("GcmService/Connect", json!({ "client": "right/e/sample", "server": "left/s/value" }));
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

/// The first number the next file of a process would get.
fn next_file(host: &HostProcess) -> u32 {
    let is_free = |n: &u32| fs::symlink_metadata(format!("/proc/{}/fd/{n}", host.pid())).is_err();
    (0..).find(is_free).unwrap()
}

/// Processor time of a process so far, ms.
fn cpu_ms(host: &HostProcess) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{}/stat", host.pid())).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split_whitespace().collect();
    let ticks = |at: usize| fields[at].parse::<u64>().unwrap();
    (ticks(11) + ticks(12)) * 1000 / rustix::param::clock_ticks_per_second()
}

/// Processor time each of them takes while it is looked at so often, ms.
fn cost(hosts: [&HostProcess; 2], looks: u32) -> [u64; 2] {
    let before = hosts.map(cpu_ms);
    let mut left = looks;
    eventually("so many looks", || {
        left -= 1;
        if left == 0 { Ok(()) } else { Err("more to come") }
    });
    let after = hosts.map(cpu_ms);
    [0, 1].map(|at| after[at] - before[at])
}

/// Somebody who speaks HTTP/2 at a port.
fn caller(host: &HostProcess) -> TcpStream {
    let mut caller = TcpStream::connect(host.address()).unwrap();
    // The preface, and settings that are none.
    caller.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").unwrap();
    caller
}

#[test]
fn a_port_whose_process_may_open_no_more_files_waits_without_work_says_so_and_answers_when_it_may() {
    const LOOKS: u32 = 150;
    let lab = Lab::new();
    let left = lab.host("left");
    let both = [&lab.gcm, &left];
    for host in both {
        host.grpcurl().ok("grpc.health.v1.Health/Check", json!({}));
        limit(host, "nofile", &format!("{}:4096", next_file(host)));
    }
    let idle = cost(both, LOOKS);
    let callers = both.map(caller);
    for host in both {
        eventually("it says that it cannot let anybody in", || {
            match lines(host, "callers of the gRPC port wait") {
                0 => Err(host.printed()),
                _ => Ok(()),
            }
        });
        assert!(lines(host, "ulimit -n") > 0, "it does not say what to do: {}", host.printed());
    }
    let waiting = cost(both, LOOKS);
    for at in [0, 1] {
        let (idle, waiting) = (idle[at], waiting[at]);
        // One that tries again and again takes all it can get: more than 1000 ms for these looks.
        assert!(
            waiting <= 2 * idle + 200,
            "no {at} took {waiting} ms while a caller waited, {idle} ms while none did"
        );
        let told = lines(both[at], "callers of the gRPC port wait");
        assert!(told <= 5, "{told} lines: {}", both[at].printed());
    }
    for (host, mut caller) in both.into_iter().zip(callers) {
        limit(host, "nofile", "4096:4096");
        let mut answer = [0; 9];
        // A watchdog: it is read as soon as it is there.
        caller.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        caller.read_exact(&mut answer).unwrap_or_else(|e| panic!("who waited has no answer: {e}"));
        assert_eq!(answer[3], 4, "settings come first in HTTP/2: {answer:?}");
        host.grpcurl().ok("grpc.health.v1.Health/Check", json!({}));
    }
    assert_eq!(lab.grpc.ok("GcmService/List", json!({}))["processes"][0]["name"], "left");
}

#[test]
fn memory_longer_than_a_file_may_be_refuses_the_connection_and_ends_nobody() {
    let lab = Lab::new();
    let (mut left, _right) = (lab.host("left"), lab.host("right"));
    lab.furnish("left");
    lab.furnish("right");
    // Room for the page of a session, and for no queue.
    limit(&left, "fsize", "4096:unlimited");
    let refused = lab
        .grpc
        .refused("GcmService/Connect", json!({ "client": "right/e/sample", "server": "left/s/value" }));
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
