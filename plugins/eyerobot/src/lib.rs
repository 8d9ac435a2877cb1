//! A simulated five-joint eye robot behind a CRTK interface, and a client that moves it.
//!
//! Invariant: every goal passes `joints::Limits` before the arm sees it, and the arm alone commands the drive, whose
//! `Drive` trait is the slot for a real one.
#![forbid(unsafe_code)]

pub mod arm;
pub mod drive;
mod joint_mover;
pub mod joints;
pub mod kinematics;
pub mod least_squares;
mod payloads;
mod robot;
pub mod trajectory;

pub use joint_mover::JointMover;
pub use robot::{EyeRobot, PoseRefused};

trocar_sdk::trocar_plugin!(EyeRobot, JointMover);
