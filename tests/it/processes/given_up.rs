//! Processes that are not started again by themselves: brought back by somebody, relieved of what ends them,
//! or forgotten.
//!
//! Promise: nobody has to take a system down for one process; what moves something comes back STOPPED here,
//! too.

use trocar_tests::{HostProcess, eventually, number};

use super::TWO;
use super::system::{System, gone, kill, pid};

/// Two processes; "right" is given up after four ends, however slow the machine is.
fn soon_given_up() -> System {
    System::up(&TWO.replacen("\"right\": {", "\"right\": { \"restart\": { \"within_s\": 1000 },", 1), &[])
}

fn is_listed(system: &System, process: &str) -> bool {
    system.list()["processes"].as_array().unwrap().iter().any(|p| p["name"] == process)
}

#[test]
fn a_failed_process_comes_back_by_a_restart_with_a_clean_record() {
    let two = soon_given_up();
    let failed = two.kill_until_failed("right");
    two.trocar().run(&["start", "right/s"]).says("trocar restart right");
    two.trocar().run(&["restart", "right"]).ends_with(0).says("right was started again");
    let back = two.host("right");
    assert_eq!(back["state"], "PROCESS_STATE_ATTACHED", "{back}");
    assert!(number(&back["epoch"]) > number(&failed["epoch"]), "{back}");
    assert_eq!(two.grpc.state("right/s"), "ACTIVE", "a sensor runs again");
    let actuator = two.grpc.component("right/c");
    assert_eq!(actuator["stopReason"], "STOP_REASON_RESTARTED", "{actuator}");
    kill("-KILL", pid(&back));
    two.await_back("right", &back);
}

#[test]
fn a_reset_of_its_component_brings_a_failed_process_back() {
    let two = soon_given_up();
    two.kill_until_failed("right");
    two.trocar().run(&["reset", "right/off", "--timeout", "60s"]).ends_with(0);
    assert_eq!(two.host("right")["state"], "PROCESS_STATE_ATTACHED");
    assert_eq!((two.grpc.state("right/off"), two.grpc.state("right/s")), ("READY".into(), "ACTIVE".into()));
}

#[test]
fn what_ends_a_process_can_be_taken_out_while_that_is_failed() {
    let two = soon_given_up();
    two.kill_until_failed("right");
    two.trocar().run(&["rm", "--force", "right/c"]).ends_with(0);
    two.trocar().run(&["restart", "right"]).ends_with(0);
    let list = two.list();
    let paths: Vec<&str> =
        list["components"].as_array().unwrap().iter().filter_map(|c| c["path"].as_str()).collect();
    assert_eq!(paths, ["left/s", "right/off", "right/s"], "{list}");
}

#[test]
fn a_process_that_runs_is_ended_in_order_before_it_is_started_again() {
    let file = r#"{ "version": 1, "processes": { "right": { "plugins": ["plugins"] } },
        "components": { "right/d": { "class": "device" }, "right/s": { "class": "sine" }, "right/t": { "class": "sine" } } }"#;
    let system = System::up(file, &[]);
    let before = system.host("right");
    system.grpc.stop("right/t");
    system.trocar().run(&["restart", "right"]).ends_with(0);
    let mark = format!("make_safe {}", pid(&before));
    let marks = std::fs::read_to_string(system.world.path("device-marks")).unwrap_or_default();
    assert!(marks.lines().any(|line| line == mark) && gone(pid(&before)), "{marks}");
    assert_eq!(system.grpc.component("right/d")["stopReason"], "STOP_REASON_RESTARTED");
    assert_eq!(
        (system.grpc.state("right/s"), system.grpc.state("right/t")),
        ("ACTIVE".into(), "STOPPED".into())
    );
    system.trocar().run(&["restart", "rihgt"]).ends_with(1).says("there is no process `rihgt`");
}

#[test]
fn processes_that_have_ended_are_forgotten_and_none_that_runs() {
    let two = System::up(&TWO.replacen("\"right\": {", "\"right\": { \"restart\": \"never\",", 1), &[]);
    kill("-KILL", pid(&two.host("right")));
    eventually("right is FAILED", || match two.host("right") {
        right if right["state"] == "PROCESS_STATE_FAILED" => Ok(()),
        right => Err(right.to_string()),
    });
    two.trocar().run(&["forget", "left"]).ends_with(1).says("`left` runs").says("End it first");
    two.trocar().run(&["forget", "right", "--dry-run"]).ends_with(0).says("right/s");
    assert!(is_listed(&two, "right"), "a dry run takes nothing away");
    two.trocar().run(&["forget", "right"]).ends_with(0);
    // Its supervisor tells of all its processes when one of them ends.
    let left = two.host("left");
    kill("-KILL", pid(&left));
    two.await_back("left", &left);
    let list = two.list();
    assert!(!list.to_string().contains("right"), "{list}");
}

#[test]
fn a_host_that_was_named_by_mistake_leaves_the_list() {
    let two = System::up(TWO, &[]);
    let args =
        ["host", "--name", "lfet", "--listen", "127.0.0.1:0", "--json", "--gcm", two.process.address()];
    let args: Vec<_> = args.iter().map(Into::into).collect();
    let mut typo = HostProcess::spawn(&two.world, "lfet", &args);
    two.trocar().run(&["create", "lfet/s", "sine"]).ends_with(0);
    assert!(typo.interrupt().success());
    eventually("its end is seen", || match two.host("lfet") {
        lost if lost["state"] == "PROCESS_STATE_LOST" => Ok(()),
        other => Err(other.to_string()),
    });
    two.trocar().run(&["restart", "lfet"]).ends_with(1).says("process `lfet` has no supervisor");
    two.trocar().run(&["rm", "lfet"]).ends_with(0);
    let list = two.list();
    assert!(!list.to_string().contains("lfet"), "{list}");
}
