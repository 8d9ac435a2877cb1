//! Computations of the OCT plugins, without a component: from raw spectra to A-scans, from these to the
//! surface, and from surface and robot to the next millisecond.
//!
//! Invariant: buffers are made when a thing is made or set up; code that runs per line allocates nothing and
//! takes no lock.
#![forbid(unsafe_code)]

pub mod background;
pub mod chain;
pub mod decibel;
pub mod dispersion;
pub mod grid;
pub mod kalman;
pub mod search;
pub mod surface;
pub mod tip;
pub mod tracker;
