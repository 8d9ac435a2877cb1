//! The rows there are, in the order of the matrix; each group in a file of its own.
//!
//! Invariant: a name is the number of the matrix, or a word where the matrix has none, and stays what it was.

mod components;
mod crashes;
mod damage;
mod data;
mod deciding;
mod graph;
mod machine;
mod managers;
mod names;
mod plugins;
mod processes;
mod racing;
mod requests;
mod scale;
mod sizes;
mod takeover;
mod together;

use crate::run::Row;

/// Groups of rows.
const GROUPS: &[&[Row]] = &[
    processes::ROWS,
    managers::ROWS,
    names::ROWS,
    components::ROWS,
    crashes::ROWS,
    plugins::ROWS,
    graph::ROWS,
    racing::ROWS,
    deciding::ROWS,
    requests::ROWS,
    together::ROWS,
    takeover::ROWS,
    scale::ROWS,
    damage::ROWS,
    data::ROWS,
    sizes::ROWS,
    machine::ROWS,
];

/// In the order of the matrix; those without a number come last.
pub(crate) fn all() -> Vec<&'static Row> {
    let mut all: Vec<&Row> = GROUPS.iter().copied().flatten().collect();
    all.sort_by_key(|row| row.name.parse().unwrap_or(u32::MAX));
    all
}

/// What names a row.
pub(crate) fn named(name: &str) -> bool {
    all().iter().any(|row| row.name == name)
}
