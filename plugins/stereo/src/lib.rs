//! Stereo image sources. `image_source`: pairs of picture files at a set rate. `phantom_source`: pairs of the
//! simulated eye. `pipe_source`: raw frames of a child process. `camera`: a camera of this machine.
//!
//! Invariant: files are read and decoded when a source is configured, devices are opened when it starts; a
//! step only hands on.
#![forbid(unsafe_code)]

mod ahead;
mod camera;
mod child;
mod feed;
mod image_source;
mod layout;
mod live;
mod mosaic;
pub mod pairs;
mod phantom_source;
mod pipe_source;
mod scenery;
mod v4l2;
#[cfg(test)]
#[path = "../../../tests/src/watchdog.rs"]
#[allow(unreachable_pub, reason = "it is public where it lies")]
mod watchdog;

pub use camera::Camera;
pub use image_source::ImageSource;
pub use live::Sent;
pub use phantom_source::PhantomSource;
pub use pipe_source::PipeSource;
pub use scenery::StereoGeometry;

trocar_sdk::trocar_plugin!(ImageSource, PhantomSource, PipeSource, Camera);
