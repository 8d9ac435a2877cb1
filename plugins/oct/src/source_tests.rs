//! The simulated spectrometer on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::{Pose, Twist};
use trocar_sdk::testing::{Bench, assert_implements, contracts};

trocar_sdk::testing::count_allocations!();

fn counts(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks::<2>().0.iter().map(|b| u16::from_ne_bytes(*b)).collect()
}

#[test]
fn lines_come_at_their_rate_with_numbers_and_times() {
    let mut bench = Bench::<OctSource>::new("{}");
    let begin = bench.now();
    bench.step(3);
    let frames = bench.frames::<SpectraHeader>("spectra");
    let told: Vec<_> = frames.iter().map(|(h, bytes, _)| (h.index, h.lines, bytes.len())).collect();
    assert_eq!(told, [(0, 4, 8192), (4, 4, 8192), (8, 4, 8192)]);
    let (header, bytes, stamp) = &frames[1];
    assert_eq!((header.samples, header.bits, header.format), (1024, 12, SampleFormat::U16));
    assert_eq!((header.stamp.ns(), *stamp), (begin.ns() + 1_125_000, header.stamp));
    assert!((header.line_period - 250e-6).abs() < 1e-12);
    let middle = counts(bytes)[512];
    assert!((1800..2800).contains(&middle), "{middle} counts where the light is brightest");
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<OctSource>::new(r#"{"motion_blur": true}"#);
    bench.step(1);
    bench.assert_no_alloc(|bench| bench.step(10));
}

#[test]
fn the_same_seed_gives_the_same_lines_and_another_one_others() {
    let lines = |seed: u64| {
        let mut bench = Bench::<OctSource>::new(format!(r#"{{"seed": {seed}}}"#));
        bench.step(2);
        bench.frames::<SpectraHeader>("spectra").remove(1).1
    };
    assert_eq!(lines(3), lines(3));
    assert_ne!(lines(3), lines(4));
}

#[test]
fn the_truth_is_that_of_the_tip_where_it_was_at_each_line() {
    let mut bench = Bench::<OctSource>::new(r#"{"world": "static_no_membrane"}"#);
    let world = World::named("static_no_membrane", 1).unwrap();
    let stamp = bench.now();
    let pose = Pose { stamp, position: [0.2e-3, 0.0, -0.6e-3], ..Pose::default() };
    let twist = Twist { stamp, linear: [0.0, 0.0, 10e-3], ..Twist::default() };
    bench.push("tip", CartesianState { stamp, pose, twist, ..CartesianState::default() });
    bench.step(1);
    let truth = bench.outputs::<Distance>("true_distance");
    assert_eq!(truth.len(), 4);
    for (n, truth) in truth.iter().enumerate() {
        let t = 250e-6 * (n as f64 + 0.5);
        let wanted = world.surface_z(0.2e-3, 0.0, 0.0) + 0.6e-3 - 10e-3 * t;
        assert!((truth.distance - wanted).abs() < 1e-9, "line {n}: {} for {wanted}", truth.distance);
        assert!(truth.valid.get());
    }
    assert_eq!(bench.read::<(), Distance>("truth/distance", ()).unwrap().stamp, truth[3].stamp);
}

#[test]
fn a_tip_that_is_told_no_more_stands_where_its_twist_had_carried_it() {
    let mut bench = Bench::<OctSource>::new(r#"{"world": "static_no_membrane"}"#);
    let world = World::named("static_no_membrane", 1).unwrap();
    let stamp = bench.now();
    let pose = Pose { stamp, position: [0.2e-3, 0.0, -0.9e-3], ..Pose::default() };
    let twist = Twist { stamp, linear: [0.0, 0.0, 10e-3], ..Twist::default() };
    bench.push("tip", CartesianState { stamp, pose, twist, ..CartesianState::default() });
    bench.step(40);
    let truth = bench.outputs::<Distance>("true_distance").pop().unwrap();
    let wanted = world.surface_z(0.2e-3, 0.0, 0.0) + 0.9e-3 - 10e-3 * trocar_sdk::CARRIED_S;
    assert!((truth.distance - wanted).abs() < 1e-9, "{} for {wanted}", truth.distance);
}

#[test]
fn the_worlds_to_choose_from_are_those_there_are() {
    let field = <OctSourceConfig as Config>::FIELDS.iter().find(|f| f.name == "world").unwrap();
    let schema = format!("{{{}}}", field.schema);
    let schema: trocar_sdk::serde_json::Value = trocar_sdk::serde_json::from_str(&schema).unwrap();
    assert_eq!(schema["enum"], trocar_sdk::serde_json::json!(World::NAMES));
}

#[test]
fn a_tool_that_points_away_sees_the_reference_alone_and_its_truth_is_not_valid() {
    let mut bench = Bench::<OctSource>::new("{}");
    let stamp = bench.now();
    let pose = Pose { stamp, orientation: [1.0, 0.0, 0.0, 0.0], ..Pose::default() };
    bench.push("tip", CartesianState { stamp, pose, ..CartesianState::default() });
    bench.step(1);
    assert!(!bench.read::<(), Distance>("truth/distance", ()).unwrap().valid.get());
    assert_eq!(bench.frames::<SpectraHeader>("spectra").len(), 1);
}

#[test]
fn lines_that_find_no_frame_or_come_too_late_are_told_and_their_numbers_are_missing() {
    let mut bench = Bench::<OctSource>::new("{}");
    bench.exhaust("spectra", true);
    bench.step(2);
    bench.exhaust("spectra", false);
    bench.step(1);
    assert_eq!(bench.events::<u64>("spectrometer/overrun"), [4, 8]);
    assert_eq!(bench.frames::<SpectraHeader>("spectra")[0].0.index, 8);
    bench.advance(100_000_000);
    bench.step(1);
    let (header, ..) = bench.frames::<SpectraHeader>("spectra").remove(0);
    assert_eq!((header.index, header.lines), (12 + 404 - 64, 64));
    assert_eq!(bench.events::<u64>("spectrometer/overrun"), [8 + 340]);
}

#[test]
fn a_triggered_source_takes_frames_at_triggers_only_and_a_free_one_refuses_them() {
    let mut bench = Bench::<OctSource>::new(r#"{"triggered": true, "max_lines": 8}"#);
    bench.step(10);
    assert!(bench.frames::<SpectraHeader>("spectra").is_empty());
    for first in [0, 8] {
        bench.command::<(), ()>("spectrometer/trigger", ()).unwrap();
        bench.step(5);
        let frames = bench.frames::<SpectraHeader>("spectra");
        assert_eq!(frames.iter().map(|f| (f.0.index, f.0.lines)).collect::<Vec<_>>(), [(first, 8)]);
    }
    assert!(bench.events::<u64>("spectrometer/overrun").is_empty());
    let mut free = Bench::<OctSource>::new("{}");
    let refused = free.command::<(), ()>("spectrometer/trigger", ()).unwrap_err().reason;
    assert!(refused.contains("runs freely"), "{refused}");
}

#[test]
fn light_can_go_out_and_be_too_much_while_it_runs() {
    let mut bench = Bench::<OctSource>::new("{}");
    bench.configure(r#"{"light": false}"#).unwrap();
    bench.step(1);
    bench.configure(r#"{"reference": 1.4}"#).unwrap();
    bench.step(1);
    let frames = bench.frames::<SpectraHeader>("spectra");
    assert!(counts(&frames[0].1).iter().all(|count| *count < 10));
    assert!(counts(&frames[1].1).iter().filter(|count| **count == 4095).count() > 100);
    assert_eq!(frames[1].0.index, 4, "numbers go on");
}

#[test]
fn what_cannot_be_simulated_is_refused_by_name() {
    let refused = |json: &str| Bench::<OctSource>::created().configure(json).unwrap_err().reason;
    assert!(refused(r#"{"world": "flat"}"#).contains("is not one of \"default\""));
    assert!(refused(r#"{"samples": 1000}"#).starts_with("samples: 1000 is no multiple of 128"));
    assert!(refused(r#"{"exposure_s": 0.01}"#).starts_with("exposure_s: 0.01 s is longer than a line"));
}

#[test]
fn the_source_fulfils_the_contract_of_spectrometers() {
    assert_implements::<OctSource>(&contracts::SPECTROMETER);
    let bench = Bench::<OctSource>::ready(r#"{"samples": 2048}"#);
    let s: Spectrometer = bench.read("spectrometer/spectrometer", ()).unwrap();
    assert_eq!((s.samples, s.bits), (2048, 12));
    assert!((s.wavelength_of(0) - 790e-9).abs() < 1e-15 && (s.wavelength_of(2047) - 890e-9).abs() < 1e-15);
}
