//! The component on the bench, as a client sees it.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::JointKind;
use trocar_sdk::testing::{Bench, Failure, assert_behaves_as_arm, assert_implements, contracts};

trocar_sdk::testing::count_allocations!();

fn joints(position: &[f64]) -> JointState {
    JointState { position: List::of(position), ..Default::default() }
}

fn position(bench: &Bench<EyeRobot>) -> Vec<f64> {
    bench.read::<(), JointState>("measured_js", ()).unwrap().position.to_vec()
}

fn operating(bench: &Bench<EyeRobot>) -> OperatingState {
    bench.read("operating_state", ()).unwrap()
}

fn say(bench: &mut Bench<EyeRobot>, word: &str) -> Result<(), Failure> {
    bench.command::<Text<32>, ()>("state_command", word.into())
}

#[test]
fn right_after_start_servo_jp_with_positions_alone_moves_the_arm_there() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("arm/servo_jp", joints(&[0.0, 0.0, 0.01, 0.0, 0.0])).unwrap();
    bench.step(1500);
    let z = position(&bench)[2];
    // 10 mm at 10 mm/s take 1 s; encoders have steps of 0.5 µm.
    assert!((z - 0.01).abs() < 2e-6, "z is {z} m after 1.5 s");
    let setpoint: JointState = bench.read("setpoint_js", ()).unwrap();
    assert_eq!(setpoint.position[2], 0.01);
}

#[test]
fn the_speed_of_a_servo_goal_stays_at_the_configured_one() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"speed_m_s": 0.002}"#);
    bench.command::<_, ()>("servo_jp", joints(&[0.05, 0.0, 0.0, 0.0, 0.0])).unwrap();
    for _ in 0..500 {
        bench.step(1);
        let v = bench.read::<(), JointState>("setpoint_js", ()).unwrap().velocity[0];
        assert!(v <= 0.002 * (1.0 + 1e-9), "{v} m/s");
    }
}

#[test]
fn goals_outside_the_limits_or_of_another_length_are_refused_and_nothing_moves() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let refused = bench.command::<_, ()>("servo_jp", joints(&[0.0, 0.0, 0.2, 0.0, 0.0])).unwrap_err();
    assert!(refused.reason.contains('z') && refused.reason.contains("0.05"), "{refused}");
    let refused = bench.command::<_, ()>("move_jp", joints(&[0.01])).unwrap_err();
    assert!(refused.reason.contains('1') && refused.reason.contains('5'), "{refused}");
    assert!(!refused.panicked());
    bench.step(100);
    assert!(position(&bench).iter().all(|q| q.abs() < 2e-5), "{:?}", position(&bench));
}

#[test]
fn without_auto_enable_motions_are_refused_until_enabled_and_homed() {
    let mut bench = Bench::<EyeRobot>::new(r#"{"auto_enable": false}"#);
    assert_eq!(operating(&bench).state, OperatingMode::DISABLED);
    let refused = bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap_err();
    assert!(refused.reason.contains("enable"), "{refused}");
    say(&mut bench, "enable").unwrap();
    let refused = bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap_err();
    assert!(refused.reason.contains("home"), "{refused}");
    say(&mut bench, "home").unwrap();
    bench.step(2);
    bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap();
    assert!(say(&mut bench, "fly").is_err());
}

#[test]
fn each_change_of_the_operating_state_is_told_once() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(10);
    bench.events::<OperatingState>("arm/operating_state");
    say(&mut bench, "pause").unwrap();
    bench.step(10);
    let told = bench.events::<OperatingState>("arm/operating_state");
    assert_eq!(told.iter().map(|s| s.state).collect::<Vec<_>>(), [OperatingMode::PAUSED]);
    assert!(told[0].stamp.is_valid());
}

#[test]
fn move_jp_is_busy_until_it_arrives() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(1);
    bench.events::<OperatingState>("arm/operating_state");
    bench.command::<_, ()>("move_jp", joints(&[0.001, 0.0, 0.0, 0.0, 0.0])).unwrap();
    assert!(operating(&bench).is_busy.get());
    bench.step(400);
    assert!(!operating(&bench).is_busy.get());
    let busy: Vec<bool> =
        bench.events::<OperatingState>("arm/operating_state").iter().map(|s| s.is_busy.get()).collect();
    assert_eq!(busy, [true, false]);
}

#[test]
fn servo_jv_holds_by_itself_when_it_is_not_repeated() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let goal = JointState { velocity: List::of(&[0.005, 0.0, 0.0, 0.0, 0.0]), ..Default::default() };
    for _ in 0..50 {
        bench.command::<_, ()>("servo_jv", goal).unwrap();
        bench.step(1);
    }
    assert!(bench.read::<(), Twist>("arm/measured_cv", ()).unwrap().linear[0] > 0.004);
    bench.step(200);
    let v = bench.read::<(), Twist>("arm/measured_cv", ()).unwrap().linear[0];
    assert!(v.abs() < 1e-5, "{v} m/s after the timeout");
}

#[test]
fn commands_that_come_too_slowly_are_counted_where_the_arm_brakes_between_them() {
    let goal = JointState { velocity: List::of(&[0.002, 0.0, 0.0, 0.0, 0.0]), ..Default::default() };
    let counted = |period: u64| {
        let mut bench = Bench::<EyeRobot>::new("{}");
        for _ in 0..50 {
            bench.command::<_, ()>("servo_jv", goal).unwrap();
            bench.step(period);
        }
        let counted = bench.state().servo_timeouts;
        bench.stop().unwrap();
        bench.start().unwrap();
        bench.step(1);
        assert_eq!(bench.state().servo_timeouts, 0, "since Start");
        counted
    };
    assert_eq!((counted(2), counted(20)), (0, 50));
}

#[test]
fn a_motion_by_velocity_ends_in_its_time_where_periods_were_left_out() {
    let x = |bench: &Bench<EyeRobot>| bench.read::<(), Pose>("arm/measured_cp", ()).unwrap().position[0];
    let goal = JointState { velocity: List::of(&[0.005, 0.0, 0.0, 0.0, 0.0]), ..Default::default() };
    let goes_on = |missed_ns: u64| {
        let mut bench = Bench::<EyeRobot>::new("{}");
        for _ in 0..50 {
            bench.command::<_, ()>("servo_jv", goal).unwrap();
            bench.step(1);
        }
        let from = x(&bench);
        bench.late_step(missed_ns).unwrap();
        bench.step(100);
        x(&bench) - from
    };
    let (in_time, late) = (goes_on(0), goes_on(7_000_000));
    // Seven of its eight milliseconds have passed before the late step.
    assert!(
        late < in_time - 6.0 * 0.005e-3,
        "{late} m after periods that were left out, {in_time} m without"
    );
}

#[test]
fn servo_commands_that_lay_in_wait_or_come_from_another_clock_are_refused_and_counted() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(1);
    let from: Pose = bench.read("arm/measured_cp", ()).unwrap();
    // A period of 1 ms and command_age_s are taken.
    for (age_ns, taken) in [(12_000_000i64, false), (-12_000_000, false), (10_900_000, true), (0, true)] {
        let stamp = Stamp::from_ns(bench.now().ns().checked_add_signed(-age_ns).unwrap());
        let twist = Twist { stamp, linear: [0.0, 0.0, 0.002], ..Twist::default() };
        let goal = JointState { stamp, position: List::of(&[0.001; 5]), ..Default::default() };
        let speed = JointState { stamp, velocity: List::of(&[0.001; 5]), ..Default::default() };
        let small = Pose { stamp, position: [0.0, 0.0, 1e-6], ..Pose::default() };
        let pose = Pose { stamp, ..from };
        let all = [
            bench.command::<_, ()>("arm/servo_jp", goal),
            bench.command::<_, ()>("arm/servo_jr", goal),
            bench.command::<_, ()>("arm/servo_jv", speed),
            bench.command::<_, ()>("arm/servo_cp", pose),
            bench.command::<_, ()>("arm/servo_cr", small),
            bench.command::<_, ()>("arm/interpolate_jp", goal),
            bench.command::<_, ()>("arm/interpolate_cp", pose),
            bench.command::<_, ()>("arm/servo_cv", twist),
            bench.command::<_, ()>("axis/servo_cv", twist),
            bench.command::<_, ()>("compliance/servo_cf", Wrench { stamp, ..Wrench::default() }),
        ];
        for (n, done) in all.iter().enumerate() {
            assert_eq!(done.is_ok(), taken, "command {n}, {age_ns} ns old: {done:?}");
        }
        let word = if age_ns > 0 { "0.012 s old by its stamp, at most 0.011 s" } else { "0.012 s ahead of" };
        assert!(taken || all.iter().all(|done| done.as_ref().unwrap_err().reason.contains(word)), "{all:?}");
    }
    assert_eq!(bench.state().stale_commands, 20);
    // Refused commands move nothing, and a command that is no stream of goals is carried out however late.
    bench.command::<(), ()>("hold", ()).unwrap();
    bench.step(200);
    let stale = Twist { stamp: Stamp::from_ns(1), linear: [0.005, 0.0, 0.0], ..Twist::default() };
    let x = position(&bench)[0];
    for _ in 0..50 {
        assert!(bench.command::<_, ()>("arm/servo_cv", stale).is_err());
        bench.step(1);
    }
    assert!((position(&bench)[0] - x).abs() < 1e-6, "{:?}", position(&bench));
    let home = JointState { stamp: Stamp::from_ns(1), position: List::of(&[0.0; 5]), ..Default::default() };
    bench.command::<_, ()>("arm/move_jp", home).unwrap();
    bench.stop().unwrap();
    bench.start().unwrap();
    assert_eq!(bench.state().stale_commands, 0);
}

#[test]
fn servo_cp_reaches_a_pose_and_refuses_one_without_orientation() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let mut goal: Pose = bench.read("arm/measured_cp", ()).unwrap();
    (goal.stamp, goal.position[0]) = (Stamp::INVALID, goal.position[0] + 0.002);
    bench.command::<_, ()>("servo_cp", goal).unwrap();
    bench.step(600);
    let at: Pose = bench.read("arm/measured_cp", ()).unwrap();
    assert!((at.position[0] - goal.position[0]).abs() < 5e-6, "{:?} instead of {:?}", at, goal);
    let refused = bench.command::<_, ()>("servo_cp", Pose { orientation: [0.0; 4], ..goal }).unwrap_err();
    assert!(refused.reason.contains("unit quaternion"), "{refused}");
    let nowhere = Pose { orientation: [f64::NAN; 4], ..goal };
    assert!(bench.command::<_, ()>("servo_cp", nowhere).is_err());
}

#[test]
fn make_safe_brakes_at_once_and_resume_goes_on() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("servo_jp", joints(&[0.02, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(500);
    bench.make_safe().unwrap();
    let stood = position(&bench);
    assert_eq!(operating(&bench).state, OperatingMode::PAUSED);
    assert!(bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).is_err());
    bench.step(100);
    // 10 mm/s and 0.5 m/s² are 0.1 mm.
    let way = position(&bench)[0] - stood[0];
    assert!((0.0..0.102e-3).contains(&way), "the arm went on for {way} m");
    bench.stop().unwrap();
    bench.resume().unwrap();
    assert_eq!(operating(&bench).state, OperatingMode::ENABLED);
    bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap();
}

#[test]
fn stop_and_start_leave_the_arm_where_it_stands() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("servo_jp", joints(&[0.003, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(1000);
    bench.make_safe().unwrap();
    bench.stop().unwrap();
    bench.start().unwrap();
    bench.step(1000);
    let x = position(&bench)[0];
    assert!((x - 0.003).abs() < 5e-6, "x is {x} m");
    bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap();
}

#[test]
fn configure_and_start_away_from_home_move_nothing_and_the_arm_knows_where_it_is() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("move_jp", joints(&[0.003, 0.0, -0.002, 0.1, 0.0])).unwrap();
    bench.step(2000);
    bench.stop().unwrap();
    let stood = position(&bench);
    bench.configure(r#"{"speed_m_s": 0.005}"#).unwrap();
    bench.start().unwrap();
    assert!(operating(&bench).is_homed.get() && !operating(&bench).is_busy.get());
    bench.step(1000);
    let moved = position(&bench).iter().zip(&stood).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved < 10e-6, "{moved}: it stood at {stood:?}");
    bench.command::<_, ()>("servo_jp", joints(&[0.004, 0.0, -0.002, 0.1, 0.0])).unwrap();
    bench.step(1000);
    assert!((position(&bench)[0] - 0.004).abs() < 2e-6);
}

#[test]
fn an_arm_that_forgot_its_home_away_from_it_goes_there_only_when_it_is_asked() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("move_jp", joints(&[0.003, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(1000);
    say(&mut bench, "unhome").unwrap();
    bench.stop().unwrap();
    bench.start().unwrap();
    bench.expect_log(log::Level::Warn, "not homed, and away from home");
    bench.step(1000);
    assert!((position(&bench)[0] - 0.003).abs() < 2e-6 && !operating(&bench).is_homed.get());
    assert_eq!(operating(&bench).state, OperatingMode::ENABLED);
    assert!(bench.command::<_, ()>("servo_jp", joints(&[0.0; 5])).unwrap_err().reason.contains("home"));
    say(&mut bench, "home").unwrap();
    bench.step(1000);
    assert!(operating(&bench).is_homed.get() && position(&bench)[0].abs() < 2e-6);
}

#[test]
fn hold_brakes_a_running_motion() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.command::<_, ()>("move_jp", joints(&[0.02, 0.0, 0.0, 0.0, 0.0])).unwrap();
    bench.step(300);
    bench.command::<(), ()>("hold", ()).unwrap();
    bench.step(300);
    let x = position(&bench)[0];
    bench.step(300);
    assert!((position(&bench)[0] - x).abs() < 2e-6 && x < 0.01, "x went from {x} to {:?}", position(&bench));
    assert!(!operating(&bench).is_busy.get());
}

#[test]
fn configuration_js_names_the_joints_and_the_configured_limits() {
    let bench = Bench::<EyeRobot>::new(r#"{"travel_m": 0.03}"#);
    let c: JointConfiguration = bench.read("configuration_js", ()).unwrap();
    assert_eq!(c.names.iter().map(|n| n.to_string()).collect::<Vec<_>>(), ["x", "y", "z", "roll", "tilt"]);
    assert_eq!(c.kinds[2..4], [JointKind::PRISMATIC, JointKind::REVOLUTE]);
    assert_eq!((c.lower[0], c.upper[0], c.speed[0]), (-0.03, 0.03, 0.01));
}

#[test]
fn each_cycle_is_streamed_with_its_time() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    bench.step(3);
    let samples = bench.samples::<ArmState>("state");
    assert_eq!(samples.len(), 3);
    assert_eq!((samples[2].1, samples[2].0.measured_js.stamp), (bench.now(), bench.now()));
}

#[test]
fn a_swapped_arm_stands_where_the_former_one_stood_and_does_not_move_by_itself() {
    let mut old = Bench::<EyeRobot>::new("{}");
    old.command::<_, ()>("servo_jp", joints(&[0.004, 0.0, 0.0, 0.0, 0.0])).unwrap();
    old.step(1000);
    let (row, extra) = old.snapshot();
    let mut new = Bench::<EyeRobot>::ready("{}");
    new.restore(&row, &extra).unwrap();
    new.resume().unwrap();
    new.step(100);
    let (was, is) = (position(&old)[0], position(&new)[0]);
    assert!((is - was).abs() < 2e-6, "x was {was} m and is {is} m");
    assert_eq!(operating(&new).state, OperatingMode::DISABLED);
}

#[test]
fn the_robot_fulfils_the_contract_of_arms() {
    assert_implements::<EyeRobot>(&contracts::ARM);
}

#[test]
fn the_robot_behaves_as_the_contract_of_arms_says() {
    for config in ["{}", r#"{"auto_enable": false}"#, r#"{"travel_m": 0.004, "speed_m_s": 0.0166}"#] {
        assert_behaves_as_arm(&mut Bench::<EyeRobot>::new(config), "arm");
    }
}

#[test]
fn a_step_of_the_robot_allocates_nothing_in_any_kind_of_motion() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let velocity = JointState { velocity: List::of(&[0.001, 0.0, 0.0, 0.0, 0.0]), ..Default::default() };
    let pose = Pose { stamp: Stamp::INVALID, ..bench.read("arm/measured_cp", ()).unwrap() };
    bench.assert_no_alloc(|bench| {
        bench.step(10);
        bench.command::<_, ()>("servo_jp", joints(&[0.001, 0.0, 0.0, 0.01, 0.0])).unwrap();
        bench.step(100);
        bench.command::<_, ()>("servo_jv", velocity).unwrap();
        bench.step(200);
        bench.command::<_, ()>("servo_cp", pose).unwrap();
        bench.step(100);
        bench.command::<_, ()>("move_jp", joints(&[0.0; 5])).unwrap();
        bench.step(500);
    });
}

#[test]
fn a_pose_with_a_number_that_is_none_is_refused_by_name() {
    let mut bench = Bench::<EyeRobot>::new("{}");
    let nan = Pose { position: [0.0, 0.0, f64::NAN], ..Pose::default() };
    let refused = bench.command::<_, ()>("servo_cp", nan).unwrap_err();
    assert_eq!(refused.reason, "position[2] is NaN: give a finite number");
}
