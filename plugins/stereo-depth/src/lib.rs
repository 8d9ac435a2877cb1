//! Depth from rectified stereo pairs: block matching and semi-global matching, and the component
//! `stereo_depth`.
//!
//! Invariant: disparities are the same bytes whichever instructions the processor has.
#![deny(unsafe_code)]

mod block_matching;
mod census;
mod component;
mod consistency;
mod dark;
mod disparity;
mod matcher;
#[cfg(test)]
mod phantom_tests;
mod prefilter;
mod rows;
mod semi_global;
mod settings;
mod simd;
#[cfg(target_arch = "x86_64")]
mod wide;

pub use component::{Pixel, StereoDepth};
pub use disparity::{Depth, NONE, SCALE};
pub use matcher::Matcher;
pub use settings::{BadSettings, Method, Settings};

trocar_sdk::trocar_plugin!(StereoDepth);
