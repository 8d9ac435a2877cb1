//! The newcomer's first command.
//!
//! Promise: `trocar demo` runs robot or hand at 1 kHz, OCT at 4 kHz and video at 30 pairs/s, in one process
//! or three with the same figures, accounts for every period and picture, keeps the tip at its distance,
//! shows what was done in pictures, and stops cleanly; a process of it that is killed comes back.

mod counted;
mod machines;
mod terminal;
mod timed;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, number};

use crate::processes::system::{children, gone, kill, pid};

/// The figures of a demo that was measured for so long; they account for its periods and pictures.
fn measured(processes: &str, seconds: &str) -> Value {
    let world = World::new();
    let output = Trocar::new(&world)
        .run(&["demo", "--processes", processes, "--listen", "127.0.0.1:0", "--seconds", seconds, "--json"])
        .ends_with(0);
    let figures = output.json();
    accounts_for_periods_and_pictures(&figures);
    figures
}

/// Asserts as many periods and pictures as belong to the time of the count, as exactly as that is known.
fn accounts_for_periods_and_pictures(figures: &Value) {
    let of = |part: &Value, key: &str| part[key].as_f64().unwrap_or_else(|| panic!("{key} of {figures}"));
    let near = |what: &str, counted: u64, hz: f64, part: &Value, slack: f64| {
        let (expected, unsure) = (of(part, "seconds") * hz, of(part, "unsure_s") * hz + slack);
        assert!(
            (counted as f64 - expected).abs() <= unsure,
            "{counted} {what}, not {expected:.1} ± {unsure:.1}: {figures}"
        );
    };
    let (robot, video) = (&figures["robot"], &figures["video"]);
    // A step may be late by nearly a period, at either end.
    near("periods", number(&robot["executed"]) + number(&robot["skipped"]), 1000.0, robot, 2.0);
    let pictures = number(&video["pairs"]) + number(&video["left_out"]) + number(&video["drops"]);
    // Some are on their way at either end.
    near("pictures", pictures, 30.0, figures, 3.0);
}

#[test]
fn a_running_demo_answers_grpcurl_and_ends_cleanly_on_ctrl_c() {
    let world = World::new();
    let mut demo = demo(&world, &[]);
    let list = demo.grpcurl().ok("GcmService/List", json!({}));
    let components = list["components"].as_array().cloned().unwrap_or_default();
    assert_eq!(components.len(), 15, "robot, OCT, behaviour, video and what writes pictures: {list}");
    for component in &components {
        assert_eq!(component["state"], "COMPONENT_STATE_ACTIVE", "{component}");
    }
    eventually("it prints lines to paste", || {
        let printed = demo.printed();
        if printed.contains("grpcurl") { Ok(()) } else { Err(printed) }
    });

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
    assert_eq!(of(&list, "processes", "name"), ["host", "oct", "robot"], "{list}");
    let states = of(&list, "components", "state");
    assert_eq!(states, ["COMPONENT_STATE_ACTIVE"; 15], "{list}");
    let far = of(&list, "connections", "carrier").iter().filter(|c| *c == "memfd").count();
    assert_eq!(far, 10, "what the robot's and the OCT's processes have to do with others: {list}");

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
    for name in ["oct", "robot"] {
        let before = process(name);
        kill("-KILL", pid(&before));
        eventually(&format!("{name} is back"), || match process(name) {
            now if now["state"] == "PROCESS_STATE_ATTACHED" && pid(&now) != pid(&before) => Ok(()),
            now => Err(now),
        });
    }
    grpc.await_state("oct/source", "ACTIVE");
    grpc.await_state("robot/robot", "STOPPED");
    grpc.ok("GcmService/Resume", json!({ "path": "robot/robot" }));
    let pairs = number(&shown());
    eventually("video flows again", || match number(&shown()) {
        now if now > pairs + 30 => Ok(()),
        now => Err(now),
    });
    let commands = || number(&grpc.component("robot/robot")["stats"]["commands"]);
    let moved = commands();
    eventually("the robot is moved again", || if commands() > moved { Ok(()) } else { Err("no command") });
    eventually("the table tells of both", || {
        let printed = demo.printed();
        let rows = ["robot ", "oct "].map(|name| {
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

/// Pictures of each behaviour, as PNG files of the size they are said to have.
#[test]
fn each_behaviour_writes_pictures_of_what_it_did_and_overwrites_none() {
    for (behavior, of_oct) in
        [("bscan", "demo-bscan.png"), ("cooperative", "demo-mscan.png"), ("free-hand", "demo-mscan.png")]
    {
        let world = World::new();
        let dir = world.path("pictures");
        let words = pictured(behavior, &dir);
        let figures = Trocar::new(&world).run(&words).ends_with(0).json();
        let names = ["demo-tracking.png", "demo.png", of_oct, "demo-depth.png"];
        let written = figures["pictures"].as_array().cloned().unwrap_or_default();
        assert_eq!(written.len(), names.len(), "{behavior}: {figures}");
        for (name, told) in names.iter().zip(&written) {
            let path = dir.join(name);
            assert_eq!(told.as_str(), path.to_str(), "{behavior}: {figures}");
            let (width, height, distinct) = png(&path);
            let expected = match *name {
                "demo.png" => (2048, 768),
                // With its colour bar and the sentence below.
                "demo-depth.png" => (1144, 792),
                "demo-tracking.png" => (1200, 600),
                // 3 mm across a tool that leans by 25 to 32 degrees, as the port turns it.
                "demo-bscan.png" => (width.clamp(460, 490), 305),
                _ => (512, 512),
            };
            assert_eq!((width, height), expected, "{behavior}: {name}");
            assert!(distinct > 8, "{behavior}: {name} has {distinct} colours");
        }
        Trocar::new(&world).run(&words).ends_with(1).says("is there already");
    }
}

/// Words of a demo that runs for a second with this behaviour and writes its pictures there.
fn pictured(behavior: &str, dir: &Path) -> Vec<OsString> {
    let fixed = ["demo", "--listen", "127.0.0.1:0", "--json", "--seconds", "1", "--behavior", behavior];
    let mut words: Vec<OsString> = fixed.map(OsString::from).to_vec();
    words.push("--pictures".into());
    words.push(dir.into());
    words
}

/// Width, height and number of colours of a PNG file.
fn png(path: &Path) -> (u32, u32, usize) {
    let file = std::fs::File::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG file");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size that fits")];
    let frame = reader.next_frame(&mut pixels).expect("pixels");
    let each = frame.color_type.samples();
    let colours: BTreeSet<&[u8]> = pixels.chunks_exact(each).collect();
    (frame.width, frame.height, colours.len())
}

/// A demo that runs.
fn demo(world: &World, more: &[&str]) -> HostProcess {
    let mut args: Vec<OsString> = ["demo", "--listen", "127.0.0.1:0"].map(OsString::from).to_vec();
    args.extend(more.iter().map(OsString::from));
    HostProcess::spawn(world, "demo", &args)
}

/// Where a process keeps its state, as it was told.
fn state_directory(pid: u64) -> Option<String> {
    let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
    let mut words = line.split('\0').skip_while(|word| *word != "--state");
    words.nth(1).map(str::to_owned)
}
