//! The simulated eye that all simulated devices share: shape, tissue, motion, picture.
//!
//! Invariant: every function is pure in seed, time, pose and number, so each plugin may hold a copy of its
//! own and all see one world. Units are SI, z points down into the eye, the nominal apex of the retina is the
//! origin. All of it is simulation: no figure taken here is a result of hardware.
#![forbid(unsafe_code)]

mod backdrop;
pub mod camera;
mod defocus;
pub mod eye;
mod field;
pub mod forces;
mod glints;
pub mod grain;
pub mod hand;
mod lamp;
pub mod motion;
pub mod noise;
mod phasor;
pub mod render;
pub mod retina;
mod rows;
mod scenery;
pub mod sensor;
mod shade;
mod shadow;
mod spans;
pub mod spectra;
mod steel;
pub mod tissue;
mod tool;
mod world;

pub use hand::Hand;
pub use lamp::Lamp;
pub use world::{Below, World};
