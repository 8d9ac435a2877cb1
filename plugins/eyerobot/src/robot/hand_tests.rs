//! Gate R1 of the design, on the component: a hand leads the tip, and its tremor stays outside.
#![allow(clippy::unwrap_used)]

use trocar_phantom::Hand;
use trocar_phantom::hand::{STIFFNESS_N_M, TREMOR_RMS_M};
use trocar_sdk::data::{OperatingMode, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use super::EyeRobot;
use super::bench::{DT, force, operating, push, true_tip};

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
    // The dead band of 30 mN leaves 15 µm of the hand's stiffness, at a speed that falls to nothing.
    assert!(gone(3_499) > 0.47e-3, "{}", gone(3_499));
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
    assert_eq!(bench.read::<(), Wrench>("hand/measured_cf", ()).unwrap().stamp, Stamp::INVALID);
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
