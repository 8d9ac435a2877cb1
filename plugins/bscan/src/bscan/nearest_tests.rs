//! Nearest distance of the tip to the retina after a scan, however it ends (gate A6).
//!
//! Invariant: the true tip and the true first surface count, for a whole breath after the end, in virtual
//! time.
#![allow(clippy::unwrap_used)]

use nalgebra::Vector3;
use trocar_sdk::Text;
use trocar_sdk::data::{FixtureKind, Pose, Retreat, Twist};

use crate::Phase;
use crate::rig::{NEAREST_M, OFFSET_M, Rig, Setup, seeds};

/// A whole breath, s, is 4; and the way away from the retina, with some room.
const BREATH: usize = 4_300;

#[test]
fn after_an_abort_or_a_lost_surface_the_tip_stays_150_micrometres_away_for_a_whole_breath() {
    // The nearest offset there is; the eye goes up and down by 320 µm. Aborts at all times of its motion.
    for setup in seeds().flat_map(|seed| Setup::near("default", seed)) {
        let seed = setup.world.seed;
        for lost in [false, true] {
            let mut rig = Rig::new(setup);
            rig.begin();
            rig.until_scanning();
            rig.steps(50 + 37 * seed as usize);
            if lost {
                rig.dark_until_ns = u64::MAX;
                rig.steps(60);
            } else {
                rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
                rig.step();
            }
            assert_eq!(rig.progress().phase, Phase::IDLE);
            let nearest = rig.watch(BREATH).into_iter().chain([rig.errors().2]).fold(f64::INFINITY, f64::min);
            assert!(nearest > NEAREST_M, "seed {seed}, lost {lost}: {nearest:.2e} m");
        }
    }
}

#[test]
fn after_a_whole_scan_the_tip_stays_150_micrometres_away_for_a_whole_breath() {
    for setup in seeds().flat_map(|seed| Setup::near("default", seed)) {
        let seed = setup.world.seed;
        // A line of another length for each seed, so that it ends at all times of the eye's motion.
        let end_m = -1.4e-3 + 20e-6 * seed as f64;
        let mut rig = Rig::run(Setup { end_m, ..setup });
        let nearest = rig.watch(BREATH).into_iter().chain([rig.errors().2]).fold(f64::INFINITY, f64::min);
        assert!(nearest > NEAREST_M, "seed {seed}: {nearest:.2e} m");
    }
}

/// A scan at the least offset that has come to the end of its line `late` periods ago.
fn on_the_way_back(world: &str, seed: u64, late: usize) -> Rig {
    // A line of another length for each seed, so that it ends at all times of the eye's motion.
    let end_m = -1.45e-3 + 20e-6 * seed as f64;
    let mut rig = Rig::new(Setup { offset_m: 200e-6, end_m, ..Setup::new(world, seed) });
    rig.begin();
    rig.until_scanning();
    while rig.progress().phase == Phase::SCAN {
        rig.step();
    }
    assert_eq!(rig.progress().phase, Phase::RETRACT);
    rig.steps(late);
    rig
}

#[test]
fn a_tip_that_is_blind_on_its_way_back_goes_the_rest_and_stays_150_micrometres_away_for_a_whole_breath() {
    for seed in seeds() {
        let mut rig = on_the_way_back("default", seed, if seed % 2 == 0 { 0 } else { 300 });
        rig.dark_until_ns = u64::MAX;
        rig.steps(60);
        assert_eq!(rig.progress().phase, Phase::IDLE);
        let nearest = rig.watch(BREATH).into_iter().chain([rig.errors().2]).fold(f64::INFINITY, f64::min);
        assert!(nearest > NEAREST_M, "seed {seed}: {nearest:.2e} m");
        assert!(rig.bench.events::<Text<128>>("scan/bscan_aborted").is_empty(), "the image is there");
        assert_eq!(rig.bench_done(), 1);
    }
}

#[test]
fn an_abort_on_the_way_back_leads_the_tip_no_further_away_than_the_whole_way() {
    // Over an eye that rests, distance is way.
    for late in [0, 300, 700] {
        let mut rig = on_the_way_back("static_no_membrane", 1, late);
        rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
        rig.step();
        let rests = *rig.watch(400).last().unwrap();
        assert!((rests - 600e-6).abs() < 30e-6, "{late} ms late: {rests:.2e} m");
    }
}

#[test]
fn settings_that_leave_the_eye_no_room_are_refused_while_a_scan_runs() {
    let mut rig = Rig::new(Setup { offset_m: 200e-6, ..Setup::new("static", 1) });
    rig.begin();
    rig.until_scanning();
    let set = |rig: &mut Rig, live: &str| {
        let refused = rig.bench.configure(format!(r#"{{"rows": 8, "range_db": [40, 100], {live}}}"#)).err();
        rig.step();
        refused.map(|why| why.to_string()).unwrap_or_default()
    };
    for live in [r#""retract_m": 0"#, r#""eye_motion_m": 0.0008"#, r#""min_distance_m": 0.0003"#] {
        let refused = set(&mut rig, live);
        assert!(refused.contains("200 µm leaves no room for an eye"), "{live}: {refused}");
        assert_eq!(rig.retreat().distance, 0.4e-3);
    }
    assert_eq!(set(&mut rig, r#""retract_m": 0.0005"#), "");
    assert_eq!(rig.retreat().distance, 0.5e-3, "the robot knows of it");
    assert_eq!(rig.progress().phase, Phase::SCAN);
}

/// Kills a scan in the middle, and watches the robot for a whole breath: returns nearest distance and way
/// back, m.
fn kill(mut rig: Rig, seed: u64) -> (f64, f64) {
    rig.begin();
    rig.until_scanning();
    rig.steps(500 + 53 * seed as usize);
    // From here on nothing is sent, and nothing is ended.
    let from = rig.truth.last().unwrap().tip_z_m;
    let mut nearest = rig.watch(20).into_iter().fold(f64::INFINITY, f64::min);
    assert_eq!(rig.true_speed_m_s(), 0.0, "seed {seed}");
    let tip =
        |rig: &Rig| Vector3::from(rig.robot.read::<(), Pose>("truth/measured_cp", ()).unwrap().position);
    let stands = tip(&rig);
    assert!((stands.z - from).abs() < 15e-6, "seed {seed}: {:.2e} m", stands.z - from);
    nearest = nearest.min(rig.watch(BREATH).into_iter().fold(f64::INFINITY, f64::min));
    (nearest, (stands - tip(&rig)).norm())
}

#[test]
fn a_robot_whose_scan_is_killed_stands_within_twenty_milliseconds_and_then_goes_away_from_the_retina() {
    // The nearest offset there is; the eye goes up and down by 320 µm.
    for setup in seeds().flat_map(|seed| Setup::near("default", seed)) {
        let seed = setup.world.seed;
        let (nearest, back) = kill(Rig::new(setup), seed);
        assert!(nearest > NEAREST_M, "seed {seed}: {nearest:.2e} m");
        assert!((back - 0.4e-3).abs() < 3e-6, "seed {seed}: {back:.2e} m back");
    }
}

#[test]
fn a_robot_that_cannot_go_back_by_itself_stands_where_a_whole_breath_leaves_it_150_micrometres() {
    for seed in seeds() {
        let mut rig = Rig::new(Setup::new("default", seed));
        rig.retreats(false);
        let (nearest, back) = kill(rig, seed);
        assert!(nearest > NEAREST_M && back == 0.0, "seed {seed}: {nearest:.2e} m, {back:.2e} m back");
    }
}

#[test]
fn a_scan_that_is_late_for_a_moment_goes_on_and_one_that_has_ended_leaves_no_retreat() {
    let mut rig = Rig::new(Setup::new("static_no_membrane", 1));
    rig.begin();
    rig.until_scanning();
    assert_eq!(rig.retreat().distance, 0.4e-3);
    rig.watch(20);
    let from = rig.truth.len();
    rig.steps(300);
    let largest = rig.truth[from..].iter().map(|t| (t.distance_m - OFFSET_M).abs()).fold(0.0, f64::max);
    assert!(rig.progress().phase == Phase::SCAN && largest < 15e-6, "{largest:.2e} m");
    rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
    rig.step();
    assert_eq!(rig.retreat(), Retreat::default());
}

#[test]
fn while_a_scan_runs_the_robots_guard_lies_at_the_least_distance_above_the_surface_and_then_is_gone() {
    let mut rig = Rig::new(Setup::new("default", 3));
    assert_eq!(rig.guard().kind, FixtureKind(0));
    rig.begin();
    rig.until_scanning();
    for _ in 0..20 {
        rig.steps(50);
        let (guard, truth) = (rig.guard(), rig.truth.last().unwrap());
        let above_m = truth.tip_z_m + truth.distance_m - (guard.frame.position[2] - 0.121);
        // Half a turn about x, as well as the tool's encoders know how it stands.
        assert!(guard.kind == FixtureKind::PLANE && guard.frame.orientation[0] > 1.0 - 1e-9, "{guard:?}");
        assert!((above_m - 150e-6).abs() < 20e-6, "{above_m:.2e} m");
    }
    // Other commands do not bring the robot nearer.
    for _ in 0..400 {
        let down = Twist { linear: [0.0, 0.0, 0.009], ..Twist::default() };
        rig.robot.command::<_, ()>("axis/servo_cv", down).unwrap();
        let left = rig.watch(1)[0];
        assert!(left > 140e-6, "{left:.2e} m");
    }
    let mut rig = Rig::new(Setup::new("default", 3));
    rig.begin();
    rig.until_scanning();
    rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
    rig.step();
    assert_eq!(rig.guard().kind, FixtureKind(0));
}

#[test]
fn a_scan_that_begins_low_and_aside_rises_to_the_offset_before_it_slides() {
    for seed in seeds() {
        let setup = Setup::new("default", seed);
        let mut rig = Rig::new(Setup { place_m: [-1.1e-3, 0.0, 250e-6], ..setup });
        rig.begin();
        rig.until_scanning();
        let start_m = rig.truth[0].x_m;
        let slides = |t: &&crate::rig::Truth| (t.x_m - start_m).abs() > 5e-6;
        let first = rig.truth.iter().find(slides).expect("0.4 mm to the begin");
        assert!(first.distance_m > OFFSET_M - 60e-6, "seed {seed}: slides at {:.2e} m", first.distance_m);
        assert!(rig.errors().2 > NEAREST_M, "seed {seed}");
    }
}
