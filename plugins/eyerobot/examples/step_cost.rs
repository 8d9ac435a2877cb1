//! Prints what one control period of the arm costs, in each kind of motion: `cargo run --release --example
//! step_cost`.
//!
//! Invariant: wall time of this process alone; says nothing of a host.

use std::time::Instant;

use nalgebra::{Isometry3, Vector6};
use trocar_eyerobot::arm::Arm;
use trocar_eyerobot::drive::SimulatedDrive;
use trocar_eyerobot::fixture::{Fixture, Kind, STIFFNESS_PER_S};

const PERIODS: u32 = 20_000;

fn main() {
    let twist = Vector6::new(0.004, 0.002, 0.006, 0.01, 0.0, 0.0);
    for (name, fixtures) in
        [("no fixture", &[][..]), ("plane", &[Kind::Plane]), ("plane and rcm", &[Kind::Plane, Kind::Rcm])]
    {
        for (motion, by_twist) in [("servo_jp", false), ("servo_cv", true)] {
            let mut arm = ready();
            let tip = arm.local_cp();
            let fixtures: Vec<Fixture> = fixtures.iter().map(|&kind| fixture(kind, &tip)).collect();
            arm.set_fixtures(fixtures.iter()).expect("the arm stands inside");
            let mut slowest_us = 0.0_f64;
            let begin = Instant::now();
            for n in 0..PERIODS {
                let side = if n / 500 % 2 == 0 { 1.0 } else { -1.0 };
                let one = Instant::now();
                if by_twist {
                    arm.servo_cv(&(twist * side)).expect("slow enough");
                } else {
                    arm.servo_jp(&[0.004 * side, 0.0, 0.001 * side, 0.0, 0.1]).expect("inside the limits");
                }
                arm.step(1e-3);
                slowest_us = slowest_us.max(one.elapsed().as_secs_f64() * 1e6);
            }
            let mean_us = begin.elapsed().as_secs_f64() * 1e6 / f64::from(PERIODS);
            println!("{motion}, {name}: {mean_us:.2} µs a period, slowest {slowest_us:.1} µs");
        }
    }
}

fn ready() -> Arm<SimulatedDrive> {
    let mut arm = Arm::default();
    for word in ["enable", "home"] {
        arm.state_command(word).expect("a new arm takes it");
    }
    arm.step(1e-3);
    arm
}

fn fixture(kind: Kind, tip: &Isometry3<f64>) -> Fixture {
    let beside = match kind {
        Kind::Plane => Isometry3::translation(0.0, 0.0, -0.2e-3),
        Kind::Line => Isometry3::identity(),
        Kind::Rcm => Isometry3::translation(0.0, 0.0, -22e-3),
    };
    Fixture { kind, frame: tip * beside, stiffness_per_s: STIFFNESS_PER_S }
}
