//! Recordings: made by a recorder component, read here.
//!
//! Invariant: what a file says is a stranger's word: lengths, names and numbers in it are checked before they are used.

pub(super) mod columns;
pub(super) mod export;
pub(super) mod info;
mod npz;
mod pictures;
mod read;
pub(super) mod record;
mod records;
mod select;
