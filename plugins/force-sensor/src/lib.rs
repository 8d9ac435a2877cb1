//! A simulated force sensor in the tool: what the retina does to its tip, or the sclera to its shaft.
//!
//! Invariant: forces are those of the shared world (`trocar_phantom`); this crate adds the sensor, its errors
//! and range.
#![forbid(unsafe_code)]

mod gauge;
mod sensor;

pub use sensor::ForceSensor;

trocar_sdk::trocar_plugin!(ForceSensor);
