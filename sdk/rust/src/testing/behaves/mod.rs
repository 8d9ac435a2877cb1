//! Checks of a standard device's behaviour, beside its members: the rules of its contract, on the bench.
//!
//! Invariant: a check for each rule a bench can see, in the order of the contract; a failure quotes the rule
//! it breaks.

mod arm;
mod camera;

pub use arm::assert_behaves_as_arm;
pub use camera::{assert_behaves_as_camera, assert_behaves_as_camera_fed};
