//! The component `joint_mover`: moves one slide of a robot to and fro.
//!
//! Invariant: nothing waits; the goal is continuous over live changes of the frequency, and starts where home
//! is.

use std::f64::consts::TAU;

use trocar_sdk::data::JointState;
use trocar_sdk::prelude::*;

use crate::joints::COUNT;

#[derive(Config)]
struct JointMoverConfig {
    /// Half of the way from end to end
    #[config(live, min = 0.0, max = 0.05, unit = "m", default = 0.005)]
    amplitude_m: f64,
    /// Turns per second
    #[config(live, min = 0.0, max = 10.0, unit = "Hz", default = 0.2)]
    frequency_hz: f64,
    /// Which slide: 0 is x, 1 is y, 2 is z
    #[config(live, min = 0, max = 2, default = 2)]
    joint: usize,
}

/// Sends amplitude · sin(2π · frequency · t) to one slide of the connected robot, the other joints to zero.
#[derive(Component)]
#[component(rate_hz = 100)]
pub struct JointMover {
    /// Takes the next goal.
    #[required(interface = "robot", name = "servo_jp")]
    servo_jp: Function<JointState>,
    /// Called when this component stops.
    #[required(interface = "robot", name = "hold", optional)]
    hold: Function,
    /// Reads back where the robot is.
    #[required(interface = "robot", name = "measured_js", optional)]
    measured_js: Function<(), JointState>,
    /// Goals sent since Start.
    #[state]
    sent: u64,
    /// Goals since Start that did not reach a robot.
    #[state]
    rejected: u64,
    /// The last goal.
    #[state]
    #[unit("m")]
    goal: f64,
    /// Position of the slide at the last reading.
    #[state]
    #[unit("m")]
    measured: f64,
    #[config]
    cfg: JointMoverConfig,
    /// Phase of the sine, 0 to 1.
    phase: f64,
}

impl Component for JointMover {
    fn start(&mut self) -> Result {
        (self.sent, self.rejected, self.goal, self.phase) = (0, 0, 0.0, 0.0);
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.hold.send(());
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let mut position = [0.0; COUNT];
        self.goal = self.cfg.amplitude_m * (TAU * self.phase).sin();
        position[self.cfg.joint] = self.goal;
        let goal = JointState { stamp: tick.now(), position: List::of(&position), ..Default::default() };
        if self.servo_jp.send(goal).is_ok() {
            self.sent += 1;
        } else {
            self.rejected += 1;
        }
        // A read is served from the robot's state row, so it may be called from a step.
        if let Ok(at) = self.measured_js.call(())
            && let Some(&at) = at.position.get(self.cfg.joint)
        {
            self.measured = at;
        }
        self.phase = (self.phase + self.cfg.frequency_hz * tick.period_s()).fract();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trocar_sdk::testing::Bench;

    #[test]
    fn one_slide_follows_a_sine_and_the_others_stay_at_home() {
        let mut bench = Bench::<JointMover>::new(r#"{"amplitude_m": 0.01, "frequency_hz": 1, "joint": 1}"#);
        bench.step(101);
        let goals = bench.calls::<JointState>("servo_jp");
        assert_eq!(goals[0].position[..], [0.0; 5]);
        assert!((goals[25].position[1] - 0.01).abs() < 1e-9, "after a quarter: {}", goals[25].position[1]);
        assert!(goals.iter().all(|g| g.position[0] == 0.0 && g.position[2..] == [0.0; 3]));
        assert_eq!((bench.state().sent, bench.state().rejected), (101, 0));
    }

    #[test]
    fn a_live_change_of_the_frequency_makes_no_jump() {
        let mut bench = Bench::<JointMover>::new(r#"{"frequency_hz": 1}"#);
        bench.step(13);
        bench.configure(r#"{"frequency_hz": 2}"#).unwrap();
        bench.step(10);
        let goals = bench.calls::<JointState>("servo_jp");
        let most = 0.005 * TAU * 2.0 / 100.0;
        for pair in goals.windows(2) {
            let jump = (pair[1].position[2] - pair[0].position[2]).abs();
            assert!(jump <= most, "{jump} m in one cycle, {most} m is the sine's own most");
        }
    }

    #[test]
    fn goals_that_reach_nobody_are_counted() {
        let mut bench = Bench::<JointMover>::new("{}");
        bench.connect_function("servo_jp", false);
        bench.step(3);
        assert_eq!((bench.state().sent, bench.state().rejected), (0, 3));
    }

    #[test]
    fn stopping_holds_the_robot_and_a_reading_is_shown() {
        let mut bench = Bench::<JointMover>::new("{}");
        bench.answer("measured_js", |()| {
            Ok(JointState { position: List::of(&[1.0, 2.0, 3.0, 4.0, 5.0]), ..Default::default() })
        });
        bench.step(1);
        assert_eq!(bench.state().measured, 3.0);
        bench.stop().unwrap();
        assert_eq!(bench.calls::<()>("hold").len(), 1);
    }
}
