//! The newcomer's first command.
//!
//! Promise: `trocar demo` runs the robot at 1 kHz and the video at 30 pairs/s from real plugins and real images, in one
//! process or three with the same figures, loses nothing, and stops cleanly; a process of it that is killed comes back.

use std::ffi::OsString;
use std::path::Path;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, number, repository};

use crate::processes::system::{children, gone, kill, pid};

/// Periods of the robot in ten seconds, 1 kHz.
const PERIODS: u64 = 10_000;

#[test]
fn ten_seconds_of_demo_account_for_every_period_and_drop_no_frame_in_one_process_and_in_three() {
    // The control run says how many periods this machine loses to others anyway.
    let control = skipped_by_a_lone_robot();
    for processes in ["1", "3"] {
        let world = World::new();
        let output = Trocar::new(&world)
            .in_dir(&repository())
            .run(&["demo", "--processes", processes, "--listen", "127.0.0.1:0", "--seconds", "10", "--json"])
            .ends_with(0);
        let figures = output.json();
        assert_eq!(figures["processes"].to_string(), processes, "{figures}");
        let (robot, video) = (&figures["robot"], &figures["video"]);

        let (executed, skipped) = (number(&robot["executed"]), number(&robot["skipped"]));
        assert!(
            (executed + skipped).abs_diff(PERIODS) <= 1,
            "executed + skipped = periods elapsed: {figures}"
        );
        let allowed = control + PERIODS / 1000;
        assert!(skipped <= allowed, "{skipped} periods skipped, {control} in the control run: {figures}");

        let pairs = number(&video["pairs"]);
        assert!(pairs.abs_diff(300) <= 3, "30 pairs/s for 10 s: {figures}");
        assert_eq!(number(&video["drops"]), 0, "{figures}");
    }
}

#[test]
fn a_running_demo_answers_grpcurl_and_ends_cleanly_on_ctrl_c() {
    let world = World::new();
    let mut demo = demo(&world, &[]);
    let list = demo.grpcurl().ok("GcmService/List", json!({}));
    let components = list["components"].as_array().cloned().unwrap_or_default();
    assert!(components.len() >= 5, "robot, client, source and filters: {list}");
    for component in &components {
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
    }
    assert!(demo.printed().contains("grpcurl"), "it prints lines to paste: {}", demo.printed());

    let status = demo.interrupt();
    assert!(status.success(), "a demo that was asked to end has succeeded: {status}\n{}", demo.printed());
}

#[test]
fn in_three_processes_it_is_one_system_and_leaves_nothing_behind() {
    let world = World::new();
    let mut demo = demo(&world, &["--processes", "3"]);
    let list = demo.grpcurl().ok("GcmService/List", json!({}));
    let of = |list: &Value, key: &str, field: &str| -> Vec<String> {
        let all = list[key].as_array().cloned().unwrap_or_default();
        all.iter().map(|one| one[field].as_str().unwrap_or_default().to_owned()).collect()
    };
    assert_eq!(of(&list, "processes", "name"), ["host", "host.robot", "host.source"], "{list}");
    let states = of(&list, "components", "state");
    assert_eq!(states, ["COMPONENT_STATE_ACTIVE"; 7], "{list}");
    let far = of(&list, "connections", "carrier").iter().filter(|c| *c == "memfd").count();
    assert_eq!(far, 2, "the robot's and the source's connections pass between processes: {list}");

    let pids = children(u64::from(demo.pid()));
    assert_eq!(pids.len(), 4, "three hosts and their GCM: {pids:?}");
    let states: Vec<String> = pids.iter().filter_map(|pid| state_directory(*pid)).collect();
    assert!(states.len() == 4 && states.iter().all(|dir| Path::new(dir).is_dir()), "{states:?}");
    let status = demo.interrupt();
    assert!(status.success(), "{status}\n{}", demo.printed());
    assert_eq!(pids.iter().filter(|pid| !gone(**pid)).count(), 0, "it answers when all have ended");
    for dir in states {
        assert!(!Path::new(&dir).exists(), "{dir} is left behind");
    }
}

#[test]
fn a_killed_process_of_it_comes_back_and_the_table_says_so() {
    let world = World::new();
    let demo = demo(&world, &["--processes", "3"]);
    let grpc = demo.grpcurl();
    let shown = || grpc.component("host/display")["stats"]["executed"].clone();
    let process = |name: &str| {
        let list = grpc.ok("GcmService/List", json!({ "brief": true }));
        let all = list["processes"].as_array().cloned().unwrap_or_default();
        all.into_iter().find(|p| p["name"] == name).unwrap_or_default()
    };
    for name in ["host.source", "host.robot"] {
        let before = process(name);
        kill("-KILL", pid(&before));
        eventually(&format!("{name} is back"), || match process(name) {
            now if now["state"] == "PROCESS_STATE_ATTACHED" && pid(&now) != pid(&before) => Ok(()),
            now => Err(now),
        });
    }
    grpc.await_state("host.source/source", "ACTIVE");
    grpc.await_state("host.robot/robot", "STOPPED");
    grpc.ok("GcmService/Resume", json!({ "path": "host.robot/robot" }));
    let pairs = number(&shown());
    eventually("video flows again", || match number(&shown()) {
        now if now > pairs + 30 => Ok(()),
        now => Err(now),
    });
    let commands = || number(&grpc.component("host.robot/robot")["stats"]["commands"]);
    let moved = commands();
    eventually("the robot is moved again", || if commands() > moved { Ok(()) } else { Err("no command") });
    eventually("the table tells of both", || {
        let printed = demo.printed();
        let rows = ["host.robot ", "host.source "].map(|name| {
            printed.lines().any(|row| row.starts_with(name) && row.ends_with("was killed by SIGKILL"))
        });
        if rows == [true; 2] { Ok(()) } else { Err(printed) }
    });
}

#[test]
fn another_number_of_processes_is_refused_with_what_is_possible() {
    let world = World::new();
    for number in ["0", "4", "many"] {
        Trocar::new(&world).run(&["demo", "--processes", number]).ends_with(2).says("1, 2 or 3 processes");
    }
}

/// A demo that runs.
fn demo(world: &World, more: &[&str]) -> HostProcess {
    let mut args: Vec<OsString> = ["demo", "--listen", "127.0.0.1:0", "--data"].map(OsString::from).to_vec();
    args.push(repository().join("tests/data/chessboard").into());
    args.extend(more.iter().map(OsString::from));
    HostProcess::spawn(world, "demo", &args)
}

/// Where a process keeps its state, as it was told.
fn state_directory(pid: u64) -> Option<String> {
    let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
    let mut words = line.split('\0').skip_while(|word| *word != "--state");
    words.nth(1).map(str::to_owned)
}

/// Skipped periods of one robot alone for as many periods as the demo runs.
fn skipped_by_a_lone_robot() -> u64 {
    let world = World::with_plugins(&["eyerobot"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "eyerobot");
    grpc.create("host/robot", "eyerobot/eyerobot", json!({}));
    grpc.start("host/robot");
    let figures: Value = eventually("ten seconds of a robot alone", || {
        let stats = grpc.component("host/robot")["stats"].clone();
        let elapsed = number(&stats["executed"]) + number(&stats["skipped"]);
        if elapsed >= PERIODS { Ok(stats) } else { Err(format!("{elapsed} periods elapsed")) }
    });
    number(&figures["skipped"])
}
