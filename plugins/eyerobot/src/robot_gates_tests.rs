//! Gates D1 and R1 of the design, on the component: CRTK states and stamps, hands-on control, tremor, forbidden regions.
//!
//! Invariant: judged against the true tip, in virtual time, with fixed seeds. All of it is simulation.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_phantom::hand::{STIFFNESS_N_M, TREMOR_RMS_M};
use trocar_sdk::data::FixtureKind;
use trocar_sdk::testing::Bench;

const DT: f64 = 1e-3;

fn joints(position: [f64; 5]) -> JointState {
    JointState { position: List::of(&position), ..Default::default() }
}

fn force(force: [f64; 3]) -> Wrench {
    Wrench { force, ..Wrench::default() }
}

/// Steps with this force on the handle, told anew in each.
fn push(bench: &mut Bench<EyeRobot>, newton: [f64; 3], steps: u32) {
    for _ in 0..steps {
        bench.push("handle", Wrench { stamp: bench.now(), ..force(newton) });
        bench.step(1);
    }
}

fn say(bench: &mut Bench<EyeRobot>, word: &str) -> bool {
    bench.command::<Text<32>, ()>("state_command", word.into()).is_ok()
}

fn operating(bench: &Bench<EyeRobot>) -> OperatingState {
    bench.read("arm/operating_state", ()).unwrap()
}

fn true_tip(bench: &Bench<EyeRobot>) -> [f64; 3] {
    bench.read::<(), Pose>("truth/measured_cp", ()).unwrap().position
}

/// An arm whose setpoint runs away from its drive: both accelerate as fast as the drive can, and the drive's lag leaves
/// 4 mm/s between them all the way to 0.1 m/s.
fn faulted() -> Bench<EyeRobot> {
    let mut bench = Bench::<EyeRobot>::new(r#"{"speed_m_s": 0.1}"#);
    bench.command::<_, ()>("servo_jp", joints([0.04, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(250);
    assert_eq!(operating(&bench).state, OperatingMode::FAULT);
    bench
}

#[test]
fn all_sixteen_transitions_of_the_crtk_table_are_those_of_the_document() {
    const DISABLED: OperatingMode = OperatingMode::DISABLED;
    const ENABLED: OperatingMode = OperatingMode::ENABLED;
    const PAUSED: OperatingMode = OperatingMode::PAUSED;
    const FAULT: OperatingMode = OperatingMode::FAULT;
    let words = ["enable", "disable", "pause", "resume"];
    // None: invalid, the state stays.
    let table = [
        (DISABLED, [Some(ENABLED), Some(DISABLED), None, None]),
        (ENABLED, [Some(ENABLED), Some(DISABLED), Some(PAUSED), None]),
        (PAUSED, [None, Some(DISABLED), Some(PAUSED), Some(ENABLED)]),
        (FAULT, [Some(ENABLED), Some(DISABLED), None, None]),
    ];
    for (from, row) in table {
        for (word, to) in words.into_iter().zip(row) {
            let mut bench =
                if from == FAULT { faulted() } else { Bench::<EyeRobot>::new(r#"{"auto_enable": false}"#) };
            if [ENABLED, PAUSED].contains(&from) {
                assert!(say(&mut bench, "enable"));
            }
            if from == PAUSED {
                assert!(say(&mut bench, "pause"));
            }
            assert_eq!(operating(&bench).state, from);
            bench.events::<OperatingState>("arm/operating_state");
            let taken = say(&mut bench, word);
            bench.step(3);
            assert_eq!(
                (taken, operating(&bench).state),
                (to.is_some(), to.unwrap_or(from)),
                "{from:?} {word}"
            );
            let told = bench.events::<OperatingState>("arm/operating_state");
            let changes = usize::from(to.is_some_and(|to| to != from));
            assert_eq!(told.len(), changes, "{from:?} {word}: {told:?}");
        }
    }
}

#[test]
fn cartesian_values_carry_the_stamp_of_the_joints_and_what_is_not_known_stamp_0() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(5);
    let stamp = bench.read::<(), JointState>("arm/measured_js", ()).unwrap().stamp;
    assert!(stamp.is_valid() && stamp == bench.now());
    let pose = |bench: &Bench<EyeRobot>, of: &str| bench.read::<(), Pose>(of, ()).unwrap().stamp;
    let of_tip = ["arm/measured_cp", "local/measured_cp", "arm/setpoint_cp", "arm/goal_cp"];
    assert!(of_tip.iter().all(|of| pose(&bench, of) == stamp));
    assert_eq!(bench.read::<(), Twist>("arm/measured_cv", ()).unwrap().stamp, stamp);
    let all: CartesianState = bench.read("arm/measured_cs", ()).unwrap();
    assert_eq!([all.stamp, all.pose.stamp, all.twist.stamp], [stamp; 3]);
    assert_eq!(all.wrench.stamp, Stamp::INVALID, "nobody holds the handle");
    bench.command::<_, ()>("arm/servo_cv", Twist { linear: [0.001, 0.0, 0.0], ..Twist::default() }).unwrap();
    push(&mut bench, [0.0, 0.0, 0.5], 1);
    for of in ["arm/setpoint_cp", "arm/goal_cp"] {
        assert_eq!(pose(&bench, of), Stamp::INVALID, "{of} of a motion by velocity");
    }
    assert_eq!(bench.read::<(), JointState>("arm/goal_js", ()).unwrap().stamp, Stamp::INVALID);
    assert_eq!(bench.read::<(), Twist>("arm/setpoint_cv", ()).unwrap().stamp, bench.now());
    let felt: Wrench = bench.read("arm/measured_cf", ()).unwrap();
    assert_eq!(felt.stamp, bench.now());
    assert!((felt.force[2] - 0.5).abs() < 1e-6, "{felt:?}");
    let spatial = |bench: &Bench<EyeRobot>| {
        let jacobian: Jacobian = bench.read("spatial/jacobian", ()).unwrap();
        let js: JointState = bench.read("arm/measured_js", ()).unwrap();
        [0, 1, 2].map(|row| (0..5).map(|i| jacobian.values[5 * row + i] * js.velocity[i]).sum::<f64>())
    };
    let v: Twist = bench.read("spatial/measured_cv", ()).unwrap();
    assert!((0..3).all(|i| (spatial(&bench)[i] - v.linear[i]).abs() < 1e-12) && v.stamp == bench.now());
    assert_eq!(bench.read::<(), Wrench>("spatial/measured_cf", ()).unwrap(), felt);
    let streamed = bench.outputs::<ArmState>("state");
    assert_eq!(streamed.last().map(|state| state.measured_cf), Some(felt));
    assert_eq!(streamed[0].measured_cf.stamp, Stamp::INVALID, "before there was a hand");
    bench.make_stale("handle");
    bench.step(1);
    assert_eq!(bench.read::<(), Wrench>("body/measured_cf", ()).unwrap(), Wrench::default());
}

#[test]
fn a_servo_motion_pre_empts_a_move_and_a_move_is_busy_until_it_says_that_it_arrived() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let busy = |bench: &Bench<EyeRobot>| bench.read::<(), Flag>("arm/is_busy", ()).unwrap().get();
    bench.command::<_, ()>("move_jp", joints([0.01, 0.0, 0.0, 0.0, 0.0])).unwrap();
    assert!(busy(&bench));
    bench.step(100);
    bench.command::<_, ()>("servo_jp", joints([0.0; 5])).unwrap();
    bench.step(1);
    assert!(!busy(&bench));
    assert_eq!(bench.events::<Flag>("arm/goal_reached"), [Flag::FALSE]);
    let mut goal: Pose = bench.read("arm/measured_cp", ()).unwrap();
    goal.position[2] -= 0.002;
    bench.command::<_, ()>("move_cp", goal).unwrap();
    while busy(&bench) {
        assert!(bench.events::<Flag>("arm/goal_reached").is_empty());
        bench.step(1);
    }
    assert_eq!(bench.events::<Flag>("arm/goal_reached"), [Flag::TRUE]);
    bench.step(300);
    let at: Pose = bench.read("arm/measured_cp", ()).unwrap();
    assert!((at.position[2] - goal.position[2]).abs() < 5e-6, "{at:?}");
}

#[test]
fn one_newton_is_one_millimetre_per_second_within_2_percent_in_every_direction() {
    for direction in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8]] {
        let mut bench = Bench::<EyeRobot>::new("{}");
        bench.command::<(), ()>("free", ()).unwrap();
        push(&mut bench, direction, 500);
        let from = true_tip(&bench);
        push(&mut bench, direction, 2_000);
        let to = true_tip(&bench);
        let v: f64 = (0..3).map(|i| (to[i] - from[i]) / 2.0 * direction[i]).sum();
        assert!((v / 1e-3 - 1.0).abs() < 0.02, "{direction:?}: {v} m/s");
        let across: f64 = (0..3).map(|i| ((to[i] - from[i]) / 2.0 - v * direction[i]).powi(2)).sum();
        assert!(across.sqrt() < 0.01 * v, "{direction:?}: {across:e}");
    }
}

#[test]
fn the_noise_of_the_handle_moves_nothing() {
    for seed in 0..20 {
        let mut bench = Bench::<EyeRobot>::new(format!(r#"{{"seed": {seed}}}"#));
        let hand = Hand::new(seed);
        bench.command::<(), ()>("free", ()).unwrap();
        let from = true_tip(&bench);
        for n in 0..1_000 {
            push(&mut bench, hand.sensor_error_n(DT * f64::from(n)).into(), 1);
        }
        let to = true_tip(&bench);
        let way = (0..3).map(|i| (to[i] - from[i]).abs()).fold(0.0, f64::max);
        // A step of the encoders is 0.5 µm.
        assert!(way < 1e-6, "seed {seed}: the tip crept {way:e} m");
    }
}

/// Tip of an arm that follows a hand with these forces, after each period, m in the world.
fn led(seed: u64, periods: u32, mut hand: impl FnMut(f64, [f64; 3]) -> [f64; 3]) -> Vec<[f64; 3]> {
    let mut bench = Bench::<EyeRobot>::new(format!(r#"{{"seed": {seed}, "backlash_m": 1e-6}}"#));
    bench.command::<(), ()>("free", ()).unwrap();
    let way = |n: u32, bench: &mut Bench<EyeRobot>| {
        let tip = true_tip(bench);
        push(bench, hand(DT * f64::from(n), tip), 1);
        true_tip(bench)
    };
    let mut way = way;
    (0..periods).map(|n| way(n, &mut bench)).collect()
}

#[test]
fn a_tremor_of_10_hertz_loses_20_decibel_from_the_hand_to_the_tip() {
    let swing_m = TREMOR_RMS_M * std::f64::consts::SQRT_2;
    let turn = |t: f64| std::f64::consts::TAU * 10.0 * t;
    // On top of a push, where no dead band helps.
    let way = led(1, 3_000, |t, _| [0.5 + STIFFNESS_N_M * swing_m * turn(t).sin(), 0.0, 0.0]);
    // The part at 10 Hz of the last two seconds, 20 whole periods, without their slope.
    let last = &way[1_000..];
    let slope = (last[1_999][0] - last[0][0]) / 1_999.0;
    let (mut cos, mut sin) = (0.0, 0.0);
    for (n, tip) in last.iter().enumerate() {
        let x = tip[0] - slope * n as f64;
        cos += x * turn(DT * n as f64).cos() / 1_000.0;
        sin += x * turn(DT * n as f64).sin() / 1_000.0;
    }
    let db = 20.0 * (swing_m / cos.hypot(sin)).log10();
    assert!(db >= 20.0, "{db} dB");
}

#[test]
fn a_trembling_hand_on_the_handle_leaves_less_than_a_tenth_of_a_free_hands_tremor() {
    for seed in 0..20 {
        let hand = Hand::new(seed);
        let way = led(seed, 2_000, |t, _| (hand.tremor_m(t) * STIFFNESS_N_M + hand.sensor_error_n(t)).into());
        let last = &way[500..];
        let count = last.len() as f64;
        let square: f64 = (0..3)
            .map(|i| {
                let mean = last.iter().map(|tip| tip[i]).sum::<f64>() / count;
                last.iter().map(|tip| (tip[i] - mean).powi(2)).sum::<f64>() / count
            })
            .sum();
        let db = 20.0 * (TREMOR_RMS_M / square.sqrt()).log10();
        assert!(db >= 20.0, "seed {seed}: {db} dB, {} m RMS", square.sqrt());
    }
}

#[test]
fn a_hand_that_leads_the_handle_through_its_stiffness_is_followed_without_a_swing() {
    let mut from = None;
    let way = led(3, 3_500, |_, tip| {
        let from = *from.get_or_insert(tip);
        [STIFFNESS_N_M * (from[0] + 0.5e-3 - tip[0]), 0.0, 0.0]
    });
    let gone = |n: usize| way[n][0] - way[0][0];
    let furthest = (0..way.len()).map(gone).fold(0.0, f64::max);
    assert!(furthest < 0.51e-3, "it swings to {furthest}");
    // What the dead band of 30 mN leaves is 15 µm of the hand's stiffness, at a speed that falls to nothing.
    assert!(gone(3_499) > 0.47e-3, "{}", gone(3_499));
}

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
fn the_simulated_hand_moves_the_arm_only_when_it_is_configured_and_nothing_is_connected() {
    let way = |config: &str, nothing: bool| {
        let mut bench = Bench::<EyeRobot>::new(config);
        // To the beginning of a push.
        bench.advance(2_000_000_000 - bench.now().ns());
        bench.command::<(), ()>("free", ()).unwrap();
        let from = true_tip(&bench);
        if nothing {
            push(&mut bench, [0.0; 3], 1_000);
        } else {
            bench.step(1_000);
        }
        let to = true_tip(&bench);
        (0..3).map(|i| (to[i] - from[i]).powi(2)).sum::<f64>().sqrt()
    };
    let led = way(r#"{"hand": "simulated"}"#, false);
    assert!((0.2e-3..2e-3).contains(&led), "{led}");
    assert!(way("{}", false) < 1e-6);
    assert!(way(r#"{"hand": "simulated"}"#, true) < 1e-6);
}

#[test]
fn a_wrench_that_is_no_number_is_counted_and_not_followed() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<(), ()>("free", ()).unwrap();
    push(&mut bench, [0.0, f64::NAN, 0.0], 1);
    bench.step(49);
    assert_eq!(bench.state().handle_rejected, 1);
    assert_eq!(operating(&bench).state, OperatingMode::ENABLED);
    let from = true_tip(&bench);
    assert!(from.iter().all(|v| v.is_finite()));
    push(&mut bench, [0.0, 1.0, 0.0], 500);
    assert!(true_tip(&bench)[1] > from[1] + 0.3e-3, "the next ones are followed");
}

#[test]
fn a_wrench_without_a_stamp_or_one_that_is_not_renewed_is_none() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<(), ()>("free", ()).unwrap();
    let from = true_tip(&bench);
    for _ in 0..300 {
        bench.push("handle", force([0.0, 0.0, 2.0]));
        bench.step(1);
    }
    assert!((true_tip(&bench)[2] - from[2]).abs() < 1e-6, "stamp 0 (CRTK): not measured");
    assert_eq!(bench.state().handle_rejected, 0);
    push(&mut bench, [0.0, 0.0, 2.0], 500);
    let let_go = true_tip(&bench)[2];
    assert!(let_go > from[2] + 0.5e-3);
    // Its own age counts, whatever the connection allows: 50 ms, and what the filter still holds.
    bench.step(1_000);
    let way = true_tip(&bench)[2] - let_go;
    assert!(way < 0.35e-3, "{way} m after the last wrench");
    assert_eq!(bench.read::<(), Wrench>("body/measured_cf", ()).unwrap().stamp, Stamp::INVALID);
}

#[test]
fn a_force_above_the_limit_is_told_and_not_followed() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"force_limit_n": 3}"#);
    bench.command::<(), ()>("free", ()).unwrap();
    push(&mut bench, [0.0, 0.0, 3.5], 500);
    let stands = true_tip(&bench);
    assert_eq!(bench.events::<Flag>("arm/force_limit"), [Flag::TRUE]);
    push(&mut bench, [0.0, 0.0, 3.5], 300);
    let crept = (0..3).map(|i| (true_tip(&bench)[i] - stands[i]).abs()).fold(0.0, f64::max);
    assert!(crept < 0.5e-6, "{crept}");
    push(&mut bench, [0.0, 0.0, 1.0], 300);
    assert_eq!(bench.events::<Flag>("arm/force_limit"), [Flag::FALSE]);
    assert!(true_tip(&bench)[2] > stands[2] + 0.1e-3);
}

#[test]
fn the_tip_leaves_as_a_sample_in_the_world_at_each_step() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"standoff_m": 0.002}"#);
    bench.step(2);
    let samples = bench.samples::<CartesianState>("tip");
    let (tip, stamp) = samples[1];
    assert_eq!((samples.len(), stamp, tip.pose.stamp, tip.twist.stamp), (2, bench.now(), stamp, stamp));
    assert!((tip.pose.position[2] + 0.002).abs() < 1e-6, "{tip:?}");
    assert_eq!(tip, bench.read::<(), CartesianState>("truth/measured_cs", ()).unwrap());
    let twist = Twist { linear: [0.0, 0.0, 0.004], ..Twist::default() };
    for _ in 0..100 {
        bench.command::<_, ()>("arm/servo_cv", twist).unwrap();
        bench.step(1);
    }
    let way = bench.outputs::<CartesianState>("tip");
    let (last, before) = (way[99], way[98]);
    let gone = last.pose.position[2] - before.pose.position[2];
    assert!((last.twist.linear[2] - gone / DT).abs() < 1e-5, "the twist is the slope of the pose");
    assert!((last.twist.linear[2] - 0.004).abs() < 0.1e-3, "{last:?}");
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
