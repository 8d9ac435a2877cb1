//! `trocar doctor`, on this machine as it is and with less than it allows.
//!
//! Promise: all findings are told, each that is not well with what it costs and how to allow more, and the
//! exit code follows.

use serde_json::Value;
use trocar_tests::{Output, Trocar, World};

use super::{OK, REFUSED, USAGE};
use crate::realtime::rights::{limit, may_lock};

const FINDINGS: [&str; 10] =
    ["priority", "memlock", "kernel", "cpus", "clock", "wakes", "shm", "inotify", "files", "threads"];

/// The findings of `trocar doctor --json`, each of them whole, and the exit code that follows from them.
#[track_caller]
fn findings(output: &Output) -> Vec<Value> {
    let json = output.json();
    let findings = json["findings"].as_array().cloned().unwrap_or_default();
    let names: Vec<&str> = findings.iter().filter_map(|f| f["what"].as_str()).collect();
    assert_eq!(names, FINDINGS, "{json:#}");
    for finding in &findings {
        let [verdict, found, means, allow] =
            ["verdict", "found", "means", "allow"].map(|key| finding[key].as_str().unwrap_or_default());
        assert!(["ok", "limited", "bad"].contains(&verdict) && !found.is_empty(), "{finding:#}");
        let fine = verdict == "ok";
        assert_eq!((means.is_empty(), allow.is_empty()), (fine, fine), "{finding:#}");
    }
    for figure in ["clock_read_ns", "wake_p50_ns", "wake_p99_ns", "wake_max_ns"] {
        assert!(json[figure].as_f64().is_some_and(|ns| ns > 0.0), "{figure}: {json:#}");
    }
    let bad = findings.iter().any(|f| f["verdict"] == "bad");
    assert_eq!(output.code, if bad { REFUSED } else { OK }, "{json:#}");
    findings
}

#[track_caller]
fn finding(output: &Output, what: &str) -> Value {
    let all = findings(output);
    all.into_iter().find(|f| f["what"] == what).unwrap_or_else(|| panic!("no finding {what}"))
}

#[track_caller]
fn allows_by(finding: &Value, verdict: &str, words: &[&str]) {
    assert_eq!(finding["verdict"], verdict, "{finding:#}");
    for word in words {
        assert!(finding["allow"].as_str().is_some_and(|a| a.contains(word)), "{word}: {finding:#}");
    }
}

#[test]
fn every_finding_is_told_and_what_is_not_well_says_what_it_costs_and_how_to_allow_more() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    findings(&trocar.run(&["doctor", "--json"]));
    let plain = trocar.run(&["doctor"]);
    let (table, help) = plain.stdout.split_once("\n\n").unwrap();
    let rows: Vec<Vec<&str>> =
        table.lines().skip(1).map(|row| row.split_whitespace().take(2).collect()).collect();
    assert_eq!(rows.iter().map(|row| row[0]).collect::<Vec<_>>(), FINDINGS, "{plain:#?}");
    let complaints: Vec<&str> = rows.iter().filter(|row| row[1] != "ok").map(|row| row[0]).collect();
    for what in &complaints {
        let said = help.split_once(&format!("{what}: ")).map_or("", |(_, said)| said);
        let mut lines = said.lines();
        assert!(lines.next().is_some_and(|means| !means.is_empty()), "{what}: {plain:#?}");
        let allow = lines.next().unwrap_or_default().trim_start();
        assert!(allow.starts_with("to allow more: ") && allow.len() > 20, "{what}: {plain:#?}");
    }
    assert_eq!(help.matches("to allow more: ").count(), complaints.len(), "{plain:#?}");
    assert_eq!(help.contains("nothing to improve"), complaints.is_empty(), "{plain:#?}");
    trocar.run(&["doctor", "host/robot"]).ends_with(USAGE);
}

#[test]
fn what_a_process_may_not_is_limited_and_says_who_can_allow_it() {
    let world = World::new();
    let trocar = Trocar::new(&world).prepared(|command| {
        limit(command, &[(libc::RLIMIT_RTPRIO, 0), (libc::RLIMIT_MEMLOCK, 0), (libc::RLIMIT_NOFILE, 256)]);
    });
    let output = trocar.run(&["doctor", "--json"]);
    let priority = finding(&output, "priority");
    allows_by(&priority, "limited", &["rtprio 95", "limits.d", "setcap cap_sys_nice", "LimitRTPRIO="]);
    assert!(priority["found"].as_str().is_some_and(|f| f.ends_with("limit 0")), "{priority:#}");
    let memlock = finding(&output, "memlock");
    allows_by(&memlock, "limited", &["memlock unlimited", "LimitMEMLOCK=infinity"]);
    assert!(memlock["found"].as_str().is_some_and(|f| f.contains("refused")), "{memlock:#}");
    allows_by(&finding(&output, "files"), "limited", &["hard limit", "nofile"]);
    trocar.run(&["doctor"]).ends_with(output.code).says("to allow more: put `@realtime - rtprio 95`");
}

#[test]
fn memory_that_may_be_locked_in_part_says_which_part() {
    if !may_lock(4 << 20) {
        return;
    }
    let world = World::new();
    let trocar = Trocar::new(&world).prepared(|command| limit(command, &[(libc::RLIMIT_MEMLOCK, 4 << 20)]));
    let memlock = finding(&trocar.run(&["doctor", "--json"]), "memlock");
    allows_by(&memlock, "limited", &["memlock unlimited"]);
    assert_eq!(memlock["found"], "up to 4096 KiB may be locked");
    let means = memlock["means"].as_str().unwrap();
    assert!(means.contains("the upper 128 KiB of each thread's stack"), "{memlock:#}");
}

#[test]
fn what_a_host_cannot_do_without_is_bad_and_the_exit_code_says_so() {
    let world = World::new();
    // Memory that frames lie in is a file that has to grow.
    let trocar = Trocar::new(&world).prepared(|command| limit(command, &[(libc::RLIMIT_FSIZE, 0)]));
    let output = trocar.run(&["doctor", "--json"]).ends_with(REFUSED);
    let shm = finding(&output, "shm");
    allows_by(&shm, "bad", &["memfd_create"]);
    assert_eq!(shm["means"], "no component can send frames");
    trocar.run(&["doctor"]).ends_with(REFUSED).says("no component can send frames").says("to allow more");
}
