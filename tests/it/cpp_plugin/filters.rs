//! The low-pass in C++ and the one in Rust, side by side and one behind the other, fed with the same samples.
//!
//! Promise: whoever takes a filter's output cannot tell the languages apart by any sample of it.

use std::f64::consts::TAU;
use std::path::Path;

use serde_json::{Value, json};
use tokio::runtime::Runtime;
use trocar::model::{Execution, ExecutionModel};
use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};
use trocar_tests::{Built, World, eventually, repository};

/// Samples of one feeding.
const SAMPLES: usize = 48;
/// Numbers in them: three axes each.
const VALUES: usize = 3 * SAMPLES;
/// Where the feeder spoils samples, one of so many is none.
const SPOILT_EVERY: usize = 4;
/// Period of the thread that all of them share, s.
const PERIOD_S: f64 = 1e-3;
/// Compilers may fuse a product and a sum into one rounding, N.
const ROUNDING: f64 = 1e-12;

/// The payload of both filters.
#[derive(Payload, Clone, Copy, Default)]
#[repr(C)]
struct Force {
    stamp: Stamp,
    #[unit("N")]
    f: [f64; 3],
}

/// Sample `n` of the feeding, N: it jumps, so that a filter that missed one is far off.
fn fed(n: usize) -> [f64; 3] {
    [37, 48, 59].map(|step| ((n + 1) * step % 101) as f64 / 7.0 - 6.0)
}

/// One sample in [`SPOILT_EVERY`] is none that a sensor can have measured, when the feeder is told so.
fn spoilt(n: usize) -> [f64; 3] {
    let mut sample = fed(n);
    if n % SPOILT_EVERY == 1 {
        sample[n % 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e300][n / SPOILT_EVERY % 4];
    }
    sample
}

/// Gives out one sample a cycle once it is told to, each once.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl", "hold"))]
struct Feeder {
    #[output]
    raw: Out<Force>,
    /// Samples given out.
    #[state]
    given: u64,
    /// Times a filter told that the force is above its limit.
    #[state]
    holds: u64,
    feeds: bool,
    spoils: bool,
}

#[provides("ctl")]
impl Feeder {
    #[command]
    fn feed(&mut self) {
        self.feeds = true;
    }

    #[command]
    fn spoil(&mut self) {
        self.spoils = true;
    }
}

#[provides("hold")]
impl Feeder {
    #[command]
    fn hold(&mut self, _force: f64) {
        self.holds += 1;
    }
}

impl Component for Feeder {
    fn step(&mut self, _: &Tick) -> Result {
        if self.feeds && self.given < SAMPLES as u64 {
            let n = self.given as usize;
            let f = if self.spoils { spoilt(n) } else { fed(n) };
            self.raw.write(&Force { stamp: Stamp::INVALID, f });
            self.given += 1;
        }
        Ok(())
    }
}

/// Keeps all that comes.
#[derive(Component)]
#[component(model = "on_signal")]
struct Recorder {
    #[input(fifo = 64)]
    force: In<Force>,
    /// Numbers kept, three for each sample.
    #[state]
    kept: u64,
    #[state]
    #[unit("N")]
    values: [f64; VALUES],
}

impl Component for Recorder {
    fn step(&mut self, _: &Tick) -> Result {
        while let Some(sample) = self.force.next() {
            let from = self.kept as usize;
            let room = self.values.get_mut(from..from + 3).ok_or("more came than was given out")?;
            room.copy_from_slice(&sample.f);
            self.kept += 3;
        }
        Ok(())
    }
}

const PROBES: StaticPlugin = static_plugin!(name = "probes", Feeder, Recorder);

/// A feeder, and filters that step after it in its thread.
struct Scene {
    runtime: Runtime,
    host: trocar::Host,
    _world: World,
}

impl Scene {
    fn new() -> Scene {
        Scene::with_cpp(&Built::cpp_plugin("cpp_filter"))
    }

    /// `file`: the filter in C++.
    fn with_cpp(file: &Path) -> Scene {
        let world = World::with_plugins(&["filters"]);
        world.drop_in(file);
        let builder = trocar::Host::builder().name("lab").plugin(PROBES);
        let builder = builder.plugins(world.plugins()).vet_with(Built::trocar());
        let runtime = Runtime::new().unwrap();
        let host = runtime.block_on(builder.start()).unwrap();
        runtime.block_on(host.create("lab/feeder", "probes/feeder", json!({}))).unwrap();
        Scene { runtime, host, _world: world }
    }

    /// A filter behind `source`, an output, with what its class requires.
    fn filter(&self, name: &str, class: &str, source: &str, cutoff_hz: f64) {
        let path = format!("lab/{name}");
        let after = Execution {
            model: Some(ExecutionModel::ExecOut),
            inside: Some("lab/feeder".into()),
            ..Execution::default()
        };
        let config = json!({ "cutoff_hz": cutoff_hz });
        self.runtime.block_on(self.host.create_with(&path, class, config, after)).unwrap();
        self.connect(&format!("{name}/raw"), source);
        if class == RUST {
            self.connect(&format!("{name}/hold"), "feeder/hold");
        }
    }

    /// A recorder of `source`, an output.
    fn recorder(&self, name: &str, source: &str) {
        let path = format!("lab/{name}");
        self.runtime.block_on(self.host.create(&path, "probes/recorder", json!({}))).unwrap();
        self.connect(&format!("{name}/force"), source);
    }

    fn connect(&self, client: &str, server: &str) {
        let (client, server) = (format!("lab/{client}"), format!("lab/{server}"));
        self.runtime.block_on(self.host.connect(&client, &server)).unwrap();
    }

    /// Starts everything, then lets the samples go.
    fn feed(&self) {
        let started = self.runtime.block_on(self.host.start("lab/**")).unwrap();
        assert!(started.failed.is_empty(), "{:?}", started.failed);
        self.runtime.block_on(self.host.invoke("lab/feeder/ctl/feed", Value::Null)).unwrap();
    }

    fn row(&self, name: &str) -> Value {
        self.runtime.block_on(self.host.read(&format!("lab/{name}"))).unwrap().value
    }

    /// The samples a recorder has kept, once there are as many as were fed.
    fn recorded(&self, name: &str) -> Vec<[f64; 3]> {
        self.first_recorded(name, SAMPLES)
    }

    /// So many samples that a recorder has kept, once there are no fewer and no more.
    fn first_recorded(&self, name: &str, samples: usize) -> Vec<[f64; 3]> {
        let row = eventually(&format!("{name} has all samples"), || match self.row(name) {
            row if row["kept"] == json!(3 * samples) => Ok(row),
            row => Err(row["kept"].to_string()),
        });
        let values = row["values"].as_array().unwrap().iter().take(3 * samples);
        let values: Vec<f64> = values.map(|v| v.as_f64().unwrap()).collect();
        values.chunks(3).map(|v| [v[0], v[1], v[2]]).collect()
    }
}

const RUST: &str = "filters/low_pass";
const CPP: &str = "cpp_filter/cpp_low_pass";

/// What a first-order low-pass makes of these samples.
fn low_passed(samples: &[[f64; 3]], cutoff_hz: f64) -> Vec<[f64; 3]> {
    let a = 1.0 - (-TAU * cutoff_hz * PERIOD_S).exp();
    let mut y = [0.0; 3];
    let filtered = samples.iter().map(|x| {
        y = std::array::from_fn(|i| y[i] + a * (x[i] - y[i]));
        y
    });
    filtered.collect()
}

/// The same, sample for sample.
#[track_caller]
fn agree(what: &str, seen: &[[f64; 3]], expected: &[[f64; 3]]) {
    assert_eq!(seen.len(), expected.len(), "{what}");
    for (n, (seen, expected)) in seen.iter().zip(expected).enumerate() {
        let near = seen.iter().zip(expected).all(|(s, e)| (s - e).abs() <= ROUNDING);
        assert!(near, "{what}, sample {n}: {seen:?} came, {expected:?} was expected");
    }
}

fn feeding() -> Vec<[f64; 3]> {
    (0..SAMPLES).map(fed).collect()
}

#[test]
fn a_cpp_filter_computes_what_the_rust_filter_computes() {
    let scene = Scene::new();
    for (name, class) in [("rust", RUST), ("cpp", CPP)] {
        scene.filter(name, class, "feeder/raw", 60.0);
        scene.recorder(&format!("of_{name}"), &format!("{name}/filtered"));
    }
    scene.feed();
    let (of_rust, of_cpp) = (scene.recorded("of_rust"), scene.recorded("of_cpp"));
    agree("the Rust filter against the formula", &of_rust, &low_passed(&feeding(), 60.0));
    agree("the C++ filter against the Rust filter", &of_cpp, &of_rust);
    for name in ["rust", "cpp"] {
        let last = &scene.row(name)["y"]["f"];
        let last = [0, 1, 2].map(|i| last[i].as_f64().unwrap());
        agree(&format!("the row of the {name} filter"), &[last], &of_rust[SAMPLES - 1..]);
    }
}

#[test]
fn a_cpp_filter_of_each_earlier_abi_computes_what_it_did() {
    let archive = repository().join("tests/data/abi");
    // Refused elsewhere, see `plugin_loading/archive.rs`.
    if cfg!(not(target_arch = "x86_64")) {
        return;
    }
    for abi in ["1.0", "1.1"] {
        let scene = Scene::with_cpp(&archive.join(abi).join("libtrocar_cpp_filter.so"));
        scene.filter("old", CPP, "feeder/raw", 60.0);
        scene.recorder("of_old", "old/filtered");
        scene.feed();
        agree(&format!("the filter of ABI {abi}"), &scene.recorded("of_old"), &low_passed(&feeding(), 60.0));
    }
}

#[test]
fn rust_and_cpp_filters_work_in_one_chain_in_either_order() {
    let once = low_passed(&feeding(), 80.0);
    for (first, second) in [(CPP, RUST), (RUST, CPP)] {
        let scene = Scene::new();
        scene.filter("first", first, "feeder/raw", 80.0);
        scene.filter("second", second, "first/filtered", 20.0);
        scene.recorder("of_first", "first/filtered");
        scene.recorder("of_second", "second/filtered");
        scene.feed();
        agree(&format!("{first}, fed directly"), &scene.recorded("of_first"), &once);
        let twice = low_passed(&once, 20.0);
        agree(&format!("{second} behind {first}"), &scene.recorded("of_second"), &twice);
    }
}

#[test]
fn samples_that_nothing_can_have_measured_are_counted_and_leave_no_trace_in_either_filter() {
    let scene = Scene::new();
    for (name, class) in [("rust", RUST), ("cpp", CPP)] {
        scene.filter(name, class, "feeder/raw", 60.0);
        scene.recorder(&format!("of_{name}"), &format!("{name}/filtered"));
    }
    scene.runtime.block_on(scene.host.start("lab/feeder")).unwrap();
    scene.runtime.block_on(scene.host.invoke("lab/feeder/ctl/spoil", Value::Null)).unwrap();
    scene.feed();
    let good: Vec<_> = (0..SAMPLES).map(spoilt).filter(|x| x.iter().all(|f| f.abs() < 1e9)).collect();
    assert_eq!(good.len(), SAMPLES - SAMPLES / SPOILT_EVERY);
    for name in ["rust", "cpp"] {
        let seen = scene.first_recorded(&format!("of_{name}"), good.len());
        agree(name, &seen, &low_passed(&good, 60.0));
        eventually(&format!("{name} has counted the others"), || match scene.row(name) {
            row if row["rejected"] == json!(SAMPLES / SPOILT_EVERY) => Ok(()),
            row => Err(row["rejected"].to_string()),
        });
    }
}
