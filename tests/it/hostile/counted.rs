//! A port whose process has no files left, and the processor time that takes.
//!
//! Promise: a process that cannot let anybody in waits without work. What it is given of the processors is
//! judged, so this test has the machine for itself.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::json;
use trocar_tests::{HostProcess, eventually};

use super::limits::limit;
use super::{Lab, lines};

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
        // A process that tries again and again takes all it can get: more than 1000 ms for these looks.
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
