//! Where a component lives makes no difference to what it computes.
//!
//! Promise: one system file, only its `process` fields changed, gives the same results in one process and in
//! three: every sample, frame, event and answer, in the same order, from plugins in Rust, in C++, and each
//! talking to the other.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};
use trocar_tests::{Built, Grpcurl, HostProcess, World, eventually, number, skip};

const SAMPLES: u64 = 1500;
const FRAMES: u64 = 200;
const ROUNDS: u64 = 40;
/// Rounds of calls that one order asks for.
const AT_ONCE: u64 = 10;
/// How often a run is done again.
const RUNS: usize = 4;

/// Each name stands for a process and is replaced by it; each @ for the plugin of a class. Queues hold all
/// there is, so that it does not matter how late anybody is.
const FILE: &str = r#"{
  "version": 1,
  "processes": { PROCESSES },
  "components": {
    "SOURCE/feed":     { "class": "@feed/Feed" },
    "MIDDLE/filter":   { "class": "@filter/Filter" },
    "MIDDLE/robot":    { "class": "@robot/Robot" },
    "SINK/recorder":   { "class": "@recorder/Recorder", "config": { "frames": 200 } }
  },
  "connections": [
    { "client": "MIDDLE/filter/sample",   "server": "SOURCE/feed/sample",       "queue": { "fifo": 2048 } },
    { "client": "MIDDLE/filter/frame",    "server": "SOURCE/feed/frame",        "queue": { "fifo": 4 } },
    { "client": "SINK/recorder/sample",   "server": "MIDDLE/filter/sample_out", "queue": { "fifo": 2048 } },
    { "client": "SINK/recorder/frame",    "server": "MIDDLE/filter/frame_out",  "queue": { "fifo": 4 } },
    { "client": "SINK/recorder/feed",     "server": "SOURCE/feed/feed" },
    { "client": "SINK/recorder/arm",      "server": "MIDDLE/robot/arm",         "mailbox": 1024 }
  ]
}"#;

/// Which process has the source, the filter and the robot, the recorder.
type Places = [&'static str; 3];
const ONE: Places = ["all", "all", "all"];
const THREE: Places = ["source", "middle", "sink"];

/// The plugin of each class.
#[derive(Clone, Copy)]
struct Plugins {
    feed: &'static str,
    filter: &'static str,
    robot: &'static str,
    recorder: &'static str,
}

impl Plugins {
    fn any_in_cpp(self) -> bool {
        [self.feed, self.filter, self.robot, self.recorder].contains(&CPP)
    }
}

const RUST: &str = "fixture-places";
const CPP: &str = "places_cpp";

/// All that came of a run.
#[derive(Debug, PartialEq)]
struct Results {
    /// What the recorder kept, by kind.
    kept: BTreeMap<&'static str, Vec<f64>>,
    /// The last row of every component.
    rows: BTreeMap<&'static str, Value>,
}

struct Running {
    process: HostProcess,
    grpc: Grpcurl,
    places: Places,
    _world: World,
}

impl Running {
    /// `trocar run` for one process, `trocar up` for more.
    fn start(places: Places, plugins: Plugins) -> Running {
        let world = World::with_plugins(&["fixture_places"]);
        if plugins.any_in_cpp() {
            world.drop_in(&Built::cpp_plugin("places_cpp"));
        }
        let names: BTreeSet<&str> = places.into();
        let processes: Vec<String> =
            names.iter().map(|name| format!(r#""{name}": {{ "plugins": ["plugins"] }}"#)).collect();
        let mut file = FILE.replace("PROCESSES", &processes.join(", "));
        for (word, process) in ["SOURCE", "MIDDLE", "SINK"].iter().zip(places) {
            file = file.replace(&format!("{word}/"), &format!("{process}/"));
        }
        let Plugins { feed, filter, robot, recorder } = plugins;
        for (word, plugin) in [("feed", feed), ("filter", filter), ("robot", robot), ("recorder", recorder)] {
            file = file.replace(&format!("@{word}"), plugin);
        }
        let path = world.write("system.json", file);
        let verb = if names.len() == 1 { "run" } else { "up" };
        let args = [verb.into(), path.into(), "--listen".into(), "127.0.0.1:0".into(), "--json".into()];
        let process = HostProcess::spawn(&world, verb, &args);
        let grpc = process.grpcurl();
        Running { process, grpc, places, _world: world }
    }

    /// Path of a component.
    fn at(&self, component: &str) -> String {
        let [source, middle, sink] = self.places;
        let process = match component {
            "feed" => source,
            "recorder" => sink,
            _ => middle,
        };
        format!("{process}/{component}")
    }

    /// Asks, again where nobody answered: on a busy machine a process may be thought lost for a while. What
    /// is asked here does no more when it is asked twice.
    fn ask(&self, method: &str, body: &Value) -> Value {
        eventually(&format!("{method} {body}"), || {
            let answer = self.grpc.call(method, body.clone());
            answer.map(|answer| answer["json"].clone())
        })
    }

    fn call(&self, path: &str, arg: u64) -> Value {
        self.ask("InteractService/Invoke", &json!({ "path": path, "json": arg, "deadline": "30s" }))
    }

    fn row(&self, component: &str) -> Value {
        self.ask("InteractService/Read", &json!({ "path": self.at(component) }))
    }

    /// A log of the recorder, page by page.
    fn log(&self, kind: &str) -> Vec<f64> {
        let mut all: Vec<f64> = Vec::new();
        loop {
            let path = format!("{}/rec/{kind}_from", self.at("recorder"));
            let page = self.call(&path, all.len() as u64);
            let page = page.as_array().unwrap_or_else(|| panic!("{kind} is no list: {page}"));
            if page.is_empty() {
                return all;
            }
            all.extend(page.iter().map(|x| x.as_f64().unwrap_or(f64::NAN)));
        }
    }

    /// Numbers of the links of its connections; another number: it was lost for a while.
    fn links(&self) -> Vec<String> {
        let of = |c: &Value| c["proxies"].as_array().cloned().unwrap_or_default();
        let halves = self.connections().iter().flat_map(of).collect::<Vec<_>>();
        halves.iter().map(|half| half["epoch"].to_string()).collect()
    }

    /// Lets everything happen at once, and waits until all of it has arrived. `None`: a connection was lost
    /// meanwhile, and what was under way on it.
    fn results(&self) -> Option<Results> {
        let links = self.links();
        self.call(&format!("{}/feed/go", self.at("feed")), SAMPLES);
        for order in 1..=ROUNDS / AT_ONCE {
            let run = format!("{}/rec/run", self.at("recorder"));
            assert_eq!(number(&self.call(&run, order * AT_ONCE)), order * AT_ONCE);
        }
        // In each round it goes and advances, in each seventh it goes home, too.
        let events = 2 * ROUNDS + ROUNDS.div_ceil(7);
        let arrived = eventually("everything has arrived", || {
            let row = self.row("recorder");
            let got = ["samples", "frames", "events"].map(|key| number(&row[key]));
            match got == [SAMPLES, FRAMES, events] {
                false if self.links() == links => Err(row),
                arrived => Ok(arrived),
            }
        });
        if !arrived {
            return None;
        }
        let kinds = ["samples", "frames", "events", "answers"];
        let components = ["feed", "filter", "robot", "recorder"];
        let results = Results {
            kept: kinds.map(|kind| (kind, self.log(kind))).into(),
            rows: components.map(|name| (name, self.row(name))).into(),
        };
        // A call may have come to nothing, too.
        (self.links() == links).then_some(results)
    }

    fn connections(&self) -> Vec<Value> {
        let list = self.grpc.ok("GcmService/List", json!({}));
        list["connections"].as_array().cloned().unwrap_or_default()
    }
}

/// A machine that gives a process no time for a third of a second makes its peers think it lost, and samples
/// are, too. That is another promise's business: such a run is done again.
fn run(places: Places, plugins: Plugins) -> Results {
    for _ in 0..RUNS {
        let mut running = Running::start(places, plugins);
        eventually("in three processes all six connections pass between two, in one none", || {
            let carriers: Vec<Value> = running.connections().iter().map(|c| c["carrier"].clone()).collect();
            let far = carriers.iter().filter(|carrier| *carrier == "memfd").count();
            if far == if places == ONE { 0 } else { 6 } { Ok(()) } else { Err(format!("{carriers:?}")) }
        });
        let results = running.results();
        let status = running.process.interrupt();
        assert!(status.success(), "{status}: {}", running.process.printed());
        if let Some(results) = results {
            return results;
        }
    }
    panic!("in each of {RUNS} runs connections were lost: this machine is too busy, or something is wrong");
}

/// Where two runs differ first, for whoever reads of it.
fn compare(one: &Results, other: &Results, what: &str) {
    for (kind, kept) in &one.kept {
        let theirs = &other.kept[kind];
        let differs = kept.iter().zip(theirs).position(|(a, b)| a.to_bits() != b.to_bits());
        if let Some(at) = differs {
            let around = |all: &[f64]| all[at.saturating_sub(6)..all.len().min(at + 6)].to_vec();
            panic!("{what}: {kind} differ at {at}: {:?} and {:?}", around(kept), around(theirs));
        }
        assert_eq!(kept.len(), theirs.len(), "{what}: how many {kind}");
    }
    assert_eq!(one.rows, other.rows, "{what}: last rows");
}

/// What the arithmetic says, so that two runs are not merely wrong in the same way.
fn is_right(results: &Results) {
    let mut value = 0.0;
    let samples = (0..SAMPLES).flat_map(|index| {
        value += 0.3 * ((index * 37 % 1009) as f64 / 8.0 - value);
        [index as f64, value]
    });
    assert_eq!(results.kept["samples"], samples.collect::<Vec<_>>(), "samples are as computed here");
    let frames = results.kept["frames"].chunks(3).enumerate();
    assert_eq!(results.kept["frames"].len() as u64, 3 * FRAMES);
    for (index, frame) in frames {
        let size = 1 + index * 7919 % 60_000;
        let bytes = (0..size).map(|at| {
            let byte = (index * 31 + at * 7 + at / 256) as u8;
            if index % 3 == 0 { byte } else { byte ^ index as u8 }
        });
        let digest = bytes.fold(0x811c_9dc5_u32, |h, b| (h ^ u32::from(b)).wrapping_mul(0x0100_0193));
        assert_eq!(
            frame,
            [index as f64, size as f64, f64::from(digest)],
            "frame {index} is as computed here"
        );
    }
    let answers = &results.kept["answers"];
    assert!(answers.iter().all(|x| *x >= 0.0), "every call came to something: {answers:?}");
    // Round 1: sent; 1 + 0.5; read; three times that; commands so far, those of round 0 among them.
    assert_eq!(answers[6..11], [1.0, 1.5, 1.5, 4.5, 5.0], "{answers:?}");
}

fn same_in_one_and_three(plugins: Plugins, what: &str) -> Results {
    let one = run(ONE, plugins);
    is_right(&one);
    compare(&one, &run(THREE, plugins), what);
    one
}

/// There is no compiler for it; then the test is skipped.
fn no_cpp() -> bool {
    let why = std::env::var("TROCAR_NO_CPP");
    why.iter().for_each(|why| skip(why));
    why.is_ok()
}

#[test]
fn rust_plugins_give_the_same_in_one_process_and_in_three() {
    same_in_one_and_three(Plugins { feed: RUST, filter: RUST, robot: RUST, recorder: RUST }, "Rust");
}

#[test]
fn cpp_plugins_give_the_same_in_one_process_and_in_three() {
    if no_cpp() {
        return;
    }
    same_in_one_and_three(Plugins { feed: CPP, filter: CPP, robot: CPP, recorder: CPP }, "C++");
}

#[test]
fn rust_and_cpp_plugins_give_each_other_the_same_in_one_process_and_in_three() {
    if no_cpp() {
        return;
    }
    let between = Plugins { feed: RUST, filter: CPP, robot: CPP, recorder: RUST };
    let one = same_in_one_and_three(between, "C++ between Rust");
    let around = Plugins { feed: CPP, filter: RUST, robot: RUST, recorder: CPP };
    compare(&one, &same_in_one_and_three(around, "Rust between C++"), "either language");
}
