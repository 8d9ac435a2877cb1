//! Connections as between machines: encrypted lines over TCP, beside bare TCP between two processes.
//!
//! Invariant: both ends are processes of their own on one machine, so that one clock times the way; what a
//! network adds is the same for both.

pub(crate) mod bare;
mod beside;
mod samples;
mod site;

use crate::table::Table;

pub(crate) use beside::INSIDE;

pub(crate) fn measure(subject: &str, table: &mut Table) {
    match subject {
        "machines/samples" => samples::measure(table),
        _ => beside::measure(table),
    }
}

pub(crate) fn run_inside() {
    beside::run_inside(&mut Table);
}
