//! Conditions for a sample to be taken: numbers that something can measure, poses that are poses, stamps that
//! are not ahead.
//!
//! Invariant: samples that pass here keep every filter of this plugin finite, whatever its settings: products
//! of three such numbers with the largest setting are finite.
use nalgebra::Isometry3;
use trocar_sdk::data::Pose;
use trocar_sdk::prelude::*;

/// Largest number that is taken, in any unit: nothing is measured beyond it.
pub(crate) const LARGEST: f64 = 1e100;

/// Most that a stamp may lie ahead of the step that takes it, s: a source that predicts stamps what it
/// predicts.
const AHEAD_S: f64 = 1.0;

/// A number that something can have measured.
pub(crate) fn number(n: f64) -> bool {
    // Not a number is not below anything.
    n.abs() <= LARGEST
}

/// The pose as an isometry; none when it is no pose.
pub(crate) fn pose(pose: &Pose) -> Option<Isometry3<f64>> {
    pose.isometry().ok().filter(|pose| pose.translation.vector.iter().all(|n| number(*n)))
}

/// A stamp of the past, or hardly ahead: one from far ahead would make all that follow it late.
pub(crate) fn stamp(stamp: Stamp, now: Stamp) -> bool {
    stamp.is_valid() && !stamp.is_ahead_of(now, AHEAD_S)
}
