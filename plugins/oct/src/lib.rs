//! Optical coherence tomography. `oct_source` simulates a spectrometer over the phantom, `oct_file` plays raw
//! spectra, `oct_processor` makes A-scans of them, `surface_tracker` follows the surface in these.
//!
//! Invariant: every spectrum of `oct_source` is simulated, and its doc says so; `trocar-oct-core` does the
//! computations, the components move data and settings.
#![forbid(unsafe_code)]

mod file;
mod pace;
mod payloads;
mod processor;
pub mod raw;
mod source;
mod tracker;
#[cfg(test)]
mod whole_tests;

pub use file::OctFile;
pub use payloads::{DispersionFound, DispersionTerms, RangeDb};
pub use processor::OctProcessor;
pub use source::OctSource;
pub use tracker::SurfaceTracker;

trocar_sdk::trocar_plugin!(OctSource, OctFile, OctProcessor, SurfaceTracker);
