//! Common parts of the component's tests: a hand that pushes, words, and the true tip.
//!
//! Invariant: judged against the true tip, in virtual time, with fixed seeds. All of it is simulation.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{JointState, OperatingState, Pose, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use super::EyeRobot;

pub(super) const DT: f64 = 1e-3;

pub(super) fn joints(position: [f64; 5]) -> JointState {
    JointState { position: List::of(&position), ..Default::default() }
}

pub(super) fn force(force: [f64; 3]) -> Wrench {
    Wrench { force, ..Wrench::default() }
}

/// Steps with this force on the handle, told anew in each.
pub(super) fn push(bench: &mut Bench<EyeRobot>, newton: [f64; 3], steps: u32) {
    for _ in 0..steps {
        bench.push("handle", Wrench { stamp: bench.now(), ..force(newton) });
        bench.step(1);
    }
}

pub(super) fn say(bench: &mut Bench<EyeRobot>, word: &str) -> bool {
    bench.command::<Text<32>, ()>("state_command", word.into()).is_ok()
}

pub(super) fn operating(bench: &Bench<EyeRobot>) -> OperatingState {
    bench.read("arm/operating_state", ()).unwrap()
}

pub(super) fn true_tip(bench: &Bench<EyeRobot>) -> [f64; 3] {
    bench.read::<(), Pose>("truth/measured_cp", ()).unwrap().position
}
