//! Lines into files, programs that read slowly, die or read to the end, datagrams, a serial line.
#![allow(clippy::unwrap_used)]

use super::*;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::os::fd::OwnedFd;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use trocar_sdk::data::{OperatingState, Scalar, Wrench};
use trocar_sdk::serde_json::{Value, json};
use trocar_sdk::testing::Bench;

use crate::watchdog::Watchdog;

fn with(mut config: Value, more: Value) -> String {
    config.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap());
    config.to_string()
}

#[track_caller]
fn until(bench: &mut Bench<LinesSink>, what: &str, mut so: impl FnMut(&mut Bench<LinesSink>) -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !so(bench) {
        watchdog.saw(format_args!("{:?}, {:?}", bench.state().given, bench.state().operating_state.message));
        bench.step(1);
        std::thread::yield_now();
    }
}

/// Waits for a thread; one that never ends fails the test and not the whole run.
#[track_caller]
fn joined<T>(what: &str, thread: std::thread::JoinHandle<T>) -> T {
    let mut watchdog = Watchdog::of(what);
    while !thread.is_finished() {
        watchdog.saw("it goes on");
        std::thread::yield_now();
    }
    thread.join().unwrap()
}

/// The end of a device, and the name of its port.
fn serial_line() -> (OwnedFd, String) {
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&device).unwrap();
    unlockpt(&device).unwrap();
    let port = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    (device, port)
}

/// The first line that ends so.
fn line_with(device: OwnedFd, end: &str) -> String {
    let mut lines = BufReader::new(std::fs::File::from(device)).lines().map(Result::unwrap);
    lines.find(|line| line.ends_with(end)).unwrap()
}

fn scalar(value: f64) -> Scalar {
    Scalar { stamp: Stamp::INVALID, value }
}

#[test]
fn samples_are_rows_of_a_file_below_a_header_and_nothing_is_written_over() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("depth.csv");
    let config = json!({ "file": file });
    let mut bench = Bench::<LinesSink>::new(&config);
    for value in [1.0, 2.5] {
        bench.push("in", scalar(value));
        bench.step(1);
    }
    bench.stop().unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!((rows.len(), rows[0]), (3, "# t s, in.value"));
    assert!(rows[1].ends_with(",1.0") && rows[2].ends_with(",2.5"), "{text}");
    assert_eq!((bench.state().given.written, bench.state().given.dropped), (2, 0));
    // The same component writes on; another one is refused.
    bench.start().unwrap();
    bench.push("in", scalar(3.0));
    bench.step(1);
    bench.stop().unwrap();
    assert!(std::fs::read_to_string(&file).unwrap().ends_with(",3.0\n"));
    let why = Bench::<LinesSink>::ready(&config).start().unwrap_err().reason;
    assert!(why.contains("depth.csv exists, and nothing is written over"), "{why}");
}

#[test]
fn inputs_of_any_types_stand_side_by_side_once_each_has_brought_one() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("both.json");
    let mut bench =
        Bench::<LinesSink>::new(json!({ "file": file, "inputs": ["depth", "force"], "format": "json" }));
    bench.push("depth", scalar(1.0));
    bench.step(1);
    assert_eq!(bench.state().given.incomplete, 1);
    bench.push("force", Wrench { force: [0.0, 0.0, 0.5], ..Wrench::default() });
    bench.push("depth", scalar(2.0));
    bench.step(1);
    bench.stop().unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let line: Value = trocar_sdk::serde_json::from_str(text.trim()).unwrap();
    assert_eq!((&line["depth"]["value"], &line["force"]["force"]), (&json!(2.0), &json!([0.0, 0.0, 0.5])));
    assert!(line["t"].as_f64().unwrap() > 0.0);
}

#[test]
fn another_type_at_an_input_begins_under_a_new_header() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("any.csv");
    let mut bench = Bench::<LinesSink>::new(json!({ "file": file }));
    bench.push("in", scalar(1.0));
    bench.step(1);
    bench.push("in", 7u32);
    bench.step(1);
    bench.stop().unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!((rows[0], rows[2]), ("# t s, in.value", "# t s, in"));
    assert!(rows[3].ends_with(",7"), "{text}");
}

#[test]
fn a_program_reads_all_lines_to_the_end_of_its_input() {
    let dir = tempfile::tempdir().unwrap();
    let read = dir.path().join("read");
    let line = format!("cat > {}; echo end >> {0}", read.display());
    let mut bench = Bench::<LinesSink>::new(json!({ "program": ["sh", "-c", line], "header": false }));
    for value in 0..100 {
        bench.push("in", scalar(f64::from(value)));
        bench.step(1);
    }
    bench.stop().unwrap();
    let text = std::fs::read_to_string(&read).unwrap();
    assert_eq!((text.lines().count(), text.lines().last()), (101, Some("end")));
}

#[test]
fn a_program_that_reads_nothing_holds_up_nobody_and_what_it_misses_is_counted() {
    let config = json!({ "program": ["sleep", "1000"], "queue": 64 });
    let mut bench = Bench::<LinesSink>::new(config);
    let mut pushed = 0;
    until(&mut bench, "lines are dropped", |bench| {
        bench.push("in", Wrench::default());
        pushed += 1;
        bench.state().given.dropped > 100
    });
    // The last one, too.
    bench.step(1);
    bench.stop().unwrap();
    let given = bench.state().given;
    assert_eq!(given.written + given.dropped, pushed, "also those that waited at the end: {given:?}");
}

#[test]
fn what_was_handed_on_is_written_or_dropped_after_a_stop() {
    let config = json!({ "program": ["sleep", "1000"], "queue": 64, "header": false });
    let mut bench = Bench::<LinesSink>::new(config);
    // A line has more than 4 KiB, and a pipe holds 64 KiB.
    for _ in 0..64 {
        bench.push("in", [0.5; 1024]);
        bench.step(1);
    }
    bench.stop().unwrap();
    let given = bench.state().given;
    assert_eq!(given.written + given.dropped, 64, "{given:?}");
    assert!((1..16).contains(&given.written), "whole lines, also of a batch that was cut: {given:?}");
}

#[test]
fn a_program_that_floods_its_output_is_written_to_and_stopped() {
    for line in ["yes & yes & yes & exec cat > /dev/null", "yes >&2 & yes >&2 & yes & exec cat > /dev/null"] {
        let thread = std::thread::spawn(move || {
            let mut bench = Bench::<LinesSink>::new(json!({ "program": ["sh", "-c", line] }));
            until(&mut bench, "lines are written", |bench| {
                bench.push("in", scalar(1.0));
                bench.state().given.written > 10
            });
            bench.stop().unwrap();
        });
        joined(line, thread);
    }
}

#[test]
fn a_program_that_closes_its_input_and_floods_its_output_is_stopped() {
    let thread = std::thread::spawn(|| {
        let config =
            json!({ "program": ["sh", "-c", "exec <&-; yes & yes & yes & exec yes"], "restart": "never" });
        let mut bench = Bench::<LinesSink>::new(config);
        until(&mut bench, "the failure is told", |bench| {
            bench.push("in", scalar(1.0));
            bench.state().given.failures == 1
        });
        assert!(bench.state().operating_state.message.ends_with("it was ended: y"));
        bench.stop().unwrap();
    });
    joined("it is stopped", thread);
}

#[test]
fn values_of_the_other_inputs_from_before_a_start_or_a_cut_are_no_lines() {
    let dir = tempfile::tempdir().unwrap();
    let config = json!({ "file": dir.path().join("both"), "inputs": ["a", "b"], "header": false });
    let mut bench = Bench::<LinesSink>::new(config);
    let one = |bench: &mut Bench<LinesSink>| {
        bench.push("a", scalar(1.0));
        bench.step(1);
        bench.state().given.incomplete
    };
    bench.push("b", scalar(2.0));
    assert_eq!(one(&mut bench), 0);
    bench.stop().unwrap();
    bench.start().unwrap();
    assert_eq!(one(&mut bench), 1, "of b nothing came since Start");
    bench.push("b", scalar(3.0));
    assert_eq!(one(&mut bench), 1);
    bench.connect_input("b", false);
    assert_eq!(one(&mut bench), 2, "b is cut");
    bench.stop().unwrap();
    assert_eq!(bench.state().given.written, 1);
}

#[test]
fn a_program_that_dies_is_told_with_its_last_words_and_run_again() {
    let line = "read a; echo no screen >&2; exit 4";
    let config = json!({ "program": ["sh", "-c", line], "restart_delay_s": 0.01 });
    let mut bench = Bench::<LinesSink>::new(config);
    let mut told = Vec::new();
    until(&mut bench, "two failures", |bench| {
        bench.push("in", scalar(1.0));
        told.extend(bench.events::<OperatingState>("sink/operating_state"));
        bench.state().given.failures >= 2
    });
    let why = told.iter().find(|state| state.state == OperatingMode::FAULT).unwrap().message;
    assert_eq!(why, "sh ended (exit status: 4): no screen");
}

#[test]
fn at_most_so_many_a_second_are_written_and_the_rest_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<LinesSink>::new(json!({ "file": dir.path().join("slow"), "max_rate_hz": 10.0 }));
    for _ in 0..100 {
        bench.push("in", scalar(1.0));
        bench.step(1);
    }
    bench.stop().unwrap();
    let given = bench.state().given;
    assert_eq!((given.written, given.left_out), (10, 90), "one second at 100 Hz");
}

#[test]
fn lines_go_out_as_datagrams_and_over_a_serial_line() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut bench = Bench::<LinesSink>::new(with(
        json!({ "udp": socket.local_addr().unwrap().to_string() }),
        json!({ "format": "json" }),
    ));
    bench.push("in", scalar(1.5));
    bench.step(1);
    let datagram = joined(
        "the datagram",
        std::thread::spawn(move || {
            let mut datagram = vec![0; 1000];
            let n = socket.recv(&mut datagram).unwrap();
            datagram.truncate(n);
            datagram
        }),
    );
    let line: Value = trocar_sdk::serde_json::from_slice(&datagram).unwrap();
    assert_eq!(line["in"]["value"], 1.5);

    let (device, port) = serial_line();
    let mut bench = Bench::<LinesSink>::new(json!({ "serial": port, "header": false }));
    bench.push("in", scalar(2.5));
    bench.step(1);
    let line = joined("the line", std::thread::spawn(|| line_with(device, ",2.5")));
    assert_eq!(line.split(',').count(), 2, "{line}");
}

#[test]
fn after_a_line_that_was_cut_the_next_one_begins_anew() {
    let (device, port) = serial_line();
    let mut bench = Bench::<LinesSink>::new(json!({ "serial": port, "header": false, "queue": 64 }));
    // More than a port holds that nobody reads.
    for _ in 0..64 {
        bench.push("in", [0.25; 1024]);
        bench.step(1);
    }
    bench.stop().unwrap();
    assert!(bench.state().given.dropped > 0, "{:?}", bench.state().given);
    bench.resume().unwrap();
    bench.push("in", scalar(2.5));
    bench.step(1);
    let line = joined("the line", std::thread::spawn(|| line_with(device, ",2.5")));
    assert_eq!(line.split(',').count(), 2, "{line}");
}

#[test]
fn a_step_allocates_nothing_once_its_inputs_are_known() {
    let dir = tempfile::tempdir().unwrap();
    let mut bench = Bench::<LinesSink>::new(json!({ "file": dir.path().join("lines") }));
    until(&mut bench, "lines are written", |bench| {
        bench.push("in", scalar(1.0));
        bench.state().given.written > 100
    });
    bench.assert_no_alloc(|bench| {
        for _ in 0..50 {
            bench.push("in", scalar(1.0));
            bench.step(1);
        }
    });
}

#[test]
fn settings_are_refused_with_what_to_do() {
    for (config, why) in [
        (json!({}), "program, udp, serial, file: give exactly one of them"),
        (json!({ "file": "a", "udp": "127.0.0.1:1" }), "give exactly one of them"),
        (json!({ "file": "a", "inputs": [] }), "inputs: there are 0"),
        (json!({ "file": "a", "inputs": ["x", "x"] }), "the name `x` is given twice"),
        (json!({ "udp": "here" }), "udp: \"here\" is not an address and a port"),
    ] {
        let said = Bench::<LinesSink>::created().configure(config).unwrap_err().reason;
        assert!(said.contains(why), "{why}: {said}");
    }
    let why = Bench::<LinesSink>::ready(json!({ "file": "/no/such/place" })).start().unwrap_err().reason;
    assert!(why.contains("file: /no/such/place cannot be made"), "{why}");
}
