//! The component classes of this plugin, one file each, and what they share.
//!
//! Invariant: a frame that a filter cannot take is counted and left out; it never stops the filter.

mod gray;
mod pair;
mod pip;
mod resize;
#[cfg(test)]
mod tests;

pub use gray::Gray;
pub use pair::Tally;
pub use pip::Pip;
pub use resize::Resize;

/// Most frames taken in one step, so that a fast source cannot hold a step for ever.
const BURST: usize = 8;
/// Frames of an output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 6;
