//! Tests of the arm against the simulated drive: motions, pre-emption, faults, safety.
//!
//! Invariant: time is counted in periods of `DT`, never read from a clock.

use super::*;
use crate::drive::{Lost, SimulatedDrive, Simulation};

const DT: f64 = 1e-3;

fn arm() -> Arm<SimulatedDrive> {
    Arm::new(
        Settings::default(),
        SimulatedDrive::new(Simulation::default(), Joints::zeros()),
        Joints::zeros(),
    )
}

fn ready() -> Arm<SimulatedDrive> {
    let mut arm = arm();
    arm.state_command("enable").expect("from DISABLED");
    arm.state_command("home").expect("from ENABLED");
    arm.step(DT);
    assert!(arm.operating().is_ready(), "home from zero is over after one period: {:?}", arm.operating());
    arm
}

fn steps<D: Drive>(arm: &mut Arm<D>, count: usize) {
    for _ in 0..count {
        arm.step(DT);
    }
}

fn steps_until<D: Drive>(arm: &mut Arm<D>, most: usize, over: impl Fn(&Arm<D>) -> bool) -> usize {
    for n in 0..most {
        if over(arm) {
            return n;
        }
        arm.step(DT);
    }
    panic!("not reached in {most} periods: {:?} {:?}", arm.operating(), arm.fault());
}

#[test]
fn motions_are_refused_until_the_arm_is_enabled_and_homed() {
    let mut arm = arm();
    let refused = arm.servo_jp(&[0.0; COUNT]).expect_err("DISABLED");
    assert_eq!(refused.to_string(), "the device is DISABLED: send state_command `enable` first");
    arm.state_command("enable").expect("allowed");
    let refused = arm.move_jp(&[0.0; COUNT]).expect_err("not homed");
    assert_eq!(
        refused.to_string(),
        "the device is not homed: send state_command `home` and wait for is_homed"
    );
}

#[test]
fn move_jp_is_busy_until_the_end_and_arrives() {
    let mut arm = ready();
    let goal = [0.004, -0.003, 0.002, 0.05, -0.04];
    arm.move_jp(&goal).expect("inside the limits");
    assert!(arm.operating().is_busy());
    let periods = steps_until(&mut arm, 2_000, |arm| !arm.operating().is_busy());
    assert!(periods > 400, "4 mm at 10 mm/s take at least 0.4 s, not {periods} ms");
    assert_eq!(arm.setpoint().position.as_slice(), goal);
    steps(&mut arm, 500);
    let off = arm.measured().position - Joints::from_column_slice(&goal);
    for i in 0..COUNT {
        assert!(off[i].abs() <= Simulation::default().quantum[i], "joint {i} rests {:e} away", off[i]);
    }
}

#[test]
fn home_moves_back_to_zero_and_sets_is_homed_on_arrival() {
    let mut arm = ready();
    arm.move_jp(&[0.005, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 1_000);
    arm.state_command("unhome").expect("not busy");
    arm.state_command("home").expect("enabled");
    assert!(!arm.operating().is_homed() && arm.operating().is_busy());
    steps_until(&mut arm, 1_000, |arm| arm.operating().is_homed());
    assert_eq!(arm.setpoint().position, Joints::zeros());
}

#[test]
fn servo_jp_goes_at_most_at_the_joints_speed() {
    let mut arm = ready();
    arm.servo_jp(&[0.05, 0.0, 0.0, 1.0, 0.0]).expect("inside");
    steps(&mut arm, 1_000);
    let q = arm.measured().position;
    assert!((q[0] - 0.010).abs() < 1e-4 && (q[3] - 7f64.to_radians()).abs() < 1.5e-3, "{q:?}");
    assert_eq!(arm.operating().mode(), OperatingMode::ENABLED, "{:?}", arm.fault());
}

#[test]
fn servo_cp_follows_a_pose_and_refuses_one_out_of_reach() {
    let mut arm = ready();
    let kinematics = arm.settings().kinematics;
    let goal = kinematics.forward(&Joints::from_column_slice(&[0.001, 0.002, -0.001, 0.02, 0.03]));
    arm.servo_cp(&goal).expect("reachable");
    steps(&mut arm, 2_500);
    assert!((arm.measured_cp().translation.vector - goal.translation.vector).norm() < 5e-6);
    let far = Isometry3::translation(1.0, 0.0, 0.0);
    assert!(matches!(arm.servo_cp(&far), Err(ArmError::Pose(_))));
}

#[test]
fn a_new_motion_pre_empts_a_running_one_without_a_jump() {
    let mut arm = ready();
    arm.move_jp(&[0.02, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 500);
    arm.move_jp(&[-0.02, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    let mut before = arm.setpoint();
    for _ in 0..4_500 {
        arm.step(DT);
        let jump = arm.setpoint().velocity[0] - before.velocity[0];
        assert!(jump.abs() <= 0.5 * DT * (1.0 + 1e-6), "velocity jumps by {jump} m/s");
        before = arm.setpoint();
    }
    assert_eq!(arm.setpoint().position[0], -0.02);
}

#[test]
fn a_refused_goal_leaves_the_running_motion_as_it_was() {
    let mut arm = ready();
    let goal = [0.005, 0.0, 0.0, 0.0, 0.0];
    arm.move_jp(&goal).expect("inside");
    steps(&mut arm, 100);
    assert!(arm.move_jp(&[0.051, 0.0, 0.0, 0.0, 0.0]).is_err());
    assert!(arm.servo_jp(&[f64::NAN; COUNT]).is_err());
    assert!(arm.servo_jv(&[0.02, 0.0, 0.0, 0.0, 0.0]).is_err());
    assert!(arm.servo_jv(&[0.0; 4]).is_err());
    steps(&mut arm, 1_000);
    assert_eq!(arm.setpoint().position.as_slice(), goal);
}

#[test]
fn servo_jp_keeps_the_acceleration_of_each_joint() {
    let mut arm = ready();
    let most = arm.settings().limits.acceleration * DT * (1.0 + 1e-9);
    let mut before = arm.setpoint().velocity;
    for n in 0..600 {
        // Goals that jump about, and one that is met in between.
        let side = if n / 90 % 2 == 0 { 1.0 } else { -1.0 };
        arm.servo_jp(&[4e-3 * side, 1e-5 * side, 0.0, 0.05 * side, 0.0]).expect("inside");
        arm.step(DT);
        let change = (arm.setpoint().velocity - before).abs();
        assert!((0..COUNT).all(|i| change[i] <= most[i]), "period {n}: {change:?}");
        before = arm.setpoint().velocity;
    }
}

#[test]
fn an_arm_whose_client_is_lost_stands_within_20_milliseconds_from_5_millimetres_a_second() {
    let mut longest_m = 0.0_f64;
    for seed in 0..40 {
        let home = Joints::zeros();
        let simulation = Simulation { seed, ..Simulation::default() };
        let mut arm = Arm::new(Settings::default(), SimulatedDrive::new(simulation, home), home);
        for word in ["enable", "home"] {
            arm.state_command(word).expect("a new arm takes it");
        }
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut some = || 5e-3 * (2.0 * rng.f64() - 1.0);
        let (aside, along) = (some(), some());
        // As a scan moves it: across and along the tool, here for longer and shorter times.
        for _ in 0..50 + 10 * seed {
            arm.step(DT);
            arm.servo_cv(&Vector6::new(aside, 0.0, 0.0, 0.0, 0.0, 0.0)).expect("slow");
            arm.servo_axis(&Vector6::new(0.0, 0.0, along, 0.0, 0.0, 0.0)).expect("slow");
        }
        // The period after the last command is the first without one.
        let from = arm.drive().truth().position;
        let mut before = arm.drive().truth().velocity;
        for n in 1..=200 {
            arm.step(DT);
            let now = arm.drive().truth();
            let change = (now.velocity - before).abs();
            assert!(
                (0..COUNT).all(|i| change[i] <= 0.5 * DT * 12.0 / if i < 3 { 12.0 } else { 1.0 } + 1e-12)
            );
            before = now.velocity;
            if n >= 20 {
                assert_eq!(now.velocity, Joints::zeros(), "seed {seed}: {n} ms after the last command");
            }
        }
        longest_m = longest_m.max((arm.drive().truth().position - from).amax());
        assert!(arm.operating().is_ready() && arm.is_position_based(), "it holds: {:?}", arm.operating());
    }
    // 9 ms at 5 mm/s and 25 µm of braking.
    println!("from loss to standstill {longest_m:e} m at most");
    assert!(longest_m < 80e-6, "{longest_m:e} m");
}

#[test]
fn servo_jv_that_is_not_repeated_holds_the_arm_after_its_timeout() {
    let mut arm = ready();
    for _ in 0..100 {
        arm.servo_jv(&[0.01, 0.0, 0.0, 0.0, 0.0]).expect("at the speed limit");
        arm.step(DT);
    }
    steps(&mut arm, 900);
    // 0.1 s and 8 ms at 10 mm/s, less what the drive lags behind, and 0.1 mm of braking.
    let q = arm.measured().position[0];
    assert!((0.001..=0.0012).contains(&q), "stopped at {q} m");
    assert_eq!(arm.setpoint().velocity, Joints::zeros());
}

#[test]
fn servo_jv_keeps_the_acceleration_of_each_joint() {
    let mut arm = ready();
    let most = arm.settings().limits.acceleration * DT * (1.0 + 1e-9);
    let mut before = arm.setpoint().velocity;
    for n in 0..300 {
        let side = if n / 70 % 2 == 0 { 1.0 } else { -1.0 };
        arm.servo_jv(&[0.01 * side, 0.0, -0.005 * side, 0.1 * side, 0.0]).expect("at the limits");
        arm.step(DT);
        let change = (arm.setpoint().velocity - before).abs();
        assert!((0..COUNT).all(|i| change[i] <= most[i]), "period {n}: {change:?}");
        before = arm.setpoint().velocity;
    }
}

#[test]
fn servo_jv_towards_a_limit_brakes_before_it_tells_it_once_and_the_way_back_is_open() {
    let mut arm = ready();
    arm.move_jp(&[0.0495, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps_until(&mut arm, 10_000, |arm| !arm.operating().is_busy());
    assert_eq!(arm.take_news(), News { reached: 1, ..News::default() });
    let mut hits = 0;
    for _ in 0..600 {
        arm.servo_jv(&[0.01, 0.0, 0.0, 0.0, 0.0]).expect("at the speed limit");
        arm.step(DT);
        let news = arm.take_news();
        hits += usize::from(news.limit_hit[0]);
        assert_eq!(news.limit_hit[1..], [false; 4]);
        assert!(arm.setpoint().position[0] <= 0.05 + 1e-12, "{}", arm.setpoint().position[0]);
    }
    assert_eq!((hits, arm.operating().mode()), (1, OperatingMode::ENABLED), "{:?}", arm.fault());
    assert!(arm.measured().position[0] > 0.04998, "{:?}", arm.measured());
    for _ in 0..200 {
        arm.servo_jv(&[-0.01, 0.0, 0.0, 0.0, 0.0]).expect("at the speed limit");
        arm.step(DT);
    }
    assert!(arm.measured().position[0] < 0.0485, "{:?}", arm.measured());
}

#[test]
fn hold_brakes_a_move_and_stays() {
    let mut arm = ready();
    arm.move_jp(&[0.02, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 500);
    arm.hold();
    assert!(!arm.operating().is_busy());
    steps(&mut arm, 100);
    let stands = arm.setpoint();
    steps(&mut arm, 500);
    assert_eq!(arm.setpoint(), stands);
    assert!((arm.measured().position - stands.position).norm() < 1e-5, "follows to where it braked");
}

#[test]
fn pause_refuses_motions_and_resume_takes_them_again() {
    let mut arm = ready();
    arm.move_jp(&[0.02, 0.0, 0.0, 0.0, 0.0]).expect("inside");
    steps(&mut arm, 300);
    arm.state_command("pause").expect("enabled");
    steps(&mut arm, 100);
    let stands = arm.setpoint().position;
    assert!(arm.servo_jp(&[0.0; COUNT]).is_err());
    steps(&mut arm, 500);
    assert_eq!(arm.setpoint().position, stands);
    arm.state_command("resume").expect("paused");
    steps(&mut arm, 100);
    assert_eq!(arm.setpoint().position, stands, "an old motion does not come back");
    assert!(arm.servo_jp(&[0.0; COUNT]).is_ok());
}

#[test]
fn make_safe_brakes_in_full_motion_and_only_resume_lets_it_move_again() {
    let mut arm = ready();
    arm.move_jp(&[0.02, 0.0, 0.0, 0.1, 0.0]).expect("inside");
    steps(&mut arm, 500);
    let from = arm.measured();
    arm.make_safe();
    let now = arm.operating();
    assert_eq!((now.mode(), now.is_homed(), now.is_busy()), (OperatingMode::PAUSED, true, false));
    steps(&mut arm, 30);
    let stands = arm.measured();
    assert_eq!(stands.velocity, Joints::zeros());
    let way = stands.position - from.position;
    let Simulation { quantum, acceleration, .. } = Simulation::default();
    for i in 0..COUNT {
        let braking = 0.5 * from.velocity[i].powi(2) / acceleration[i];
        assert!((way[i] - braking).abs() <= quantum[i] + 1e-12, "joint {i}: {} m for {braking}", way[i]);
    }
    steps(&mut arm, 1_000);
    assert_eq!(arm.measured(), stands, "and stays there");
    assert!(arm.servo_jp(&[0.0; COUNT]).is_err());
}

/// A drive that ignores what it is told: after its first cycle x goes on and on, 0.3 mm ahead of a setpoint
/// that begins with it.
struct Runaway {
    x: f64,
}

impl Drive for Runaway {
    fn cycle(&mut self, _: &Joints, dt_s: f64) -> Result<Measured, Lost> {
        let mut at = Measured { position: Joints::zeros(), velocity: Joints::zeros() };
        (at.position[0], at.velocity[0]) = (self.x, 0.01);
        self.x = self.x.max(0.3e-3) + 0.01 * dt_s;
        Ok(at)
    }

    fn make_safe(&mut self) {}
}

#[test]
fn a_joint_that_leaves_its_limits_is_a_fault_and_told() {
    let mut arm = Arm::new(Settings::default(), Runaway { x: 0.0 }, Joints::zeros());
    arm.state_command("enable").expect("from DISABLED");
    arm.state_command("home").expect("from ENABLED");
    steps(&mut arm, 1);
    arm.servo_jp(&[0.05, 0.0, 0.0, 0.0, 0.0]).expect("the limit itself");
    steps_until(&mut arm, 6_000, |arm| arm.operating().mode() == OperatingMode::FAULT);
    assert!(matches!(arm.fault(), Some(Fault::Limit { joint: 0, .. })), "{:?}", arm.fault());
    assert!(arm.take_news().limit_hit[0]);
    assert!(arm.servo_jv(&[0.01, 0.0, 0.0, 0.0, 0.0]).is_err(), "a faulted arm takes no motion");
    arm.state_command("enable").expect("retry");
    assert_eq!(arm.fault(), None);
}

/// A drive that does not move, and loses joint 2 after some cycles.
struct Stuck {
    cycles_left: usize,
}

impl Drive for Stuck {
    fn cycle(&mut self, _: &Joints, _: f64) -> Result<Measured, Lost> {
        self.cycles_left = self.cycles_left.checked_sub(1).ok_or(Lost { joint: 2, why: "encoder silent" })?;
        Ok(Measured { position: Joints::zeros(), velocity: Joints::zeros() })
    }

    fn make_safe(&mut self) {}
}

fn stuck(cycles_left: usize) -> Arm<Stuck> {
    let mut arm = Arm::new(Settings::default(), Stuck { cycles_left }, Joints::zeros());
    arm.state_command("enable").expect("from DISABLED");
    arm.state_command("home").expect("from ENABLED");
    steps(&mut arm, 1);
    arm
}

#[test]
fn a_joint_that_does_not_follow_is_a_fault() {
    let mut arm = stuck(usize::MAX);
    arm.servo_jp(&[0.0, 0.01, 0.0, 0.0, 0.0]).expect("inside");
    let periods = steps_until(&mut arm, 100, |arm| arm.operating().mode() == OperatingMode::FAULT);
    assert!((60..=62).contains(&periods), "0.5 mm at 10 mm/s, 20 ms of ramp, are 60 periods, not {periods}");
    assert!(matches!(arm.fault(), Some(Fault::Following { joint: 1, .. })), "{:?}", arm.fault());
}

#[test]
fn a_drive_that_loses_a_joint_is_a_fault_with_its_reason() {
    let mut arm = stuck(10);
    steps(&mut arm, 20);
    assert_eq!(arm.operating().mode(), OperatingMode::FAULT);
    assert_eq!(arm.fault().map(|f| f.to_string()).as_deref(), Some("drive of joint z: encoder silent"));
}

#[test]
fn two_arms_with_the_same_seed_and_commands_measure_the_same() {
    let run = || {
        let mut arm = ready();
        arm.move_jp(&[0.01, 0.02, -0.01, 0.3, 0.2]).expect("inside");
        steps(&mut arm, 1_500);
        arm.measured()
    };
    assert_eq!(run(), run());
}
