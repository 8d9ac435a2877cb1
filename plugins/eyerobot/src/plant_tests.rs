//! The arm as plant of a distance controller: over a moving retina, with a distance as good as a sensor could
//! give.
//!
//! Invariant: purely modules, no component; the true tip is judged, seeds are fixed. It shows what arm and
//! drive leave of a perfect measurement: the sensor's part is tested where the sensor is.

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3, Vector6};
use trocar_phantom::World;

use crate::arm::{Arm, Settings};
use crate::drive::{SimulatedDrive, Simulation};
use crate::fixture::{Fixture, Kind, STIFFNESS_PER_S, Stance};
use crate::joints::Joints;

const DT: f64 = 1e-3;
const OFFSET_M: f64 = 500e-6;
/// The measurement is one period and a half old when it is used.
const LATENCY_S: f64 = 1.5e-3;
const GAIN_PER_S: f64 = 30.0;

struct Rig {
    arm: Arm<SimulatedDrive>,
    world: World,
    world_from_base: Isometry3<f64>,
    t_s: f64,
    /// Encoder positions of the tip, the newest last.
    measured: [Vector3<f64>; 3],
}

impl Rig {
    /// An arm with its tip at the offset above the retina, at `x`.
    fn new(world: World, seed: u64, x: f64) -> Rig {
        let (settings, home) = (Settings::default(), Joints::zeros());
        let drive = SimulatedDrive::new(Simulation { seed, ..Simulation::default() }, home);
        let mut arm = Arm::new(settings, drive, home);
        for word in ["enable", "home"] {
            arm.state_command(word).expect("a new arm takes it");
        }
        arm.step(DT);
        let z = world.surface_z(x, 0.0, 0.0) - OFFSET_M - settings.kinematics.tool_length_m;
        let world_from_base = Isometry3::translation(x, 0.0, z);
        let at = (world_from_base * arm.local_cp()).translation.vector;
        Rig { arm, world, world_from_base, t_s: 0.0, measured: [at; 3] }
    }

    fn true_tip(&self) -> Point3<f64> {
        let truth = self.arm.drive().truth().position;
        (self.world_from_base * self.arm.settings().kinematics.forward(&truth)).translation.vector.into()
    }

    /// Returns the true distance to the surface, minus the offset, m.
    fn error_m(&self, t_s: f64) -> f64 {
        let axis = UnitVector3::new_normalize(Vector3::z());
        self.world.below(&self.true_tip(), &axis, t_s).map_or(f64::NAN, |below| below.distance_m - OFFSET_M)
    }

    /// One period: proportional control and the velocity of the retina, along the tool; `aside` m/s along x.
    fn step(&mut self, aside: f64) -> f64 {
        let (now, then) = (self.measured[2], self.measured[1].lerp(&self.measured[0], 0.5));
        let seen = self.world.surface_z(then.x, then.y, self.t_s - LATENCY_S);
        let slope = (self.world.surface_z(then.x + aside * DT, then.y, self.t_s - LATENCY_S) - seen) / DT;
        let surface_m_s = self.world.velocity(self.t_s - LATENCY_S).z + slope;
        let error = seen + surface_m_s * LATENCY_S - now.z - OFFSET_M;
        let along = (GAIN_PER_S * error + surface_m_s).clamp(-0.008, 0.008);
        if aside != 0.0 {
            self.arm.servo_cv(&Vector6::new(aside, 0.0, 0.0, 0.0, 0.0, 0.0)).expect("slow");
        }
        self.arm.servo_axis(&Vector6::new(0.0, 0.0, along, 0.0, 0.0, 0.0)).expect("slow enough");
        self.arm.step(DT);
        self.t_s += DT;
        let at = (self.world_from_base * self.arm.local_cp()).translation.vector;
        self.measured = [self.measured[1], self.measured[2], at];
        self.error_m(self.t_s)
    }
}

fn world(name: &str, seed: u64) -> World {
    World::named(name, seed).expect("a name")
}

#[test]
fn with_a_perfect_distance_the_axis_keeps_the_offset_over_a_moving_retina_within_a_micrometre() {
    for seed in 0..20 {
        let mut rig = Rig::new(world("no_membrane", seed), seed, -0.3e-3);
        let (mut square, mut count) = (0.0, 0);
        for n in 0..1_200 {
            let error = rig.step(0.5e-3);
            if n >= 600 {
                (square, count) = (square + error * error, count + 1);
            }
        }
        let rms = (square / f64::from(count)).sqrt();
        assert!(rms < 1e-6, "seed {seed}: {rms:e} m");
    }
}

#[test]
fn after_a_step_of_the_eye_by_50_micrometres_the_tip_is_back_within_100_milliseconds() {
    let mut rig = Rig::new(world("static_no_membrane", 3).with_step(0.3, 50e-6), 3, 0.4e-3);
    let mut late_s = 0.0;
    for _ in 0..800 {
        let error = rig.step(0.0);
        if rig.t_s > 0.3 && error.abs() > 5e-6 {
            late_s = rig.t_s - 0.3;
        }
    }
    assert!((0.02..0.1).contains(&late_s), "{late_s} s");
}

#[test]
fn with_a_plane_no_controller_brings_the_tip_nearer_than_150_micrometres() {
    for seed in 0..20 {
        // The eye moves: the plane keeps its distance from the highest place that the retina comes to.
        let mut rig = Rig::new(world("default", seed), seed, 0.0);
        let highest = (0..400)
            .map(|n| rig.world.surface_z(5e-6 * f64::from(n) - 0.1e-3, 0.0, 10e-3 * f64::from(n)))
            .fold(f64::INFINITY, f64::min);
        let tip = rig.arm.local_cp().translation.vector;
        let origin = Vector3::new(tip.x, tip.y, tip.z + highest - 160e-6 - rig.true_tip().z);
        let upwards = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let frame = Isometry3::from_parts(origin.into(), upwards);
        let plane = Fixture { kind: Kind::Plane, frame, stiffness_per_s: STIFFNESS_PER_S };
        rig.arm.set_fixtures([plane].iter()).expect("the tip is above it");
        let mut nearest = f64::INFINITY;
        for _ in 0..500 {
            rig.arm.servo_cv(&Vector6::new(2e-3, 0.0, 0.0, 0.0, 0.0, 0.0)).expect("slow");
            rig.arm.servo_axis(&Vector6::new(0.0, 0.0, 0.01, 0.0, 0.0, 0.0)).expect("as fast as a slide");
            rig.arm.step(DT);
            rig.t_s += DT;
            nearest = nearest.min(rig.error_m(rig.t_s) + OFFSET_M);
        }
        assert!(nearest > 150e-6, "seed {seed}: {nearest:e} m");
        let left = origin.z - rig.arm.local_cp().translation.z;
        assert!(left < 5e-6, "seed {seed}: the controller pushes, yet {left:e} m are left to the plane");
    }
}

#[test]
fn under_a_remote_centre_the_true_shaft_follows_the_setpoint_within_5_micrometres() {
    for seed in 0..20 {
        let mut rig = Rig::new(world("static", seed), seed, 0.0);
        rig.arm.move_jp(&[0.0, 0.0, 0.0, 0.2, 0.3]).expect("inside the limits");
        while rig.arm.operating().is_busy() {
            rig.arm.step(DT);
        }
        // The arm is where it was sent within 0.1 mrad; the rest has gone after a tenth of a second.
        (0..100).for_each(|_| rig.arm.step(DT));
        let tip = rig.arm.setpoint_cp();
        let frame = tip * Isometry3::translation(0.0, 0.0, -22e-3);
        let centre = Fixture { kind: Kind::Rcm, frame, stiffness_per_s: STIFFNESS_PER_S };
        rig.arm.set_fixtures([centre].iter()).expect("on the shaft");
        let kinematics = rig.arm.settings().kinematics;
        let (mut worst, mut sent) = (0.0_f64, 0.0_f64);
        for n in 0..1_000 {
            let turn = 0.005 * f64::from(n) + seed as f64;
            let around = Vector6::new(2e-3 * turn.cos(), 2e-3 * turn.sin(), 0.0, 0.0, 0.0, 0.0);
            rig.arm.servo_cv(&around).expect("slow");
            rig.arm.step(DT);
            let beside = |q: &Joints| -centre.distance_m(&Stance::of(&kinematics, q));
            worst = worst.max(beside(&rig.arm.drive().truth().position));
            sent = sent.max(beside(&rig.arm.setpoint().position));
        }
        assert!(sent < 1e-6, "seed {seed}: the setpoint drifts {sent:e} m");
        assert!(worst < 5e-6, "seed {seed}: the shaft drifts {worst:e} m");
    }
}

#[test]
fn at_every_rate_it_is_made_for_the_arm_holds_still_and_arrives() {
    for rate_hz in [100.0, 125.0, 500.0, 1000.0, 8000.0] {
        let (dt_s, home) = (1.0 / rate_hz, Joints::zeros());
        let drive = SimulatedDrive::new(Simulation::default(), home);
        let mut arm = Arm::new(Settings::default(), drive, home);
        for word in ["enable", "home"] {
            arm.state_command(word).expect("a new arm takes it");
        }
        let strays = |arm: &mut Arm<SimulatedDrive>, around: &Joints, s: f64| {
            (0..(s * rate_hz) as u32).fold(0.0, |most: f64, _| {
                arm.step(dt_s);
                most.max((arm.drive().truth().position - around).amax())
            })
        };
        let most = strays(&mut arm, &home, 3.0);
        assert!(most < 5e-6, "{rate_hz} Hz: nobody asked for it, and it moved {most} m or rad");
        let goal = Joints::from_fn(|i, _| if i == 0 { 0.002 } else { 0.0 });
        arm.move_jp(goal.as_slice()).expect("it is near");
        strays(&mut arm, &goal, 2.0);
        let most = strays(&mut arm, &goal, 1.0);
        assert!(most < 5e-6, "{rate_hz} Hz: {most} m or rad from the goal");
    }
}
