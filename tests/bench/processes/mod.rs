//! Connections between two processes of one machine: what they cost, and how soon they stand, are lost, and
//! stand again.
//!
//! Invariant: both ends are processes of their own; times of samples are taken inside the components, and the
//! bare baseline is two processes, too.

pub(crate) mod allocations;
pub(crate) mod bare;
mod calls;
mod control;
mod peers;
mod restored;
mod site;
mod streams;

use crate::table::Table;
pub(crate) use site::{periodic, round, ways};

pub(crate) fn measure(subject: &str, table: &mut Table) {
    match subject {
        "processes/samples" => streams::measure(table),
        "processes/calls" => calls::measure(table),
        "processes/links" => control::measure(table),
        "processes/crash" => restored::measure(table),
        _ => allocations::measure(table),
    }
}
