//! Outputs: the slots through which samples and frames leave a component, and what stands behind them.
//!
//! Invariant: an output never waits for a reader; every write counts, read or not, so a gap at a reader is
//! the number of samples it missed.

mod cell;
mod link;
mod pools;
mod slots;

pub(crate) use cell::{OutCell, Shape};
pub(crate) use link::{Consumer, OUTSIDE, OutLink};
pub(super) use slots::{cancel, commit, forward, loan, reserve, type_of, write, write_bytes};
