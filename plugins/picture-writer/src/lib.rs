//! `picture-writer`: what a system shows, as PNG files: the newest frame of a video, and plots of numbers
//! over time.
//!
//! Invariant: the step copies nothing and opens nothing; pictures are made and files written by a thread for
//! that one file.
#![forbid(unsafe_code)]

mod canvas;
mod chart;
mod depth_map;
mod file;
mod picture_writer;
mod plot;
mod saving;
mod traces;

pub use file::{SaveRequest, SavedPicture};
pub use picture_writer::PictureWriter;
pub use plot::Plot;

trocar_sdk::trocar_plugin!(PictureWriter, Plot);

#[cfg(test)]
trocar_sdk::testing::count_allocations!();
