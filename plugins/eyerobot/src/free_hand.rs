//! The component `free_hand`: a tool without a robot, in a hand that trembles.
//!
//! Invariant: the tip is a pure function of seed and time; its twist is the derivative of its position.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_phantom::Hand;
use trocar_sdk::data::{CartesianState, Pose, Twist, Wrench};
use trocar_sdk::prelude::*;

/// Half of the time over which a velocity is a difference of places, s: short against a period of the tremor.
const HALF_S: f64 = 1e-4;

#[derive(Config)]
struct FreeHandConfig {
    /// Seed of the simulated hand
    #[config(default = 1)]
    seed: u64,
    /// Height above the origin of the simulated world at which the hand means to keep the tip
    #[config(min = 0.0, max = 0.1, unit = "m", default = 0.001)]
    height_m: f64,
    /// Length of the line along x that the hand means to go to and fro, its middle above the origin
    #[config(live, min = 0.0, max = 0.02, unit = "m", default = 0.003)]
    line_m: f64,
    /// Time to go to and fro once
    #[config(min = 0.1, max = 1000.0, unit = "s", default = 12.0)]
    period_s: f64,
    /// Roll of the tool in the hand; roll and tilt as the joints of eyerobot at home
    #[config(live, min = -3.14, max = 3.14, unit = "rad", default = 0.0)]
    roll_rad: f64,
    /// Angle between the tool and the axis of the eye
    #[config(live, min = -1.0, max = 1.0, unit = "rad", default = 0.0)]
    tilt_rad: f64,
    /// Share of a hand's tremor (182 µm RMS) that this one has
    #[config(live, min = 0.0, max = 10.0, default = 1.0)]
    tremor: f64,
}

/// A simulated hand that holds the tool itself: the baseline without a robot. It goes to and fro along a
/// line, and trembles.
#[derive(Component)]
#[component(
    rate_hz = 1000,
    models("periodic", "exec_in", "exec_out"),
    rates_hz(100, 8000),
    safety = "sensor",
    provides("truth")
)]
pub struct FreeHand {
    /// True pose and twist of the tip in the simulated world
    #[output(tag = "sim")]
    tip: Out<CartesianState>,
    #[state]
    truth: CartesianState,
    #[config]
    cfg: FreeHandConfig,
    hand: Option<Hand>,
}

/// True values; for recorders, plots and tests.
#[provides("truth", tag = "truth")]
impl FreeHand {
    /// Pose of the tip in the simulated world.
    #[read]
    fn measured_cp(s: &FreeHandState) -> Pose {
        s.truth.pose
    }
}

impl FreeHandConfig {
    /// Returns the orientation of the tool, as a quaternion x, y, z, w.
    fn orientation(&self) -> [f64; 4] {
        let (roll, tilt) = (Vector3::z() * self.roll_rad, Vector3::x() * self.tilt_rad);
        (UnitQuaternion::new(roll) * UnitQuaternion::new(tilt)).coords.into()
    }

    /// Returns the position of the tip, m.
    fn position_m(&self, hand: &Hand, t_s: f64) -> Vector3<f64> {
        let meant = Vector3::new(0.5 * self.line_m * (TAU * t_s / self.period_s).sin(), 0.0, -self.height_m);
        meant + self.tremor * hand.tremor_m(t_s)
    }
}

impl Component for FreeHand {
    fn configure(&mut self) -> Result {
        self.hand = Some(Hand::new(self.cfg.seed));
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let Some(hand) = &self.hand else { return Ok(()) };
        let (stamp, t_s) = (tick.now(), tick.now().ns() as f64 * 1e-9);
        let at = |t_s| self.cfg.position_m(hand, t_s);
        let linear = (at(t_s + HALF_S) - at(t_s - HALF_S)) / (2.0 * HALF_S);
        self.truth = CartesianState {
            stamp,
            pose: Pose { stamp, position: at(t_s).into(), orientation: self.cfg.orientation() },
            twist: Twist { stamp, linear: linear.into(), angular: [0.0; 3] },
            wrench: Wrench::default(),
        };
        self.tip.write(&self.truth);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trocar_sdk::testing::Bench;

    fn tips(config: &str, steps: u64) -> Vec<CartesianState> {
        let mut bench = Bench::<FreeHand>::new(config);
        bench.step(steps);
        bench.samples::<CartesianState>("tip").into_iter().map(|(tip, _)| tip).collect()
    }

    #[test]
    fn a_hand_that_stands_trembles_with_182_micrometres() {
        for seed in 1..=20 {
            let tips = tips(&format!(r#"{{"seed": {seed}, "line_m": 0}}"#), 10_000);
            let square = |tip: &CartesianState| {
                let [x, y, z] = tip.pose.position;
                x * x + y * y + (z + 1e-3) * (z + 1e-3)
            };
            let rms_m = (tips.iter().map(square).sum::<f64>() / tips.len() as f64).sqrt();
            assert!((rms_m / 182e-6 - 1.0).abs() < 0.1, "seed {seed}: {:.1} µm", 1e6 * rms_m);
        }
    }

    #[test]
    fn without_tremor_it_goes_to_and_fro_along_its_line_and_its_twist_is_its_derivative() {
        let tips = tips(r#"{"tremor": 0, "line_m": 0.004, "period_s": 4, "height_m": 0.002}"#, 4_000);
        let x = |tip: &CartesianState| tip.pose.position[0];
        let (least, most) = tips.iter().map(x).fold((0.0f64, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
        assert!((least + 0.002).abs() < 1e-8 && (most - 0.002).abs() < 1e-8, "{least} to {most}");
        for pair in tips.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            assert_eq!((a.pose.position[1], a.pose.position[2]), (0.0, -0.002));
            let mean = 0.5 * (a.twist.linear[0] + b.twist.linear[0]);
            assert!(((x(&b) - x(&a)) / 1e-3 - mean).abs() < 1e-8, "{a:?} {b:?}");
        }
    }

    #[test]
    fn the_tool_stands_as_a_robot_would_hold_it() {
        let tip = tips(r#"{"roll_rad": -0.785, "tilt_rad": 0.48}"#, 1).remove(0).pose;
        let axis = tip.isometry().unwrap().rotation * Vector3::z();
        let (roll, tilt) = ((-0.785f64).sin_cos(), 0.48f64.sin_cos());
        let wanted = Vector3::new(roll.0 * tilt.0, -roll.1 * tilt.0, tilt.1);
        assert!((axis - wanted).norm() < 1e-12, "{axis:?} instead of {wanted:?}");
        assert_eq!(tips("{}", 1)[0].pose.orientation, [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn equal_seeds_make_equal_hands() {
        assert_eq!(tips("{}", 500), tips("{}", 500));
        assert_ne!(tips(r#"{"seed": 2}"#, 500), tips("{}", 500));
    }
}
