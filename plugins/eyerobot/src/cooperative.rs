//! The component `cooperative`: lets a hand lead a robot.
//!
//! Invariant: the robot follows only while this steps; nothing waits, and what reaches no robot is counted.

use trocar_sdk::data::Wrench;
use trocar_sdk::prelude::*;

/// Cooperative control: asks the robot in each cycle to follow the hand on its handle. The robot stands when it is not asked.
#[derive(Component)]
#[component(rate_hz = 500)]
pub struct Cooperative {
    /// Follows the hand until the next one is due.
    #[required(interface = "compliance", name = "servo_cf")]
    servo_cf: Function<Wrench>,
    /// Called when this component stops.
    #[required(interface = "robot", name = "hold")]
    hold: Function,
    /// What the hand does to the handle.
    #[required(interface = "robot", name = "measured_cf", optional)]
    measured_cf: Function<(), Wrench>,
    /// Cycles since Start in which the robot was asked.
    #[state]
    sent: u64,
    /// Cycles since Start in which no robot could be asked.
    #[state]
    rejected: u64,
    /// Of the hand on the handle, at the last reading.
    #[state]
    #[unit("N")]
    force: f64,
}

impl Component for Cooperative {
    fn start(&mut self) -> Result {
        (self.sent, self.rejected, self.force) = (0, 0, 0.0);
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.hold.send(());
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        // A wrench of zeros adds nothing to the hand's.
        if self.servo_cf.send(Wrench { stamp: tick.now(), ..Wrench::default() }).is_ok() {
            self.sent += 1;
        } else {
            self.rejected += 1;
        }
        if let Ok(felt) = self.measured_cf.call(()) {
            self.force =
                if felt.is_valid() { felt.force.iter().map(|f| f * f).sum::<f64>().sqrt() } else { 0.0 };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trocar_sdk::testing::Bench;

    #[test]
    fn each_cycle_asks_the_robot_once_to_follow_the_hand_and_stop_holds_it() {
        let mut bench = Bench::<Cooperative>::new("{}");
        bench.answer("measured_cf", |()| {
            Ok(Wrench { stamp: Stamp::from_ns(1), force: [3.0, 0.0, 4.0], torque: [0.0; 3] })
        });
        bench.step(5);
        let asked = bench.calls::<Wrench>("servo_cf");
        assert_eq!(asked.len(), 5);
        assert!(
            asked
                .iter()
                .all(|wrench| wrench.is_valid() && (wrench.force, wrench.torque) == ([0.0; 3], [0.0; 3]))
        );
        assert_eq!((bench.state().sent, bench.state().rejected, bench.state().force), (5, 0, 5.0));
        assert_eq!(bench.calls::<()>("hold").len(), 0);
        bench.stop().unwrap();
        assert_eq!(bench.calls::<()>("hold").len(), 1);
    }

    #[test]
    fn a_robot_that_is_not_there_is_counted_and_a_handle_nobody_feels_has_no_force() {
        let mut bench = Bench::<Cooperative>::new("{}");
        bench.connect_function("servo_cf", false);
        bench.answer("measured_cf", |()| Ok(Wrench { force: [1.0; 3], ..Wrench::default() }));
        bench.step(3);
        assert_eq!((bench.state().sent, bench.state().rejected, bench.state().force), (0, 3, 0.0));
    }

    #[test]
    fn a_step_allocates_nothing() {
        let mut bench = Bench::<Cooperative>::new("{}");
        bench.answer("measured_cf", |()| Ok(Wrench::default()));
        bench.assert_no_alloc(|bench| bench.step(100));
    }
}
