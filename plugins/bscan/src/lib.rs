//! Robot-Assisted B-Scan: the tip goes along a line at a constant distance from a retina that moves, and an
//! image grows.
//!
//! Invariant: `depth`, `line` and `image` decide and compute; the component `bscan` alone commands the robot;
//! `mscan` and `flatten` command nobody.
#![forbid(unsafe_code)]

pub mod ascans;
mod bscan;
pub mod depth;
#[cfg(test)]
mod finite_tests;
mod flatten;
pub mod image;
mod layer;
pub mod line;
mod mscan;
pub mod past;
mod payloads;
#[cfg(test)]
mod rig;
mod sending;
pub mod taken;

pub use bscan::BScan;
pub use flatten::Flatten;
pub use mscan::MScan;
pub use payloads::{Phase, Progress, ScanColumn, ScanDone, ScanRequest};

trocar_sdk::trocar_plugin!(BScan, MScan, Flatten);
