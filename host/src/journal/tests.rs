//! The journal: what is written comes back, and what is damaged is refused.

#![allow(clippy::unwrap_used)]

mod anew;
pub(super) mod conformance;
mod damage;
mod golden;
pub(super) mod kinds;
mod storing;

use std::path::Path;

use trocar_model::Wanted;

use super::RedbStore;
use crate::gcm::{Loaded, Store};

/// The fold of all that was loaded.
pub(super) fn fold(loaded: &Loaded) -> Wanted {
    let mut wanted = loaded.snapshot.wanted.clone();
    for record in &loaded.records {
        wanted.on(&record.entry);
        wanted.term = wanted.term.max(record.term);
    }
    wanted
}

fn loaded(dir: &Path) -> Loaded {
    RedbStore::new(dir).load().unwrap()
}

/// All of a value that can be compared.
pub(super) fn said(value: &impl std::fmt::Debug) -> String {
    format!("{value:#?}")
}
