//! Stereo image sources. `image_source`: pairs of picture files at a set rate.
//!
//! Invariant: files are read and decoded when a source is configured, never while it runs.

pub mod pairs;
