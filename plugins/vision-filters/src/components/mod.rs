//! The component classes of this plugin, one file each, and what they share.
//!
//! Invariant: a frame that a filter cannot take is counted and left out; it never stops the filter.

mod color;
mod crop;
mod debayer;
mod exposure;
mod flip;
mod gray;
mod in_place;
mod inset;
mod overlay;
mod overlay_items;
mod pair;
mod pip;
mod rectify;
mod resize;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_of_changes;
#[cfg(test)]
mod tests_of_insets;
#[cfg(test)]
mod tests_of_lies;

pub use color::Color;
pub use crop::Crop;
pub use debayer::Debayer;
pub use exposure::Exposure;
pub use flip::Flip;
pub use gray::Gray;
pub use overlay::Overlay;
pub use overlay_items::{Eye, OverlayLine, OverlayPicture, OverlayText};
pub use pair::Tally;
pub use pip::{Pip, PipRect};
pub use rectify::{RectifiedGeometry, Rectify};
pub use resize::Resize;

/// Most frames taken in one step, so that a fast source cannot hold a step for ever.
const BURST: usize = 8;
/// Frames of an output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 6;
