//! A simulated five-joint eye robot behind a CRTK interface, clients that move it or let a hand lead it, and
//! a hand without it.
//!
//! Invariant: every goal passes `joints::Limits` before the arm sees it, and the arm alone commands the
//! drive, whose `Drive` trait is the slot for a real one.
#![forbid(unsafe_code)]

pub mod admittance;
pub mod allowed;
pub mod arm;
mod cooperative;
pub mod drive;
pub mod fixture;
mod free_hand;
mod joint_mover;
pub mod joints;
pub mod kinematics;
pub mod least_squares;
mod payloads;
mod robot;
pub mod trajectory;

pub use cooperative::Cooperative;
pub use free_hand::FreeHand;
pub use joint_mover::JointMover;
pub use payloads::{Jacobian, VirtualFixtures};
pub use robot::EyeRobot;
pub use trocar_sdk::data::{FixtureKind, VirtualFixture};

#[cfg(test)]
mod finite_tests;
#[cfg(test)]
mod plant_tests;

trocar_sdk::trocar_plugin!(EyeRobot, JointMover, Cooperative, FreeHand);
