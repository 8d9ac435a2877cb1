//! Children that write, flood, stall, die, print what is no text or half a line; datagrams; a serial line.
#![allow(clippy::unwrap_used)]

use super::*;
use std::io::Write;
use std::net::UdpSocket;
use trocar_sdk::data::{Pose, Scalar};
use trocar_sdk::serde_json::{Value, json};
use trocar_sdk::testing::{Bench, Life};

use crate::watchdog::Watchdog;

trocar_sdk::testing::count_allocations!();

/// The type that the description `force: fx N, fy N` makes.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
struct Force {
    stamp: Stamp,
    #[unit("N")]
    fx: f64,
    #[unit("N")]
    fy: f64,
}

/// A source whose program is a line for the shell.
fn shell(line: &str, more: Value) -> String {
    let mut config = json!({ "program": ["sh", "-c", line], "outputs": ["force: fx N, fy N"],
                             "restart_delay_s": 0.01, "restart": "never" });
    config.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap_or_default());
    config.to_string()
}

/// Steps until something is so.
#[track_caller]
fn until(bench: &mut Bench<LinesSource>, what: &str, mut so: impl FnMut(&mut Bench<LinesSource>) -> bool) {
    let mut watchdog = Watchdog::of(what);
    while !so(bench) {
        let row = bench.state();
        watchdog.saw(format_args!("{:?}, {:?}, {:?}", row.taken, row.operating_state.message, row.last_bad));
        bench.step(1);
        std::thread::yield_now();
    }
}

#[track_caller]
fn forces(bench: &mut Bench<LinesSource>, n: usize) -> Vec<Force> {
    let mut got = Vec::new();
    until(bench, "samples", |bench| {
        got.extend(bench.outputs::<Force>("force"));
        got.len() >= n
    });
    got
}

#[track_caller]
fn failed(bench: &mut Bench<LinesSource>) -> String {
    until(bench, "it fails", |bench| bench.state().operating_state.state == OperatingMode::FAULT);
    bench.state().operating_state.message.to_string()
}

fn numbers(forces: &[Force]) -> Vec<(f64, f64)> {
    forces.iter().map(|f| (f.fx, f.fy)).collect()
}

#[test]
fn lines_of_a_program_are_samples_of_the_type_that_was_described() {
    let line = "printf '# fx, fy\\n1, 2\\n3'; printf ' 4\\n'; exec sleep 1000";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({})));
    let got = forces(&mut bench, 2);
    assert_eq!(numbers(&got), [(1.0, 2.0), (3.0, 4.0)]);
    assert!(got.iter().all(|force| force.stamp.is_valid() && force.stamp <= bench.now()));
    let row = bench.state();
    assert_eq!((row.taken.lines, row.taken.handed_on, row.taken.bad), (2, 2, 0));
    assert_eq!(row.operating_state.state, OperatingMode::ENABLED);
}

#[test]
fn one_line_gives_a_sample_of_each_output() {
    let more = json!({ "outputs": ["tip: Pose", "depth: Scalar", "count: u32"], "format": "json" });
    let line = r#"echo '{"tip": {"position": [1, 2, 3], "orientation": [0, 0, 0, 1]}, "value": 0.5, "count": 7}'; exec sleep 1000"#;
    let mut bench = Bench::<LinesSource>::new(shell(line, more));
    let (mut poses, mut depths, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    until(&mut bench, "one of each", |bench| {
        poses.extend(bench.outputs::<Pose>("tip"));
        depths.extend(bench.outputs::<Scalar>("depth"));
        counts.extend(bench.outputs::<u32>("count"));
        !counts.is_empty()
    });
    assert_eq!((poses[0].position, depths[0].value, counts[0]), ([1.0, 2.0, 3.0], 0.5, 7));
    assert_eq!(poses[0].stamp, depths[0].stamp);
}

#[test]
fn bad_lines_are_counted_and_the_last_is_shown_and_the_good_ones_go_on() {
    let line =
        "echo 1 2; echo 1; echo nan 2; printf '\\377\\000\\n'; echo one two; echo 3 4; exec sleep 1000";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({})));
    assert_eq!(numbers(&forces(&mut bench, 2)), [(1.0, 2.0), (3.0, 4.0)]);
    until(&mut bench, "the last one is told", |bench| bench.state().last_bad.starts_with("line 5:"));
    let row = bench.state();
    assert_eq!((row.taken.lines, row.taken.bad), (6, 4));
    assert_eq!(row.last_bad, "line 5: column 1: `one` is not a number: \"one two\"");
    let told = bench.events::<BadLine>("source/bad_line");
    assert!(told.len() <= 4 && told.last().unwrap().line == row.last_bad, "{told:?}");
    assert_eq!(bench.life(), Life::Active);
}

#[test]
fn a_megabyte_without_an_end_is_one_bad_line() {
    let line = "head -c 1048576 /dev/zero; echo; echo 1 2; exec sleep 1000";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({})));
    assert_eq!(numbers(&forces(&mut bench, 1)), [(1.0, 2.0)]);
    until(&mut bench, "it is told", |bench| !bench.state().last_bad.is_empty());
    let row = bench.state();
    assert_eq!(row.taken.bad, 1);
    assert!(row.last_bad.starts_with("line 1: longer than 65536 B: \"\\0\\0"), "{}", row.last_bad);
}

#[test]
fn half_a_line_at_the_end_is_never_a_value() {
    let mut bench = Bench::<LinesSource>::new(shell("echo 1 2; printf '3 4'", json!({})));
    assert_eq!(failed(&mut bench), "sh ended (exit status: 0)");
    until(&mut bench, "it is told", |bench| {
        bench.state().taken.bad == 1 && !bench.state().last_bad.is_empty()
    });
    assert_eq!(bench.state().last_bad, "line 2: the source ended in the middle of it: \"3 4\"");
    assert_eq!(bench.outputs::<Force>("force").len(), 1);
}

#[test]
fn a_program_that_dies_is_told_with_its_last_words_and_run_again() {
    let line = "echo 1 2; echo no sensor >&2; exit 3";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({ "restart": "always" })));
    assert_eq!(failed(&mut bench), "sh ended (exit status: 3): no sensor");
    until(&mut bench, "two more runs", |bench| bench.state().taken.failures >= 3);
    assert!(bench.outputs::<Force>("force").len() >= 3);
    let told = bench.events::<OperatingState>("source/operating_state");
    let modes: Vec<_> = told.iter().take(3).map(|told| told.state).collect();
    assert_eq!(modes, [OperatingMode::ENABLED, OperatingMode::FAULT, OperatingMode::ENABLED]);
}

#[test]
fn a_source_that_falls_silent_is_stale_and_gives_nothing_old() {
    let mut bench = Bench::<LinesSource>::new(shell("echo 1 2; exec sleep 1000", json!({ "stale_s": 0.5 })));
    forces(&mut bench, 1);
    assert_eq!(bench.state().stale, Flag::FALSE);
    bench.step(200);
    assert!(bench.state().stale.get() && bench.state().silent_s > 0.5, "{}", bench.state().silent_s);
    assert!(bench.outputs::<Force>("force").is_empty());
}

#[test]
fn of_a_flood_the_newest_is_handed_on_and_the_rest_is_counted() {
    let dir = tempfile::tempdir().unwrap();
    let over = dir.path().join("over");
    let line = format!("seq -f '%.0f 0' 30000; mkdir {}; exec sleep 1000", over.display());
    let mut bench = Bench::<LinesSource>::new(shell(&line, json!({ "queue": 4 })));
    // No step takes anything while it floods; a pipe holds less than half of it.
    let mut watchdog = Watchdog::of("the flood is over");
    while !over.exists() {
        watchdog.saw("it floods");
        std::thread::yield_now();
    }
    let mut got = Vec::new();
    until(&mut bench, "the last one", |bench| {
        got.extend(bench.outputs::<Force>("force"));
        got.last().is_some_and(|force| force.fx == 30_000.0)
    });
    let taken = bench.state().taken;
    assert_eq!((taken.handed_on, taken.lines), (got.len() as u64, taken.handed_on + taken.dropped));
    assert!(taken.dropped > 10_000, "{taken:?}");
    assert!(got.windows(2).all(|w| w[0].fx < w[1].fx), "in their order");
}

#[test]
fn the_device_s_own_time_makes_the_stamps() {
    let more = json!({ "stamp": "1 ms" });
    let line = "echo 100 1 2; echo 110 3 4; echo 120 5 6; exec sleep 1000";
    let mut bench = Bench::<LinesSource>::new(shell(line, more));
    let got = forces(&mut bench, 3);
    assert_eq!(numbers(&got), [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]);
    assert!(got.windows(2).all(|w| w[0].stamp < w[1].stamp) && got[2].stamp <= bench.now());
}

#[test]
fn a_program_that_is_run_again_has_a_new_offset_of_its_clock() {
    let dir = tempfile::tempdir().unwrap();
    // The second run begins where the first one was, and tells it later.
    let line = format!(
        "cd {}; if mkdir ran; then echo 100 1 2; exit; fi; until [ -d go ]; do :; done; echo 100 3 4; exec sleep 1000",
        dir.path().display()
    );
    let mut bench = Bench::<LinesSource>::new(shell(&line, json!({ "stamp": "1 s", "restart": "always" })));
    let first = forces(&mut bench, 1)[0].stamp;
    failed(&mut bench);
    bench.advance(1_000_000_000);
    let later = bench.now();
    std::fs::create_dir(dir.path().join("go")).unwrap();
    let second = forces(&mut bench, 1)[0].stamp;
    assert!(first < later && second >= later, "{first:?}, {later:?}, {second:?}");
    assert_eq!(bench.state().taken.clock_resets, 0, "the clock was not set, it is another one");
}

#[test]
fn a_program_that_closes_its_output_and_floods_its_words_is_stopped() {
    let thread = std::thread::spawn(|| {
        let mut bench = Bench::<LinesSource>::new(shell(
            "echo 1 2; exec >&- 1>&2; yes & yes & yes & exec yes",
            json!({}),
        ));
        assert_eq!(failed(&mut bench), "sh closed its output; it was ended: y");
        bench.stop().unwrap();
    });
    let mut watchdog = Watchdog::of("it is told and stopped");
    while !thread.is_finished() {
        watchdog.saw("it goes on");
        std::thread::yield_now();
    }
    thread.join().unwrap();
}

#[test]
fn datagrams_are_lines_each_whole() {
    let config = json!({ "udp": "127.0.0.1:0", "outputs": ["force: fx N, fy N"] });
    let mut bench = Bench::<LinesSource>::new(config);
    until(&mut bench, "it listens", |bench| bench.state().udp_port != 0);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let to = ("127.0.0.1", bench.state().udp_port as u16);
    for datagram in ["1 2", "3 4\n5 6\n", "7"] {
        socket.send_to(datagram.as_bytes(), to).unwrap();
    }
    assert_eq!(numbers(&forces(&mut bench, 3)), [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]);
    until(&mut bench, "the bad one", |bench| bench.state().taken.bad == 1);
}

#[test]
fn a_line_may_have_as_many_numbers_as_an_output() {
    let line = "seq -f '-%.0f.123456789e-300' -s ' ' 1024; exec sleep 1000";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({ "outputs": ["q: f64[1024]"] })));
    let mut got = Vec::new();
    until(&mut bench, "the sample", |bench| {
        got.extend(bench.outputs::<[f64; 1024]>("q"));
        !got.is_empty()
    });
    assert_eq!((got[0][0], got[0][1023]), (-1.123456789e-300, -1024.123456789e-300));
}

#[test]
fn many_datagrams_at_once_are_all_taken() {
    let config = json!({ "udp": "127.0.0.1:0", "outputs": ["force: fx N, fy N"] });
    let mut bench = Bench::<LinesSource>::new(config);
    until(&mut bench, "it listens", |bench| bench.state().udp_port != 0);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let to = ("127.0.0.1", bench.state().udp_port as u16);
    for i in 0..200 {
        socket.send_to(format!("{i} 0").as_bytes(), to).unwrap();
    }
    let got = forces(&mut bench, 200);
    assert!(got.iter().enumerate().all(|(i, force)| force.fx == i as f64), "{got:?}");
}

#[test]
fn a_serial_line_is_read_raw_and_told_when_it_goes() {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&device).unwrap();
    unlockpt(&device).unwrap();
    let port = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    let config = json!({ "serial": port, "outputs": ["force: fx N, fy N"], "restart": "never" });
    let mut bench = Bench::<LinesSource>::new(config);
    let mut device = std::fs::File::from(device);
    device.write_all(b"1,2\r\n3,4\r\n").unwrap();
    assert_eq!(numbers(&forces(&mut bench, 2)), [(1.0, 2.0), (3.0, 4.0)]);
    drop(device);
    let why = failed(&mut bench);
    assert!(why.starts_with(&port) && (why.contains("is gone") || why.contains("cannot be read")), "{why}");
}

#[test]
fn a_stopped_source_counts_anew_and_a_resumed_one_goes_on() {
    let mut bench = Bench::<LinesSource>::new(shell("echo 1 2; exec sleep 1000", json!({})));
    forces(&mut bench, 1);
    bench.stop().unwrap();
    assert_eq!(bench.state().operating_state.state, OperatingMode::DISABLED);
    bench.resume().unwrap();
    until(&mut bench, "one more", |bench| bench.state().taken.handed_on == 2);
    bench.stop().unwrap();
    bench.start().unwrap();
    assert_eq!(bench.state().taken, Taken::default());
    until(&mut bench, "one again", |bench| bench.state().taken.handed_on == 1);
}

#[test]
fn a_step_allocates_nothing() {
    let line = "while echo 1 2; do :; done";
    let mut bench = Bench::<LinesSource>::new(shell(line, json!({})));
    until(&mut bench, "samples", |bench| bench.state().taken.handed_on >= 8);
    bench.assert_no_alloc(|bench| bench.step(500));
}

#[test]
fn settings_are_refused_with_what_to_do() {
    let refused = |more: Value| {
        let mut config = json!({ "outputs": ["a: x"] });
        config.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap());
        Bench::<LinesSource>::created().configure(config).unwrap_err().reason
    };
    for (config, why) in [
        (json!({}), "program, udp, serial: give exactly one of them"),
        (json!({ "program": ["a"], "udp": "127.0.0.1:1" }), "program, udp, serial: give exactly one of them"),
        (json!({ "program": [""] }), "program: is empty; name a program"),
        (json!({ "udp": "9000" }), "udp: \"9000\" is not an address and a port: write 127.0.0.1:9000"),
        (json!({ "udp": "0.0.0.0:9000" }), "say \"udp_from_network\": true"),
        (json!({ "udp": "127.0.0.1:0", "outputs": [] }), "outputs: there are 0"),
        (json!({ "udp": "127.0.0.1:0", "outputs": ["a: x newton"] }), "did you mean `N`"),
        (json!({ "udp": "127.0.0.1:0", "outputs": ["a: x", "a: y"] }), "the name `a` is given twice"),
        (json!({ "udp": "127.0.0.1:0", "outputs": ["source: x"] }), "`source` would be there twice"),
        (
            json!({ "udp": "127.0.0.1:0", "outputs": ["taken: x"] }),
            "\"Taken\" would be the name of two types",
        ),
        (json!({ "udp": "127.0.0.1:0", "restart_delay_s": 60.0 }), "restart_delay_max_s: 30 s is below"),
    ] {
        let said = refused(config);
        assert!(said.contains(why), "{why}: {said}");
    }
    let mut missing = Bench::<LinesSource>::ready(shell("", json!({ "program": ["no-such-program-here"] })));
    let why = missing.start().unwrap_err().reason;
    assert!(why.starts_with("program: no-such-program-here cannot be started: No such file"), "{why}");
}

#[test]
fn another_description_makes_other_outputs() {
    let config = |outputs: Value| json!({ "udp": "127.0.0.1:0", "outputs": outputs });
    let mut bench = Bench::<LinesSource>::ready(config(json!(["force: fx N, fy N"])));
    bench.configure(config(json!(["force: Scalar", "more: f64"]))).unwrap();
    bench.start().unwrap();
    assert!(bench.outputs::<Scalar>("force").is_empty() && bench.outputs::<f64>("more").is_empty());
}
