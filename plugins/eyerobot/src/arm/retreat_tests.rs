//! The way back of an arm whose client fell silent, and cases in which it is not taken.
//!
//! Invariant: time is counted in periods of `DT`, never read from a clock.

use super::*;
use crate::arm::commands::tests::{DT, ready, steps};
use crate::drive::SimulatedDrive;
use nalgebra::{Vector3, Vector6};

const BACK: Retreat = Retreat { distance_m: 0.4e-3, speed_m_s: 2e-3, delay_s: 0.02 };

fn tip(arm: &Arm<SimulatedDrive>) -> Vector3<f64> {
    arm.measured_cp().translation.vector
}

/// Moves the tip aside for a while, and falls silent.
fn move_and_fall_silent(arm: &mut Arm<SimulatedDrive>) {
    for _ in 0..50 {
        arm.servo_cv(&Vector6::new(1e-3, 0.0, 0.0, 0.0, 0.0, 0.0)).expect("ready");
        arm.step(DT);
    }
}

/// Stands in its next 300 periods.
fn stays(arm: &mut Arm<SimulatedDrive>) -> bool {
    let from = tip(arm);
    (0..300).all(|_| {
        arm.step(DT);
        (tip(arm) - from).norm() < 2e-6
    })
}

#[test]
fn who_falls_silent_leaves_a_tip_that_stands_waits_and_goes_straight_back_along_the_tool_once() {
    let mut arm = ready();
    arm.move_jp(&[0.0, 0.0, 0.0, 0.3, 0.2]).expect("in reach");
    steps(&mut arm, 5_000);
    arm.set_retreat(Some(BACK));
    move_and_fall_silent(&mut arm);
    steps(&mut arm, 20);
    let (from, axis) = (tip(&arm), tool_axis(&arm.setpoint().position));
    assert!(arm.measured().velocity.amax() < 10e-6, "within 20 ms it stands");
    steps(&mut arm, 8);
    assert!((tip(&arm) - from).norm() < 2e-6, "and waits for so long after its brake");
    let (mut last, mut fastest) = (tip(&arm), 0.0_f64);
    for _ in 0..400 {
        arm.step(DT);
        fastest = fastest.max((tip(&arm) - last).norm() / DT);
        last = tip(&arm);
        let aside = (last - from) - axis * axis.dot(&(last - from));
        assert!(aside.norm() < 3e-6, "{:e} m beside the tool's line", aside.norm());
    }
    let back = -axis.dot(&(last - from));
    assert!((back - BACK.distance_m).abs() < 2e-6, "{back:e} m");
    // A step of the encoders in a period is 0.5 mm/s.
    assert!(fastest < BACK.speed_m_s + 1.2e-3, "{fastest} m/s");
    assert_eq!((arm.take_news().retreats, arm.retreat()), (Some(BACK), None));
    move_and_fall_silent(&mut arm);
    steps(&mut arm, 30);
    assert!(stays(&mut arm) && arm.take_news().retreats.is_none(), "once");
}

#[test]
fn without_a_retreat_a_silent_arm_stays_and_one_that_comes_later_is_for_the_next_silence() {
    let mut arm = ready();
    move_and_fall_silent(&mut arm);
    steps(&mut arm, 30);
    assert!(stays(&mut arm));
    arm.set_retreat(Some(BACK));
    assert!(stays(&mut arm), "who fell silent before has nothing to do with it");
    move_and_fall_silent(&mut arm);
    steps(&mut arm, 30);
    assert!(!stays(&mut arm));
}

#[test]
fn any_command_takes_the_place_of_a_retreat_before_and_on_the_way() {
    type Command = fn(&mut Arm<SimulatedDrive>);
    let commands: [Command; 4] = [
        |arm| arm.hold(),
        |arm| arm.state_command("pause").expect("from ENABLED"),
        |arm| arm.make_safe(),
        |arm| arm.set_retreat(None),
    ];
    for (n, command) in commands.into_iter().enumerate() {
        let mut arm = ready();
        arm.set_retreat(Some(BACK));
        move_and_fall_silent(&mut arm);
        steps(&mut arm, 20);
        command(&mut arm);
        assert!(stays(&mut arm), "command {n} before the way");
    }
    for (n, command) in commands.into_iter().take(3).enumerate() {
        let mut arm = ready();
        arm.set_retreat(Some(BACK));
        move_and_fall_silent(&mut arm);
        steps(&mut arm, 130);
        let gone = -tip(&arm).z + 0.12;
        assert!(gone > 0.05e-3, "it was on its way: {gone:e} m");
        command(&mut arm);
        steps(&mut arm, 200);
        assert!(stays(&mut arm), "command {n} on the way");
    }
}

#[test]
fn a_motion_that_goes_on_and_a_position_that_was_reached_are_no_silence() {
    let mut arm = ready();
    arm.set_retreat(Some(BACK));
    arm.servo_jp(&[0.001, 0.0, 0.0, 0.0, 0.0]).expect("in reach");
    steps(&mut arm, 500);
    assert!(stays(&mut arm));
    arm.free().expect("ready");
    assert!(stays(&mut arm), "a hand that rests leads all the same");
    assert_eq!(arm.retreat(), Some(BACK));
}

#[test]
fn the_way_back_ends_where_a_slide_does() {
    let mut arm = ready();
    arm.move_jp(&[0.0, 0.0, -0.0499, 0.0, 0.0]).expect("in reach");
    steps(&mut arm, 8_000);
    arm.set_retreat(Some(Retreat { distance_m: 1e-3, ..BACK }));
    move_and_fall_silent(&mut arm);
    steps(&mut arm, 1_500);
    assert!((arm.measured().position[2] + 0.05).abs() < 2e-6, "{:?}", arm.measured());
    assert!(arm.operating().is_ready(), "{:?}", arm.fault());
}

#[test]
fn what_can_be_no_retreat_is_refused_with_its_limits_and_no_distance_is_none() {
    let told = |distance, speed, delay| Retreat::checked(&data::Retreat { distance, speed, delay });
    assert_eq!(told(0.4e-3, 2e-3, 0.02), Ok(Some(BACK)));
    assert_eq!(told(0.0, 0.0, 0.0), Ok(None));
    for (bad, why) in [
        (told(-1e-3, 2e-3, 0.0), "distance of the retreat: -0.001 m is outside 0 … 0.005 m"),
        (told(f64::NAN, 2e-3, 0.0), "distance of the retreat: NaN m is outside 0 … 0.005 m"),
        (told(1e-3, 0.0, 0.0), "speed of the retreat: 0 m/s is outside 0.000001 … 0.1 m/s"),
        (told(1e-3, 2e-3, f64::INFINITY), "delay of the retreat: inf s is outside 0 … 1 s"),
    ] {
        assert_eq!(bad.map_err(|refused| refused.to_string()), Err(why.to_owned()));
    }
    assert_eq!(Retreat::payload(None), data::Retreat::default());
    assert_eq!(Retreat::checked(&Retreat::payload(Some(BACK))), Ok(Some(BACK)));
}
