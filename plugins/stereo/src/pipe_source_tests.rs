//! Children that write, stall, die and leave children of their own behind.
#![allow(clippy::unwrap_used)]

use super::*;
use std::io::Write;
use std::path::Path;
use trocar_sdk::data::{OperatingMode, PixelFormat};
use trocar_sdk::testing::{Bench, assert_behaves_as_camera_fed, assert_implements, contracts};

use crate::watchdog::Watchdog;

/// A source of 2×1 px of grey whose program is a line for the shell.
fn config(line: &str, more: &str) -> String {
    let command = trocar_sdk::serde_json::json!(["sh", "-c", line]);
    format!(r#"{{"command": {command}, "width": 2, "height": 1, "format": "gray8"{more}}}"#)
}

/// Steps until something is so.
#[track_caller]
fn until(bench: &mut Bench<PipeSource>, what: &str, mut so: impl FnMut(&mut Bench<PipeSource>) -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !so(bench) {
        watchdog.saw(format_args!("{:?}, {:?}", bench.state().sent, state(bench)));
        bench.step(1);
        std::thread::yield_now();
    }
}

fn state(bench: &Bench<PipeSource>) -> (OperatingMode, String) {
    let told = bench.read::<(), OperatingState>("operating_state", ()).unwrap();
    (told.state, told.message.to_string())
}

fn failed(bench: &mut Bench<PipeSource>) -> String {
    until(bench, "it fails", |bench| state(bench).0 == OperatingMode::FAULT);
    state(bench).1
}

#[test]
fn frames_come_as_the_program_writes_them_in_whatever_pieces() {
    let line = "printf ab; printf c; read wait < /dev/null; printf d; exec cat /dev/zero";
    let mut bench = Bench::<PipeSource>::new(config(line, ""));
    let mut got = Vec::new();
    until(&mut bench, "three frames", |bench| {
        got.extend(bench.frames::<StereoHeader>("image"));
        got.len() >= 3
    });
    assert_eq!([&got[0].1[..], &got[1].1[..], &got[2].1[..]], [b"ab", b"cd", &[0, 0]]);
    let (header, _, stamp) = &got[1];
    assert_eq!((header.index, header.width, header.height, header.stride), (1, 2, 1, 2));
    assert_eq!((header.format, header.right_offset), (PixelFormat::GRAY8, 0));
    assert_eq!(header.stamp, *stamp);
    assert_eq!(state(&bench), (OperatingMode::ENABLED, String::new()));
    assert_eq!(bench.read::<(), u64>("emitted", ()).unwrap(), bench.state().sent.emitted);
}

#[test]
fn both_images_lie_in_the_frame_as_the_layout_says() {
    let mut bench =
        Bench::<PipeSource>::new(config("printf abcd; exec sleep 60", r#", "layout": "side_by_side""#));
    let mut got = Vec::new();
    until(&mut bench, "a frame", |bench| {
        got.extend(bench.frames::<StereoHeader>("image"));
        !got.is_empty()
    });
    let [left, right] = got[0].0.images(&got[0].1).unwrap();
    assert_eq!((left.row(0), right.row(0)), (&b"ab"[..], &b"cd"[..]));
}

#[test]
fn a_program_that_dies_is_told_with_its_last_words_and_run_again() {
    let line = "printf abx; echo no such film >&2; exit 3";
    let mut bench = Bench::<PipeSource>::new(config(line, r#", "restart_delay_s": 0.01"#));
    let why = failed(&mut bench);
    assert_eq!(why, "sh ended (exit status: 3) after 1 frames and 1 B of the next: no such film");
    until(&mut bench, "two more runs", |bench| bench.state().sent.failures >= 3);
    let told = bench.events::<OperatingState>("camera/operating_state");
    let modes: Vec<_> = told.iter().take(3).map(|told| told.state).collect();
    assert_eq!(modes, [OperatingMode::ENABLED, OperatingMode::FAULT, OperatingMode::ENABLED]);
    assert_eq!(bench.life(), trocar_sdk::testing::Life::Active, "a device's trouble is no software fault");
}

#[test]
fn a_program_that_is_not_run_again_stays_in_fault() {
    let mut bench = Bench::<PipeSource>::new(config("exit 0", r#", "restart": false"#));
    assert_eq!(failed(&mut bench), "sh ended (exit status: 0) after 0 frames");
    bench.step(20);
    assert_eq!((state(&bench).0, bench.state().sent.failures), (OperatingMode::FAULT, 1));
}

#[test]
fn a_program_that_stalls_is_ended_with_all_it_started() {
    let dir = tempfile::tempdir().unwrap();
    let pids = dir.path().join("pids");
    let line = format!("sleep 1000 & echo $! $$ > {}; printf ab; wait", pids.display());
    let mut bench = Bench::<PipeSource>::new(config(&line, r#", "stall_s": 0.2, "restart": false"#));
    let why = failed(&mut bench);
    assert_eq!(why, "sh stalled: it wrote nothing in 0.2 s after 1 frames; it was ended");
    gone(&pids);
}

#[test]
fn a_program_that_trickles_has_stalled() {
    let line = "printf abc; exec sleep 1000";
    let mut bench = Bench::<PipeSource>::new(config(line, r#", "stall_s": 0.3, "restart": false"#));
    let why = failed(&mut bench);
    assert_eq!(why, "sh stalled: it wrote 1 B of a frame in 0.3 s after 1 frames; it was ended");
    // A frame of many bytes that come one by one, each long before the time is over.
    let line = "while printf c; do sleep 0.05; done";
    let command = trocar_sdk::serde_json::json!(["sh", "-c", line]);
    let config = format!(
        r#"{{"command": {command}, "width": 4000, "height": 1, "format": "gray8", "stall_s": 0.3, "restart": false}}"#
    );
    let why = failed(&mut Bench::<PipeSource>::new(config));
    assert!(why.starts_with("sh stalled: it wrote ") && why.contains(" B of a frame in 0.3 s"), "{why}");
}

#[test]
fn waits_before_a_restart_double_and_are_told() {
    let more = r#", "restart_delay_s": 0.5, "restart_delay_max_s": 1.5"#;
    let mut bench = Bench::<PipeSource>::new(config("exit 1", more));
    let mut waits = Vec::new();
    // A program that took longer to end than the wait before it begins anew: on a busy machine that may
    // happen once.
    until(&mut bench, "a second, longer wait", |bench| {
        let wait_s = bench.state().restart_in_s;
        if wait_s > 0.0 && waits.last() != Some(&wait_s) {
            waits.push(wait_s);
        }
        waits.contains(&1.0)
    });
    assert_eq!((waits[0], bench.state().restart_in_s), (0.5, 1.0));
    bench.stop().unwrap();
    assert_eq!(bench.state().restart_in_s, 0.0);
    let why = Bench::<PipeSource>::created()
        .configure(config("exit 1", r#", "restart_delay_s": 2.0, "restart_delay_max_s": 1.0"#))
        .unwrap_err()
        .reason;
    assert!(why.contains("restart_delay_max_s: 1 s is below restart_delay_s"), "{why}");
}

#[test]
fn stop_make_safe_and_drop_end_the_program() {
    for way in ["stop", "make_safe", "drop"] {
        let dir = tempfile::tempdir().unwrap();
        let pids = dir.path().join("pids");
        let line = format!("sleep 1000 & echo $! $$ > {}; printf ab; wait", pids.display());
        let mut bench = Bench::<PipeSource>::new(config(&line, ""));
        until(&mut bench, "a frame", |bench| bench.state().sent.emitted == 1);
        match way {
            "stop" => {
                bench.stop().unwrap();
                assert_eq!(state(&bench).0, OperatingMode::DISABLED);
            }
            "make_safe" => bench.make_safe().unwrap(),
            _ => drop(bench),
        }
        gone(&pids);
    }
}

/// Waits until the processes a file names are no more.
#[track_caller]
fn gone(pids: &Path) {
    for pid in std::fs::read_to_string(pids).unwrap().split_whitespace() {
        // One that nobody has collected yet has ended, too.
        let lives = || {
            let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
            stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['Z', 'X']))
        };
        let mut watchdog = Watchdog::of(format!("process {pid} is no more"));
        while lives() {
            watchdog.saw("it lives on");
            std::thread::yield_now();
        }
    }
}

#[test]
fn a_stopped_source_begins_anew_and_a_resumed_one_goes_on() {
    let mut bench = Bench::<PipeSource>::new(config("printf abcd; exec sleep 60", ""));
    until(&mut bench, "two frames", |bench| bench.state().sent.emitted == 2);
    bench.stop().unwrap();
    bench.resume().unwrap();
    until(&mut bench, "two more", |bench| bench.state().sent.emitted == 4);
    bench.stop().unwrap();
    bench.start().unwrap();
    assert_eq!(bench.state().sent, Sent::default());
    until(&mut bench, "two again", |bench| bench.state().sent.emitted == 2);
    let indices: Vec<_> = bench.frames::<StereoHeader>("image").iter().map(|(h, ..)| h.index).collect();
    assert_eq!(indices, [0, 1, 2, 3, 0, 1]);
}

#[test]
fn frames_that_readers_or_the_step_have_no_room_for_are_counted_by_their_number() {
    let mut bench = Bench::<PipeSource>::new(config("exec cat /dev/zero", ""));
    bench.exhaust("image", true);
    until(&mut bench, "some left out", |bench| bench.state().sent.left_out >= 3);
    bench.exhaust("image", false);
    until(&mut bench, "some sent", |bench| bench.state().sent.emitted >= 5);
    let sent = bench.state().sent;
    let last = bench.frames::<StereoHeader>("image").last().unwrap().0.index;
    assert_eq!(last + 1, sent.emitted + sent.left_out);
    assert_eq!(bench.events::<u64>("camera/frame_dropped").last(), Some(&sent.left_out));
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<PipeSource>::new(config("exec cat /dev/zero", ""));
    until(&mut bench, "frames", |bench| bench.state().sent.emitted >= 8);
    bench.assert_no_alloc(|bench| bench.step(2000));
}

#[test]
fn a_program_that_is_not_there_or_not_named_is_refused() {
    let mut bench =
        Bench::<PipeSource>::ready(r#"{"command": ["no-such-program-here"], "width": 2, "height": 2}"#);
    let why = bench.start().unwrap_err().reason;
    assert!(why.starts_with("command: no-such-program-here cannot be started: No such file"), "{why}");
    for command in ["[]", r#"[""]"#] {
        let config = format!(r#"{{"command": {command}, "width": 2, "height": 2}}"#);
        let why = Bench::<PipeSource>::created().configure(config).unwrap_err().reason;
        assert!(why.starts_with("command: is empty; name a program"), "{why}");
    }
    let odd = r#"{"command": ["true"], "width": 3, "height": 2, "format": "yuyv"}"#;
    assert!(Bench::<PipeSource>::created().configure(odd).unwrap_err().reason.contains("an even width"));
}

#[test]
fn the_source_fulfils_the_contract_of_cameras_and_behaves_so() {
    assert_implements::<PipeSource>(&contracts::CAMERA);
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("frames");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    // Open for both: what is written waits for the program, whenever that opens it.
    let mut frames = std::fs::OpenOptions::new().read(true).write(true).open(&pipe).unwrap();
    let mut bench = Bench::<PipeSource>::new(config(&format!("exec cat {}", pipe.display()), ""));
    let (mut written, mut before) = (0, 0);
    assert_behaves_as_camera_fed(&mut bench, "camera", |bench| {
        let Sent { emitted, left_out, .. } = bench.state().sent;
        let taken = emitted + left_out;
        // After a start it counts from 0 again; all that was written before had been taken.
        written = if taken < before { taken } else { written };
        before = taken;
        if written == taken {
            frames.write_all(b"ab").unwrap();
            written += 1;
        }
        std::thread::yield_now();
    });
}
