//! Time of periodic work: the grid of deadlines and the statistics of the real cycles.

mod cycle;
mod grid;
mod histogram;

pub use cycle::{CycleSnapshot, CycleStats, Spread};
pub use grid::{Due, Grid};
pub use histogram::Histogram;
