//! Stereo image sources. `image_source`: pairs of picture files at a set rate.
//!
//! Invariant: files are read and decoded when a source is configured, never while it runs.
#![forbid(unsafe_code)]

mod image_source;
pub mod pairs;

pub use image_source::ImageSource;

trocar_sdk::trocar_plugin!(ImageSource);
