//! Causes that end a scan, and the state after them: one event, a hold, a tip that rests.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{OperatingMode, OperatingState, Pose};
use trocar_sdk::prelude::*;

use crate::rig::{APEX_Z_M, NEAREST_M, OFFSET_M, Rig, Setup, ready, seeds};
use crate::{Phase, ScanRequest};

#[test]
fn a_surface_lost_for_fifty_milliseconds_ends_the_scan_with_a_hold_and_the_tip_goes_away_and_rests() {
    for setup in seeds().flat_map(|seed| Setup::both("default", seed)) {
        let (seed, mut rig) = (setup.world.seed, Rig::new(setup));
        rig.begin();
        rig.until_scanning();
        rig.steps(1000);
        rig.dark_until_ns = u64::MAX;
        let from = rig.truth.last().unwrap().tip_z_m;
        rig.steps(51);
        let moved = rig.truth.last().unwrap().tip_z_m - from;
        assert!(moved.abs() < 50e-6, "seed {seed}: the tip went on by {moved:.2e} m");
        rig.steps(10);
        rig.watch(400);
        assert_eq!(
            rig.bench.events::<Text<128>>("scan/bscan_aborted"),
            ["the surface was not seen for 50 ms"]
        );
        assert_eq!((rig.progress().phase, rig.held), (Phase::IDLE, 1));
        assert!(rig.stands());
        let away = from - rig.truth.last().unwrap().tip_z_m;
        assert!((away - 0.4e-3 * setup.upright()).abs() < 50e-6, "seed {seed}: {away:.2e} m away");
        assert!(rig.refused.is_empty(), "{:?}", rig.refused);
    }
}

#[test]
fn a_deeper_layer_that_is_taken_for_the_surface_is_not_followed() {
    for seed in seeds() {
        let mut rig = Rig::new(Setup::new("default", seed));
        rig.begin();
        rig.until_scanning();
        rig.steps(1000);
        // The tracker takes it after 12 ms; the surface is back in time.
        rig.deep_until_ns = rig.bench.now().ns() + 25_000_000;
        let from = rig.truth.len();
        rig.steps(200);
        assert!(rig.truth[from..].iter().any(|t| t.measured.valid.get() && t.measured.distance > 620e-6));
        let largest = rig.truth[from..].iter().map(|t| (t.distance_m - OFFSET_M).abs()).fold(0.0, f64::max);
        assert!(largest < 50e-6, "seed {seed}: {largest:.2e} m");
        assert_eq!(rig.progress().phase, Phase::SCAN, "seed {seed}");
        // The deepest layer stays the only one.
        rig.deep_until_ns = u64::MAX;
        let from = rig.truth.len();
        rig.steps(62);
        let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
        assert_eq!(told.len(), 1, "seed {seed}");
        assert!(told[0].starts_with("the surface was not where it can be for 50 ms"), "{}", told[0]);
        let nearest = rig.truth[from..].iter().map(|t| t.distance_m).fold(f64::INFINITY, f64::min);
        assert!(nearest > OFFSET_M - 50e-6, "seed {seed}: {nearest:.2e} m");
    }
}

#[test]
fn a_tip_nearer_than_the_least_distance_ends_the_scan() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.begin();
    rig.until_scanning();
    rig.steps(100);
    // As near as 500 µm is too near from now on.
    rig.bench.configure(r#"{"rows": 8, "range_db": [40, 100], "min_distance_m": 0.00055}"#).unwrap();
    rig.steps(2);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told, ["the tip is nearer to the surface than min_distance_m"]);
}

#[test]
fn after_the_line_the_tip_goes_away_from_the_eye_before_it_rests() {
    let mut rig = Rig::run(Setup::new("static_no_membrane", 1));
    assert_eq!((rig.progress().phase, rig.held), (Phase::IDLE, 1));
    rig.steps(20);
    let away = rig.truth.last().unwrap().distance_m - OFFSET_M;
    // The exact place at which it rests does not matter.
    assert!((away - 400e-6).abs() < 20e-6, "{away:.2e} m");
    // Without a surface it rests where it is, and the image counts.
    let mut rig = Rig::new(Setup::new("default", 2));
    rig.begin();
    rig.until_scanning();
    while rig.progress().phase == Phase::SCAN {
        rig.step();
    }
    assert_eq!(rig.progress().phase, Phase::RETRACT);
    rig.dark_until_ns = u64::MAX;
    rig.steps(100);
    assert_eq!((rig.progress().phase, rig.held), (Phase::IDLE, 1));
    assert!(rig.bench.events::<Text<128>>("scan/bscan_aborted").is_empty());
    assert_eq!(rig.bench_done(), 1);
}

#[test]
fn abort_ends_a_scan_at_any_moment_with_one_event_and_a_hold() {
    for after in [0, 1, 50, 300, 1500] {
        let mut rig = Rig::new(Setup::new("default", 1));
        rig.begin();
        rig.steps(after);
        rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
        rig.step();
        assert_eq!((rig.progress().phase, rig.held), (Phase::IDLE, 1));
        rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
        rig.step();
        rig.watch(400);
        assert_eq!(rig.bench.events::<Text<128>>("scan/bscan_aborted"), ["aborted by command"]);
        assert!(rig.stands());
    }
}

#[test]
fn a_robot_that_is_paused_or_disabled_ends_the_scan_and_moves_nothing_when_it_is_brought_back() {
    for (away, back) in [("pause", "resume"), ("disable", "enable")] {
        let mut rig = Rig::new(Setup::new("default", 1));
        rig.begin();
        rig.until_scanning();
        rig.steps(100);
        let says = |rig: &mut Rig, word| {
            rig.robot.command::<Text<32>, ()>("arm/state_command", Text::new(word)).unwrap();
        };
        says(&mut rig, away);
        // The robot refuses commands that were on their way when it was paused.
        rig.steps(2);
        let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
        assert_eq!(told, ["the robot is no longer enabled and homed"], "{away}");
        assert!(rig.progress().phase == Phase::IDLE && rig.progress().stranded.get(), "{away}");
        rig.refused.clear();
        rig.steps(100);
        says(&mut rig, back);
        let state: OperatingState = rig.robot.read("arm/operating_state", ()).unwrap();
        assert_eq!((state.state, state.is_homed.get()), (OperatingMode::ENABLED, true), "{back}");
        assert!(rig.stands(), "{back}: nothing moves by itself");
        assert!(rig.refused.is_empty(), "nothing is sent any more: {:?}", rig.refused);
        assert_eq!(rig.bench.events::<Text<128>>("scan/bscan_aborted").len(), 0);
    }
}

#[test]
fn a_robot_that_fails_ends_the_scan() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.begin();
    rig.until_scanning();
    rig.pretends = Some(OperatingState { state: OperatingMode::FAULT, ..ready() });
    rig.steps(2);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told, ["the robot is no longer enabled and homed"]);
    assert_eq!(rig.progress().phase, Phase::IDLE);
}

/// A scan that is aborted while the robot does not take these commands.
fn abort_against(refuses: &'static [&'static str], outcome: Outcome) -> (Rig, String) {
    let mut rig = Rig::new(Setup { offset_m: 200e-6, ..Setup::new("static_no_membrane", 1) });
    rig.begin();
    rig.until_scanning();
    rig.steps(100);
    rig.refuse(refuses, outcome);
    rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told.len(), 1);
    (rig, told[0].to_string())
}

#[test]
fn what_the_robot_does_not_take_at_the_end_is_told_counted_and_sent_again_until_it_is_taken() {
    let cases: [(&'static [&'static str], &str); 3] = [
        (&["robot/hold"], ""),
        (&["robot/move_cr"], "; move_cr was not taken"),
        (&["robot/hold", "robot/move_cr"], "; hold and move_cr were not taken"),
    ];
    for (refuses, said) in cases {
        let (mut rig, told) = abort_against(refuses, Outcome::QueueFull);
        assert_eq!(told, format!("aborted by command{said}"));
        rig.take_again();
        rig.steps(3);
        assert_eq!(rig.progress().refused, refuses.len() as u64, "{refuses:?}");
        assert!(rig.progress().stranded.get(), "{refuses:?}: on its way");
        let rests = *rig.watch(400).last().unwrap();
        rig.step();
        assert!(!rig.progress().stranded.get(), "{refuses:?}: it is away");
        assert!((rests - 600e-6).abs() < 30e-6, "{refuses:?}: rests at {rests:.2e} m");
    }
}

#[test]
fn a_robot_that_takes_no_way_back_is_asked_for_twenty_milliseconds_and_the_tip_is_told_to_be_stranded() {
    let (mut rig, told) = abort_against(&["robot/move_cr"], Outcome::Failed);
    assert_eq!(told, "aborted by command; move_cr was not taken");
    rig.steps(40);
    let progress = rig.progress();
    assert!(progress.stranded.get() && (20..=22).contains(&progress.refused), "{progress:?}");
    // Long after it is well again, nothing comes by surprise.
    rig.take_again();
    let rests = rig.truth.last().unwrap().distance_m;
    rig.steps(200);
    let moved = rig.truth.last().unwrap().distance_m - rests;
    assert!(moved.abs() < 3e-6, "{moved:.2e} m");
    assert!(rig.stands());
    rig.begin();
    rig.step();
    assert!(!rig.progress().stranded.get() && rig.progress().refused == 0, "a new scan");
}

#[test]
fn a_robot_that_queues_its_way_back_and_does_not_go_it_leaves_the_tip_stranded() {
    let (mut rig, told) = abort_against(&["robot/move_cr"], Outcome::Queued);
    assert_eq!(told, "aborted by command");
    rig.steps(400);
    assert!(rig.progress().stranded.get() && rig.progress().refused == 0, "{:?}", rig.progress());
    // The tip counts as away, whichever client brings it there.
    let up = Pose { position: [0.0, 0.0, -0.4e-3], ..Pose::default() };
    rig.robot.command::<Pose, ()>("arm/move_cr", up).unwrap();
    rig.steps(400);
    assert!(!rig.progress().stranded.get());
}

#[test]
fn a_guard_that_the_robot_does_not_take_is_counted_and_one_that_is_not_connected_is_not() {
    for connected in [true, false] {
        let mut rig = Rig::new(Setup::new("static_no_membrane", 1));
        rig.bench.fail("fixture/set_guard", Outcome::Failed);
        rig.bench.connect_function("fixture/set_guard", connected);
        rig.begin();
        rig.steps(10);
        let refused = rig.progress().refused;
        assert!(if connected { (9..=10).contains(&refused) } else { refused == 0 }, "{connected}: {refused}");
    }
}

#[test]
fn a_tip_that_something_holds_back_ends_the_scan() {
    let mut rig = Rig::new(Setup::new("static", 1));
    rig.begin();
    rig.until_scanning();
    rig.stuck = true;
    let from = rig.truth.len();
    rig.steps(600);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told, ["the robot is more than 0.2 mm away from where it should be on the line"]);
    // 0.2 mm at 0.5 mm/s, and the robot's own lag.
    let scanned = rig.truth[from..].iter().filter(|t| t.scanning).count();
    assert!((1500..1800).contains(&scanned), "after {scanned} lines");
}

#[test]
fn a_robot_that_falls_silent_ends_the_scan() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.begin();
    rig.until_scanning();
    rig.bench.connect_function("robot/measured_cp", false);
    rig.steps(25);
    assert_eq!(
        rig.bench.events::<Text<128>>("scan/bscan_aborted"),
        ["the robot has not told for 20 ms where it is"]
    );
}

/// A scan that has set off, and how it ends after `upset` within so many periods: what is told, and the rig.
fn upset(setup: Setup, periods: usize, upset: impl FnOnce(&mut Rig)) -> (String, Rig) {
    let mut rig = Rig::new(setup);
    rig.begin();
    rig.until_scanning();
    rig.steps(100);
    upset(&mut rig);
    rig.steps(periods);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!((told.len(), rig.progress().phase), (1, Phase::IDLE), "{:?}", rig.progress());
    (told[0].to_string(), rig)
}

#[test]
fn a_measured_delay_that_grows_above_twelve_milliseconds_ends_the_scan() {
    let (told, rig) = upset(Setup::new("static", 1), 200, |rig| rig.setup.latency_ns = 13_500_000);
    assert_eq!(told, "the measured delay is above 12 ms");
    assert!(rig.errors().2 > NEAREST_M);
}

#[test]
fn the_age_of_the_robots_pose_counts_in_the_delay_that_ends_a_scan() {
    let setup = Setup { latency_ns: 8_700_000, ..Setup::new("static", 1) };
    let (told, rig) = upset(setup, 200, |rig| rig.pose_late = 4);
    assert_eq!(told, "the measured delay is above 12 ms");
    let delay_s = rig.progress().delay;
    assert!(delay_s < 0.0115, "without the pose it is {delay_s} s");
}

#[test]
fn a_turn_of_the_robot_that_is_none_ends_the_scan() {
    let (told, _) = upset(Setup::new("static", 1), 2, |rig| rig.turnless = true);
    assert_eq!(told, "the robot's orientation is no unit quaternion");
}

#[test]
fn a_begin_that_is_not_reached_in_time_ends_the_scan() {
    let mut rig = Rig::new(Setup::new("static", 1));
    rig.bench
        .configure(r#"{"rows": 8, "range_db": [40, 100], "approach_timeout_s": 0.1}"#)
        .expect("a live setting");
    rig.begin();
    rig.steps(100);
    assert_eq!(rig.progress().phase, Phase::APPROACH);
    rig.steps(5);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told, ["the begin of the line was not reached in time"]);
    assert_eq!(rig.progress().phase, Phase::IDLE);
}

#[test]
fn an_end_that_is_not_reached_in_time_ends_the_scan() {
    // The line is so slow and short that a tip which stands is never 0.2 mm behind: 1 s for it and 30 µm,
    // half as long again, and 2 s.
    let mut rig = Rig::new(Setup::new("static", 1));
    rig.steps(60);
    let slow = ScanRequest { speed: 5e-5, to: [-1.48e-3, 0.0, APEX_Z_M], ..Rig::request() };
    rig.bench.command::<ScanRequest, ()>("scan/start", slow).unwrap();
    rig.until_scanning();
    rig.stuck = true;
    rig.steps(3400);
    assert_eq!(rig.progress().phase, Phase::SCAN);
    rig.steps(110);
    let told = rig.bench.events::<Text<128>>("scan/bscan_aborted");
    assert_eq!(told, ["the end of the line was not reached in time"]);
}
