//! The sensor on the bench: forces of the world, bias, range, and what is not a tip.
//!
//! Invariant: time is the bench's; every tip is pushed with the stamp of the step that sees it.
#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;
use trocar_sdk::data::{Pose, Twist};
use trocar_sdk::testing::{Bench, assert_implements, contracts, numbers};

trocar_sdk::testing::count_allocations!();

/// A static world and a sensor without errors.
const EXACT: &str = r#"{"world": "static_no_membrane", "noise_n": 0, "drift_n_s": 0}"#;

fn surface() -> f64 {
    World::named("static_no_membrane", 1).unwrap().surface_z(0.0, 0.0, 0.0)
}

/// Steps with the tip at a place, moving, oriented as given.
fn hold(bench: &mut Bench<ForceSensor>, steps: u64, position: [f64; 3], linear: [f64; 3], turn: [f64; 4]) {
    for _ in 0..steps {
        let stamp = Stamp::from_ns(bench.now().ns() + 1_000_000);
        let pose = Pose { stamp, position, orientation: turn };
        let twist = Twist { stamp, linear, angular: [0.0; 3] };
        bench.push("tip", CartesianState { stamp, pose, twist, wrench: Wrench::default() });
        bench.step(1);
    }
}

fn press(bench: &mut Bench<ForceSensor>, depth: f64, steps: u64) {
    hold(bench, steps, [0.0, 0.0, surface() + depth], [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
}

fn measured(bench: &Bench<ForceSensor>) -> Wrench {
    bench.read("measured_cf", ()).unwrap()
}

#[test]
fn the_sensor_fulfils_the_contract_of_force_sensors() {
    assert_implements::<ForceSensor>(&contracts::FORCE_SENSOR);
}

#[test]
fn a_tip_above_the_retina_feels_nothing_and_20_micrometres_deep_3_millinewton() {
    let mut bench = Bench::<ForceSensor>::new(EXACT);
    press(&mut bench, -1e-3, 3);
    assert_eq!(measured(&bench), Wrench { stamp: bench.now(), ..Wrench::default() });
    press(&mut bench, 20e-6, 3);
    let force = measured(&bench).force;
    assert!((force[2] + 3e-3).abs() < 1e-9 && force[0] == 0.0, "{force:?}");
    let samples = bench.samples::<Wrench>("wrench");
    assert_eq!((samples.len(), samples[5].0, samples[5].1), (6, measured(&bench), bench.now()));
}

#[test]
fn between_two_samples_of_the_tip_its_twist_tells_where_it_is() {
    let mut bench = Bench::<ForceSensor>::new(EXACT);
    let at = surface() + 10e-6;
    hold(&mut bench, 1, [0.0, 0.0, at], [0.0, 0.0, 2e-3], [0.0, 0.0, 0.0, 1.0]);
    bench.step(5);
    let force = measured(&bench).force[2];
    assert!((force + 150.0 * 20e-6).abs() < 1e-9, "5 ms at 2 mm/s are 10 µm more: {force}");
}

#[test]
fn the_sclera_is_felt_in_the_shaft_and_in_its_frame() {
    let config = r#"{"world": "static", "noise_n": 0, "drift_n_s": 0, "site": "sclera"}"#;
    let mut bench = Bench::<ForceSensor>::new(config);
    hold(&mut bench, 1, [1e-3, 0.0, -1e-3], [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    assert!((measured(&bench).force[0] + 20e-3).abs() < 1e-12, "{:?}", measured(&bench));
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    hold(&mut bench, 1, [1e-3, 0.0, -1e-3], [0.0; 3], [0.0, 0.0, quarter, quarter]);
    let force = measured(&bench).force;
    assert!((force[1] - 20e-3).abs() < 1e-12 && force[0].abs() < 1e-12, "{force:?}");
}

#[test]
fn bias_takes_the_present_load_as_zero_until_a_restart() {
    let mut bench = Bench::<ForceSensor>::new(r#"{"world": "static_no_membrane"}"#);
    let refused = bench.command::<(), ()>("bias", ()).unwrap_err();
    assert!(refused.reason.starts_with("32 more samples are needed"), "{refused}");
    press(&mut bench, 40e-6, 32);
    bench.command::<(), ()>("bias", ()).unwrap();
    press(&mut bench, 40e-6, 1);
    assert!(measured(&bench).force[2].abs() < 1.2e-3, "{:?}", measured(&bench));
    press(&mut bench, 0.0, 1);
    assert!((measured(&bench).force[2] - 6e-3).abs() < 1.2e-3, "{:?}", measured(&bench));
    bench.stop().unwrap();
    bench.start().unwrap();
    press(&mut bench, 40e-6, 1);
    assert!((measured(&bench).force[2] + 6e-3).abs() < 1.2e-3, "{:?}", measured(&bench));
    assert_eq!(bench.state().zero, [0.0; 3]);
}

#[test]
fn overload_is_told_once_on_leaving_the_range_and_once_on_coming_back() {
    let mut bench =
        Bench::<ForceSensor>::new(r#"{"world": "static_no_membrane", "range_n": 0.005, "noise_n": 0}"#);
    for (depth, told) in [(20e-6, None), (50e-6, Some(true)), (60e-6, None), (10e-6, Some(false))] {
        press(&mut bench, depth, 5);
        let events = bench.events::<Flag>("overload");
        assert_eq!(events, told.map(Flag::from).into_iter().collect::<Vec<_>>(), "at {depth}");
        let expected = -150.0 * depth;
        assert!((measured(&bench).force[2] - expected).abs() < 2e-3, "values stay as measured");
    }
}

#[test]
fn without_a_valid_tip_samples_have_stamp_0_and_no_force() {
    let mut bench = Bench::<ForceSensor>::new(EXACT);
    bench.step(2);
    press(&mut bench, 20e-6, 1);
    assert!(measured(&bench).is_valid());
    bench.make_stale("tip");
    bench.step(1);
    assert_eq!(measured(&bench), Wrench::default());
    press(&mut bench, 20e-6, 1);
    bench.step(25);
    assert_eq!(measured(&bench), Wrench::default(), "the tip is 25 ms old");
    for (position, orientation) in [([f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]), ([0.0; 3], [0.0; 4])] {
        hold(&mut bench, 1, position, [0.0; 3], orientation);
        assert_eq!(measured(&bench), Wrench::default());
    }
    let samples = bench.outputs::<Wrench>("wrench");
    assert_eq!(
        samples.iter().filter(|sample| sample.is_valid()).count() as u64 + bench.state().missed,
        samples.len() as u64
    );
}

#[test]
fn noise_and_drift_are_those_of_range_and_the_same_for_the_same_seed() {
    let run = |seed: u64| {
        let mut bench = Bench::<ForceSensor>::new(format!(r#"{{"seed": {seed}, "noise_n": 0.001}}"#));
        press(&mut bench, -2e-3, 2_000);
        bench.outputs::<Wrench>("wrench").iter().map(|sample| sample.force[1]).collect::<Vec<_>>()
    };
    let (one, other) = (run(1), run(2));
    assert_eq!(one, run(1));
    assert_ne!(one, other);
    let mean = one.iter().sum::<f64>() / 2_000.0;
    let deviation = (one.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / 2_000.0).sqrt();
    assert!((deviation / 1e-3 - 1.0).abs() < 0.06, "{deviation}");
    let bench = Bench::<ForceSensor>::new(r#"{"noise_n": 0.001, "range_n": 0.3}"#);
    let range: ForceRange = bench.read("range", ()).unwrap();
    assert_eq!(
        (range.force, range.force_noise, range.torque, range.rate),
        ([0.3; 3], 0.001, [0.0; 3], 1000.0)
    );
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<ForceSensor>::new("{}");
    bench.assert_no_alloc(|bench| {
        press(bench, 10e-6, 40);
        bench.command::<(), ()>("bias", ()).unwrap();
        bench.step(30);
    });
}

#[test]
fn a_world_or_site_that_is_none_is_refused() {
    let refused = Bench::<ForceSensor>::created().configure(r#"{"world": "mars"}"#).unwrap_err();
    assert!(refused.reason.contains("mars"), "{refused}");
    assert!(Bench::<ForceSensor>::created().configure(r#"{"site": "lens"}"#).is_err());
    assert!(Bench::<ForceSensor>::created().configure(r#"{"range_n": 0}"#).is_err());
}

#[test]
fn the_worlds_to_choose_from_are_those_there_are() {
    let field = <ForceSensorConfig as Config>::FIELDS.iter().find(|f| f.name == "world").unwrap();
    let schema = format!("{{{}}}", field.schema);
    let schema: trocar_sdk::serde_json::Value = trocar_sdk::serde_json::from_str(&schema).unwrap();
    assert_eq!(schema["enum"], trocar_sdk::serde_json::json!(World::NAMES));
}

#[test]
fn a_tip_that_turns_faster_than_anything_feels_nothing_that_can_be_told() {
    let mut bench = Bench::<ForceSensor>::new("{}");
    let stamp = bench.now();
    let pose = Pose { stamp, position: [0.0, 0.0, surface()], ..Pose::default() };
    let twist = Twist { stamp, linear: [0.0; 3], angular: [1e308, 1.0, 1.0] };
    bench.push("tip", CartesianState { stamp, pose, twist, wrench: Wrench::default() });
    bench.step(1);
    assert_eq!((measured(&bench), bench.state().missed), (Wrench::default(), 1));
}

fn any_number() -> impl Strategy<Value = f64> {
    let size = prop_oneof![4 => -6.0..1.0f64, 2 => -300.0..308.2f64, 1 => Just(154.5), 1 => Just(308.0)];
    (size, any::<bool>()).prop_map(|(e, below)| 10f64.powf(e) * if below { -1.0 } else { 1.0 })
}

proptest! {
    #[test]
    fn a_force_is_a_number_wherever_the_tip_says_it_is_and_whenever_the_sensor_steps(
        tips in prop::collection::vec(
            (
                prop::array::uniform3(any_number()),
                prop::array::uniform6(any_number()),
                prop::array::uniform4(-1.0..1.0f64),
                -30_000_000..30_000_000i64,
                prop::option::of((0..11u32).prop_map(|e| 10u64.pow(e))),
            ),
            1..40,
        ),
        world in prop::sample::select(World::NAMES.to_vec()), site in prop::sample::select(vec!["tip", "sclera"]),
    ) {
        let mut bench = Bench::<ForceSensor>::new(format!(r#"{{"world": "{world}", "site": "{site}"}}"#));
        for (position, [a, b, c, d, e, f], turn, age_ns, pace) in tips {
            let norm = turn.iter().map(|x| x * x).sum::<f64>().sqrt();
            let orientation = turn.map(|x| x / norm);
            let stamp = Stamp::from_ns(bench.now().ns().saturating_add_signed(-age_ns / 3));
            let pose = Pose { stamp, position, orientation };
            let twist = Twist { stamp, linear: [a, b, c], angular: [d, e, f] };
            bench.push("tip", CartesianState { stamp, pose, twist, wrench: Wrench::default() });
            match pace {
                None => bench.step(1),
                Some(ns) => bench.step_after(ns).unwrap(),
            }
            let _ = bench.command::<(), ()>("bias", ());
            let told = [numbers(&bench.state()), numbers(&bench.outputs::<Wrench>("wrench")[0])].concat();
            prop_assert!(told.iter().all(|n| n.is_finite()), "{told:?} at {pose:?}, {twist:?}");
        }
    }
}
