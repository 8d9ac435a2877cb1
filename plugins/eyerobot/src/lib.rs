//! A simulated five-joint eye robot behind a CRTK interface; its `Drive` trait is the slot for a real one.
//!
//! Invariant: every goal passes `joints::Limits` before the arm sees it, and the arm alone commands the drive.

pub mod arm;
pub mod crtk;
pub mod drive;
pub mod joints;
pub mod kinematics;
pub mod trajectory;
