//! A plugin that forks a child which outlives the host.
//!
//! Promise: the child keeps no socket the host listened at, whether it runs another program or not, so that a
//! host can be started again at the same address while the child lives.

use std::ffi::OsString;
use std::fs;
use std::path::Path;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, eventually};

use super::household::Scene;

/// A child of the host's; ended with the test.
struct Child(u32);

impl Child {
    fn is_alive(&self) -> bool {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.0)).unwrap_or_default();
        // After the name in brackets: the state, Z of one that has ended.
        stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with('Z'))
    }

    fn program(&self) -> String {
        fs::read_to_string(format!("/proc/{}/comm", self.0)).unwrap_or_default().trim().to_owned()
    }

    /// The sockets it has that are listened at, each as the kernel's line about it.
    fn listens_at(&self) -> Vec<String> {
        let files = fs::read_dir(format!("/proc/{}/fd", self.0)).into_iter().flatten().flatten();
        let held: Vec<String> = files
            .filter_map(|file| {
                fs::read_link(file.path()).ok()?.to_str()?.strip_prefix("socket:[").map(String::from)
            })
            .map(|inode| inode.trim_end_matches(']').to_owned())
            .collect();
        let lines =
            |table: &str| fs::read_to_string(format!("/proc/{}/net/{table}", self.0)).unwrap_or_default();
        let column = |line: &str, n: usize| line.split_whitespace().nth(n).unwrap_or_default().to_owned();
        // A listening TCP socket has the state 0A; one of the file system the flag of those that accept.
        let tcp = [lines("tcp"), lines("tcp6")].concat();
        let tcp = tcp.lines().filter(|line| column(line, 3) == "0A" && held.contains(&column(line, 9)));
        let unix = lines("unix");
        let unix =
            unix.lines().filter(|line| column(line, 3) == "00010000" && held.contains(&column(line, 6)));
        tcp.chain(unix).map(str::to_owned).collect()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        if let Some(pid) = Pid::from_raw(self.0.cast_signed()).filter(|_| self.is_alive()) {
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}

fn children(host: &HostProcess) -> Vec<Child> {
    let tasks = fs::read_dir(Path::new("/proc").join(host.pid().to_string()).join("task"));
    let of = |task: fs::DirEntry| fs::read_to_string(task.path().join("children")).unwrap_or_default();
    let all: Vec<String> = tasks.into_iter().flatten().flatten().map(of).collect();
    all.iter().flat_map(|one| one.split_whitespace()).filter_map(|pid| pid.parse().ok().map(Child)).collect()
}

fn the_address_is_free_beside_a_child_that(does: &str, program: Option<&str>) {
    let Some(mut scene) = Scene::new() else { return };
    scene.strikes(does, "start");
    let child = eventually("the plugin has a child", || {
        let mut all = children(&scene.host);
        let named = all.iter().position(|child| program.is_none_or(|program| child.program() == program));
        named.map(|at| all.swap_remove(at)).ok_or("there is none")
    });
    let none: [&str; 0] = [];
    assert_eq!(child.listens_at(), none, "sockets of the host that the child keeps");
    let address = scene.host.address().to_owned();
    scene.host.kill();
    assert!(child.is_alive(), "the child outlives its host, or nothing is shown");
    let mut args: Vec<OsString> =
        ["host", "--name", "host", "--listen", &address].map(OsString::from).to_vec();
    args.extend(["--plugins".into(), scene.world.plugins().into()]);
    args.extend(["--state".into(), scene.world.state().join("host").into()]);
    // The plugin is not to do that once more.
    args.push("--fresh".into());
    // Fails with what it printed where it cannot listen.
    let again = HostProcess::spawn(&scene.world, "again", &args);
    assert_eq!(again.address(), address);
    let grpc = again.grpcurl();
    grpc.await_class("host", "untidy");
    grpc.create("host/u", "untidy", json!({}));
    grpc.start("host/u");
    assert_eq!(
        grpc.invoke("host/u/ctl/is_plain", Value::Null),
        true,
        "callers of the port reach the new host"
    );
    Trocar::at(&scene.world, &address).run(&["stop", "host/u"]).ends_with(0);
    assert!(child.is_alive(), "the child lived all the while, or nothing is shown");
}

#[test]
fn a_child_that_runs_on_keeps_no_socket_and_its_host_can_start_again() {
    the_address_is_free_beside_a_child_that("fork", None);
}

#[test]
fn a_child_that_runs_another_program_keeps_no_socket_and_its_host_can_start_again() {
    the_address_is_free_beside_a_child_that("fork_exec", Some("sleep"));
}
