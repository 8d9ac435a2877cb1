//! Forbidden regions, guard and retreat on the component: the tip stays out under all commands.
#![allow(clippy::unwrap_used)]

use trocar_phantom::Hand;
use trocar_sdk::data::{CartesianState, FixtureKind, OperatingMode, Pose, Retreat, Twist, VirtualFixture};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use super::EyeRobot;
use super::bench::{DT, force, joints, operating, push, say, true_tip};
use crate::payloads::VirtualFixtures;

#[test]
fn no_hand_and_no_controller_drives_the_tip_10_micrometres_into_a_forbidden_region() {
    for seed in 0..20 {
        let mut bench = Bench::<EyeRobot>::new(format!(r#"{{"seed": {seed}, "backlash_m": 3e-6}}"#));
        let hand = Hand::new(seed);
        let mut frame: Pose = bench.read("arm/measured_cp", ()).unwrap();
        frame.position[2] += 0.3e-3;
        // Half a turn about x: the allowed side is where z points, away from the retina.
        frame.orientation = [1.0, 0.0, 0.0, 0.0];
        let plane = VirtualFixture { kind: FixtureKind::PLANE, frame, ..Default::default() };
        let list = VirtualFixtures { fixtures: List::of(&[plane]), ..Default::default() };
        bench.command::<_, ()>("virtual_fixture/set", list).unwrap();
        bench.command::<(), ()>("free", ()).unwrap();
        let border = true_tip(&bench)[2] + 0.3e-3;
        let down = Twist { linear: [0.0, 0.0, 0.008], ..Twist::default() };
        let mut deepest = f64::NEG_INFINITY;
        for n in 0..800 {
            let t = DT * f64::from(n);
            if n > 400 {
                bench.command::<_, ()>("axis/servo_cv", down).unwrap();
            }
            let by_hand = hand.force_n(t);
            push(&mut bench, [by_hand.x, by_hand.y, by_hand.z + 4.0], 1);
            deepest = deepest.max(true_tip(&bench)[2] - border);
        }
        assert!(deepest < 10e-6, "seed {seed}: {deepest:e} m beyond");
        assert!(deepest > -20e-6, "seed {seed}: it never came near, {deepest:e} m");
    }
}

#[test]
fn at_the_highest_speed_that_is_taken_the_stiffest_plane_holds_in_every_motion() {
    let config = |seed: u64| {
        format!(
            r#"{{"seed": {seed}, "backlash_m": 3e-6, "speed_m_s": 0.0166, "speed_rad_s": 0.2, "tool_length_m": {}}}"#,
            if seed.is_multiple_of(2) { 0.12 } else { 0.3 }
        )
    };
    let mut rng = fastrand::Rng::with_seed(11);
    let (mut fastest, mut nearest) = (0.0_f64, f64::NEG_INFINITY);
    for seed in 0..24 {
        let mut bench = Bench::<EyeRobot>::new(config(seed));
        let from: Pose = bench.read("arm/measured_cp", ()).unwrap();
        let start = true_tip(&bench);
        // Planes of all slants, 3 mm before the tip.
        let side = |rng: &mut fastrand::Rng| 1.4 * (rng.f64() - 0.5);
        let up = nalgebra::Vector3::new(side(&mut rng), side(&mut rng), -1.0).normalize();
        let turn = nalgebra::UnitQuaternion::rotation_between(&nalgebra::Vector3::z(), &up).unwrap();
        let mut frame = Pose { orientation: turn.coords.into(), ..from };
        frame.position = [0, 1, 2].map(|i| from.position[i] - 3e-3 * up[i]);
        let plane = VirtualFixture { kind: FixtureKind::PLANE, frame, stiffness: 30.0, ..Default::default() };
        let list = VirtualFixtures { fixtures: List::of(&[plane]), ..Default::default() };
        bench.command::<_, ()>("virtual_fixture/set", list).unwrap();
        let deep = |tip: [f64; 3]| -3e-3 - (0..3).map(|i| (tip[i] - start[i]) * up[i]).sum::<f64>();
        let goal = joints([0.02 * side(&mut rng), 0.02 * side(&mut rng), 0.03, 0.2, 0.3]);
        if seed % 4 == 0 {
            bench.command::<_, ()>("arm/servo_jp", goal).unwrap();
        } else if seed % 4 == 1 {
            bench.command::<_, ()>("arm/move_jp", goal).unwrap();
        }
        let (turning, down) = (side(&mut rng), [-up.x, -up.y, -up.z].map(|d| 0.0166 * d));
        for n in 0..700 {
            let twist = Twist { linear: down, angular: [0.2 * turning, 0.0, 0.0], ..Twist::default() };
            match seed % 4 {
                2 => bench.command::<_, ()>("arm/servo_cv", twist).unwrap(),
                3 if n == 0 => bench.command::<(), ()>("free", ()).unwrap(),
                _ => {}
            }
            if seed % 4 == 3 {
                bench.command::<_, ()>("axis/servo_cv", twist).unwrap();
                push(&mut bench, down.map(|d| 900.0 * d), 1);
            } else {
                bench.step(1);
            }
            let tip: CartesianState = bench.read("truth/measured_cs", ()).unwrap();
            fastest = (0..3).map(|i| -tip.twist.linear[i] * up[i]).sum::<f64>().max(fastest);
            nearest = deep(tip.pose.position).max(nearest);
            assert!(
                deep(tip.pose.position) < 10e-6,
                "seed {seed} period {n}: {:e} m",
                deep(tip.pose.position)
            );
        }
        assert_eq!(operating(&bench).state, OperatingMode::ENABLED, "seed {seed}");
    }
    assert!(fastest > 0.016, "it came with {fastest} m/s at most");
    assert!(nearest > -5e-6, "it never came near, {nearest:e} m");
}

#[test]
fn speeds_that_the_drives_cannot_brake_before_a_border_are_refused_with_what_would_be_taken() {
    for (config, words) in [
        (
            r#"{"speed_m_s": 0.1}"#,
            ["speed_m_s: 0.1 m/s is more", "3.000 m/s^2", "set speed_m_s to 0.0166 at"],
        ),
        (
            r#"{"speed_rad_s": 0.25}"#,
            ["speed_rad_s: 0.25 rad/s", "7.500 rad/s^2", "set speed_rad_s to 0.200 at"],
        ),
        (
            r#"{"acceleration_m_s2": 0.1}"#,
            ["speed_m_s: 0.01 m/s", "acceleration_m_s2 is 0.1 m/s^2", "set speed_m_s to 0.00333 at"],
        ),
    ] {
        let mut bench = Bench::<EyeRobot>::ready("{}");
        let refused = bench.configure(config).unwrap_err();
        assert!(words.iter().all(|word| refused.reason.contains(word)), "{refused}");
    }
    Bench::<EyeRobot>::new(r#"{"speed_m_s": 0.0166, "speed_rad_s": 0.2}"#);
    Bench::<EyeRobot>::new(r#"{"acceleration_m_s2": 0.1, "speed_m_s": 0.00333}"#);
}

#[test]
fn with_a_plane_above_the_retina_the_tip_stays_150_micrometres_away_from_it() {
    let world = trocar_phantom::World::named("static", 1).unwrap();
    let mut bench = Bench::<EyeRobot>::new("{}");
    // The highest place of the retina around the axis; the plane lies 170 µm above it.
    let highest = (0..400)
        .map(|n| world.surface_z(1e-4 * f64::from(n % 20) - 1e-3, 1e-4 * f64::from(n / 20) - 1e-3, 0.0))
        .fold(f64::INFINITY, f64::min);
    let tip = true_tip(&bench);
    let mut frame: Pose = bench.read("arm/measured_cp", ()).unwrap();
    frame.position[2] += highest - 170e-6 - tip[2];
    frame.orientation = [1.0, 0.0, 0.0, 0.0];
    let plane = VirtualFixture { kind: FixtureKind::PLANE, frame, ..Default::default() };
    let list = VirtualFixtures { fixtures: List::of(&[plane]), ..Default::default() };
    bench.command::<_, ()>("virtual_fixture/set", list).unwrap();
    for n in 0..1_000 {
        let aside = 0.002 * (0.01 * f64::from(n)).sin();
        let scan = Twist { linear: [aside, 0.0, 0.009], ..Twist::default() };
        bench.command::<_, ()>("arm/servo_cv", scan).unwrap();
        bench.step(1);
        let [x, y, z] = true_tip(&bench);
        let left = world.surface_z(x, y, 0.0) - z;
        assert!(left > 150e-6, "{left:e} m are left after {n} periods");
    }
}

#[test]
fn a_guard_follows_its_controller_beside_the_list_and_only_its_controller_takes_it_away() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let tip: Pose = bench.read("arm/measured_cp", ()).unwrap();
    let line = VirtualFixture { kind: FixtureKind::LINE, frame: tip, ..Default::default() };
    let list = VirtualFixtures { fixtures: List::of(&[line]), ..Default::default() };
    bench.command::<_, ()>("virtual_fixture/set", list).unwrap();
    let guard = |below_m: f64| {
        let mut frame = tip;
        frame.position[2] += below_m;
        frame.orientation = [1.0, 0.0, 0.0, 0.0];
        VirtualFixture { kind: FixtureKind::PLANE, frame, stiffness: 30.0, ..Default::default() }
    };
    let down = Twist { linear: [0.0, 0.0, 0.005], ..Twist::default() };
    let deep = |bench: &mut Bench<EyeRobot>, steps: u32| {
        for _ in 0..steps {
            bench.command::<_, ()>("arm/servo_cv", down).unwrap();
            bench.step(1);
        }
        true_tip(bench)[2] + 1e-3
    };
    bench.command::<_, ()>("virtual_fixture/set_guard", guard(0.2e-3)).unwrap();
    let first = deep(&mut bench, 800);
    assert!((0.19e-3..0.203e-3).contains(&first), "{first}");
    // An empty list leaves the guard, and the guard goes where it is sent.
    bench.command::<_, ()>("virtual_fixture/set", VirtualFixtures::default()).unwrap();
    bench.command::<_, ()>("virtual_fixture/set_guard", guard(0.3e-3)).unwrap();
    let second = deep(&mut bench, 800);
    assert!((0.29e-3..0.303e-3).contains(&second), "{second}");
    let refused = bench.command::<_, ()>("virtual_fixture/set_guard", guard(0.1e-3)).unwrap_err();
    assert!(refused.reason.contains("the tip is beyond the plane"), "{refused}");
    assert_eq!(bench.read::<(), VirtualFixture>("virtual_fixture/guard", ()).unwrap().stiffness, 30.0);
    bench.command::<_, ()>("virtual_fixture/set_guard", VirtualFixture::default()).unwrap();
    assert_eq!(bench.read::<(), VirtualFixture>("virtual_fixture/guard", ()).unwrap(), Default::default());
    assert!(deep(&mut bench, 200) > 0.8e-3);
}

#[test]
fn a_retreat_is_taken_and_told_when_nobody_sends_any_more_and_allocates_nothing() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let retreat = Retreat { distance: 0.4e-3, speed: 2e-3, delay: 0.02 };
    bench.command::<_, ()>("axis/set_retreat", retreat).unwrap();
    assert_eq!(bench.read::<(), Retreat>("axis/retreat", ()).unwrap(), retreat);
    let down = Twist { linear: [0.0, 0.0, 0.001], ..Twist::default() };
    bench.command::<_, ()>("axis/servo_cv", down).unwrap();
    bench.step(25);
    assert_eq!(bench.events::<Retreat>("axis/retreats"), []);
    let from = true_tip(&bench)[2];
    bench.assert_no_alloc(|bench| bench.step(400));
    let back = from - true_tip(&bench)[2];
    assert!((back - 0.4e-3).abs() < 2e-6, "{back:e} m");
    assert_eq!(bench.events::<Retreat>("axis/retreats"), [retreat]);
    assert_eq!(bench.read::<(), Retreat>("axis/retreat", ()).unwrap(), Retreat::default());
    let refused = bench.command::<_, ()>("axis/set_retreat", Retreat { distance: 0.1, ..retreat });
    assert_eq!(refused.unwrap_err().reason, "distance of the retreat: 0.1 m is outside 0 … 0.005 m");
}

#[test]
fn gains_fixtures_and_base_frame_outlive_configure_and_a_swap() {
    let mut old = Bench::<EyeRobot>::new("{}");
    let gain = [2e-3, 2e-3, 0.0, 0.0, 0.0, 0.0];
    old.command::<_, ()>("compliance/set_gain", gain).unwrap();
    let base = Pose { position: [0.1, 0.0, 0.0], ..Pose::default() };
    old.command::<_, ()>("set_base_frame", base).unwrap();
    let tip: Pose = old.read("arm/measured_cp", ()).unwrap();
    let fixture = VirtualFixture { kind: FixtureKind::LINE, frame: tip, ..Default::default() };
    let list = VirtualFixtures { fixtures: List::of(&[fixture]), ..Default::default() };
    old.command::<_, ()>("virtual_fixture/set", list).unwrap();
    old.step(3);
    let (row, extra) = old.snapshot();
    let mut new = Bench::<EyeRobot>::ready("{}");
    new.restore(&row, &extra).unwrap();
    new.resume().unwrap();
    assert_eq!(new.read::<(), [f64; 6]>("compliance/gain", ()).unwrap(), gain);
    assert_eq!(new.read::<(), Pose>("arm/base_frame", ()).unwrap().position, [0.1, 0.0, 0.0]);
    let kept: VirtualFixtures = new.read("virtual_fixture/fixtures", ()).unwrap();
    assert_eq!((kept.fixtures.len(), kept.fixtures[0].kind), (1, FixtureKind::LINE));
    say(&mut new, "enable");
    say(&mut new, "home");
    new.step(2);
    for _ in 0..200 {
        new.command::<_, ()>("arm/servo_cv", Twist { linear: [0.005, 0.0, 0.0], ..Twist::default() })
            .unwrap();
        new.step(1);
    }
    let at: Pose = new.read("arm/measured_cp", ()).unwrap();
    assert!((at.position[0] - tip.position[0]).abs() < 3e-6, "the line is in force: {at:?}");
}

#[test]
fn bad_fixtures_twists_and_frames_are_refused_with_the_reason() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let odd = VirtualFixture { kind: FixtureKind(7), ..Default::default() };
    let list = VirtualFixtures { fixtures: List::of(&[odd]), ..Default::default() };
    let refused = bench.command::<_, ()>("virtual_fixture/set", list).unwrap_err();
    assert_eq!(refused.reason, "fixture 0: kind 7 is none; there are PLANE = 1, LINE = 2, RCM = 3");
    let twist = Twist { linear: [0.0, f64::NAN, 0.0], ..Twist::default() };
    for member in ["arm/servo_cv", "axis/servo_cv"] {
        let refused = bench.command::<_, ()>(member, twist).unwrap_err();
        assert_eq!(refused.reason, "linear[1] is NaN: give a finite number");
    }
    let fast = Twist { linear: [0.0, 0.0, 0.011], ..Twist::default() };
    let refused = bench.command::<_, ()>("axis/servo_cv", fast).unwrap_err();
    assert!(refused.reason.contains("0.011 m/s") && refused.reason.contains("0.01 m/s"), "{refused}");
    let refused = bench.command::<_, ()>("set_base_frame", Pose { orientation: [0.0; 4], ..Pose::default() });
    assert!(refused.unwrap_err().reason.contains("unit quaternion"));
    let refused =
        bench.command::<_, ()>("compliance/servo_cf", force([f64::INFINITY, 0.0, 0.0])).unwrap_err();
    assert_eq!(refused.reason, "force[0] is inf: give a finite number");
    let refused = bench.command::<_, ()>("compliance/set_gain", [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]).unwrap_err();
    assert!(refused.reason.contains("gain[2]: -1"), "{refused}");
    assert!(!bench.command::<_, ()>("move_jr", joints([f64::NAN; 5])).unwrap_err().panicked());
}

#[test]
fn hands_on_steps_with_axis_and_fixtures_allocate_nothing() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"hand": "simulated"}"#);
    let tip: Pose = bench.read("arm/measured_cp", ()).unwrap();
    let kinds = [FixtureKind::PLANE, FixtureKind::LINE, FixtureKind::RCM];
    let all = kinds.map(|kind| VirtualFixture { kind, frame: tip, ..Default::default() });
    let list = VirtualFixtures { fixtures: List::of(&all), ..Default::default() };
    bench.assert_no_alloc(|bench| {
        bench.command::<(), ()>("free", ()).unwrap();
        bench.step(20);
        bench.command::<_, ()>("virtual_fixture/set", list).unwrap();
        bench.step(20);
        bench
            .command::<_, ()>("axis/servo_cv", Twist { linear: [0.0, 0.0, 0.001], ..Default::default() })
            .unwrap();
        bench.step(20);
        bench
            .command::<_, ()>("arm/servo_cv", Twist { linear: [0.001, 0.0, 0.0], ..Default::default() })
            .unwrap();
        bench.step(20);
        bench.command::<_, ()>("interpolate_jp", joints([0.001, 0.0, 0.0, 0.0, 0.0])).unwrap();
        bench.step(200);
        bench.command::<_, ()>("move_cr", Pose { position: [0.0, 0.0, -0.001], ..Pose::default() }).unwrap();
        bench.step(1_500);
    });
}
