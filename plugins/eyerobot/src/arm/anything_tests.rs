//! Any commands in any order, good ones and bad ones: conditions that hold for any client.
//!
//! Invariant: commands and values come from a seed; nothing here knows what a command should do.

use super::*;
use crate::fixture::{Fixture, Kind, STIFFNESS_PER_S, Stance};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

const DT: f64 = 1e-3;

struct Client {
    rng: fastrand::Rng,
}

impl Client {
    /// Mostly in [-scale, scale], sometimes far outside, sometimes no number.
    fn number(&mut self, scale: f64) -> f64 {
        match self.rng.u32(0..60) {
            0 => [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0, 1e300][self.rng.usize(0..5)],
            1 | 2 => 40.0 * scale * (self.rng.f64() - 0.5),
            _ => 2.0 * scale * (self.rng.f64() - 0.5),
        }
    }

    fn joints(&mut self, slide: f64, turn: f64) -> Vec<f64> {
        let count = if self.rng.u32(0..30) == 0 { self.rng.usize(0..9) } else { COUNT };
        (0..count).map(|i| self.number(if i < 3 { slide } else { turn })).collect()
    }

    fn twist(&mut self, first: f64, second: f64) -> Vector6<f64> {
        Vector6::from_fn(|i, _| self.number(if i < 3 { first } else { second }))
    }

    fn pose(&mut self, about: &Isometry3<f64>, far_m: f64) -> Isometry3<f64> {
        let by = self.twist(far_m, 0.2);
        let turn = UnitQuaternion::from_scaled_axis(by.fixed_rows::<3>(3).into_owned());
        Isometry3::from_parts(Translation3::new(by[0], by[1], by[2]), turn) * about
    }

    fn command(&mut self, arm: &mut Arm<SimulatedDrive>) {
        let (at, still) = (arm.setpoint_cp(), Isometry3::identity());
        let _ = match self.rng.u32(0..22) {
            0 => arm.servo_jp(&self.joints(0.02, 0.3)),
            1 => arm.servo_jr(&self.joints(0.002, 0.05)),
            2 => arm.servo_jv(&self.joints(0.01, 0.1)),
            3 => arm.servo_cp(&self.pose(&at, 0.005)),
            4 => arm.servo_cr(&self.pose(&still, 0.002)),
            5 | 6 => arm.servo_cv(&self.twist(0.005, 0.05)),
            7 | 8 => arm.servo_axis(&self.twist(0.005, 0.05)),
            9 => arm.follow(&self.twist(5.0, 0.3)),
            10 => arm.free(),
            11 => arm.interpolate_jp(&self.joints(0.02, 0.3)),
            12 => arm.interpolate_cp(&self.pose(&at, 0.005)),
            13 => arm.move_jp(&self.joints(0.02, 0.3)),
            14 => arm.move_jr(&self.joints(0.005, 0.1)),
            15 => arm.move_cp(&self.pose(&at, 0.005)),
            16 => arm.move_cr(&self.pose(&still, 0.005)),
            17 => {
                arm.feel(&Vector6::from_fn(|i, _| (self.rng.f64() - 0.5) * if i < 3 { 8.0 } else { 0.2 }));
                Ok(())
            }
            18 => arm.set_gain(&self.twist(0.004, 5.0).abs()),
            19 => {
                arm.hold();
                Ok(())
            }
            _ => {
                let words = ["enable", "disable", "pause", "resume", "home", "unhome", "fly"];
                arm.state_command(words[self.rng.usize(0..words.len())])
            }
        };
        // Most of the time motions should be taken.
        if self.rng.u32(0..3) == 0 {
            for word in ["resume", "enable", "home"] {
                let wanted = word != "home" || !arm.operating().is_homed();
                let _ = wanted.then(|| arm.state_command(word));
            }
        }
    }
}

#[test]
fn whatever_is_sent_setpoints_keep_limits_speeds_and_the_plane_and_the_true_tip_stays_out() {
    let mut moved = 0.0;
    for seed in 0..20 {
        let mut client = Client { rng: fastrand::Rng::with_seed(seed) };
        let mut arm = Arm::default();
        for word in ["enable", "home"] {
            arm.state_command(word).expect("a new arm takes it");
        }
        arm.step(DT);
        let normal = Vector3::new(client.rng.f64() - 0.5, client.rng.f64() - 0.5, -1.0).normalize();
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let origin = arm.setpoint_cp().translation.vector - normal * 1e-3;
        let frame = Isometry3::from_parts(origin.into(), turn);
        let plane = Fixture { kind: Kind::Plane, frame, stiffness_per_s: STIFFNESS_PER_S };
        arm.set_fixtures([plane].iter()).expect("1 mm away");
        let kinematics = arm.settings().kinematics;
        let left = |q: &Joints| plane.distance_m(&Stance::of(&kinematics, q));
        let mut before = arm.setpoint().position;
        for n in 0..2_000 {
            if client.rng.u32(0..25) == 0 {
                client.command(&mut arm);
                // An arm that is switched off stands where its encoders are.
                before = arm.setpoint().position;
            }
            let reset = arm.operating().mode() != OperatingMode::ENABLED;
            arm.step(DT);
            let (limits, q) = (arm.settings().limits, arm.setpoint().position);
            for i in 0..COUNT {
                let outside = (q[i] - limits.upper[i]).max(limits.lower[i] - q[i]);
                assert!(outside <= 1e-6, "seed {seed} period {n} joint {i}: {q:?}");
                let way = (q[i] - before[i]).abs();
                // While the arm is not driven, its setpoint is where the encoders are.
                assert!(
                    reset || way <= limits.speed[i] * DT * (1.0 + 1e-6) + 1e-9,
                    "seed {seed} period {n}: {way}"
                );
            }
            moved += (q - before).norm();
            before = q;
            let (sent, real) = (left(&q), left(&arm.drive().truth().position));
            // If the drive has braked by itself, the setpoint is where the encoders are.
            assert!(sent > -5e-6, "seed {seed} period {n}: sent {sent:e} m beyond the plane");
            assert!(real > -10e-6, "seed {seed} period {n}: {real:e} m beyond the plane");
        }
    }
    assert!(moved > 0.5, "the arms moved {moved} m and rad together: too little to say anything");
}
