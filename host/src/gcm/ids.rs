//! Numbers that are never reused: the term of this GCM and the epochs of processes, durable when there is a
//! state folder.
//!
//! Invariant: where the last count cannot be read, the count goes on from the time of day in seconds, which a
//! count from 0 does not reach.

use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Default, Serialize, Deserialize)]
struct Kept {
    term: u64,
    next_epoch: u64,
}

impl Kept {
    fn by_time() -> Kept {
        let s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        Kept { term: s, next_epoch: s }
    }
}

/// No process has counted so far ahead of its GCM.
const AHEAD: u64 = 1 << 32;

/// Epochs of one term, where terms are given out elsewhere.
const EPOCHS: u64 = 1 << 32;

pub(super) struct Ids {
    file: Option<PathBuf>,
    kept: Mutex<Kept>,
}

impl Ids {
    /// Begins a new term.
    pub(super) fn open(state: Option<&Path>) -> Ids {
        let file = state.map(|s| s.join("gcm.json"));
        let kept = file.as_deref().map_or_else(Kept::default, read);
        let ids = Ids { file, kept: Mutex::new(kept) };
        ids.count(|kept| kept.term += 1);
        ids
    }

    /// Numbers of a term that no other GCM has: its epochs are its own, too.
    pub(super) fn of_term(term: u64) -> Ids {
        let next_epoch = term.saturating_mul(EPOCHS);
        Ids { file: None, kept: Mutex::new(Kept { term, next_epoch }) }
    }

    pub(super) fn term(&self) -> u64 {
        self.kept.lock().term
    }

    /// Returns a number no process had before; on the disk before it is given out, where that can be written.
    pub(super) fn next_epoch(&self) -> u64 {
        self.count(|kept| kept.next_epoch += 1).next_epoch
    }

    /// Tells whether some GCM may have given this number out; otherwise a caller made it up, and counting on
    /// from it would soon end.
    pub(super) fn may_be(&self, epoch: u64) -> bool {
        let kept = self.kept.lock();
        epoch != 0 && epoch <= kept.next_epoch.saturating_add(AHEAD)
    }

    /// A number that was given out before, by this GCM or one before it, and is kept from now on, too.
    pub(super) fn not_below(&self, epoch: u64) -> u64 {
        if self.kept.lock().next_epoch < epoch {
            self.count(|kept| kept.next_epoch = kept.next_epoch.max(epoch));
        }
        epoch
    }

    /// Goes on from numbers that are on record elsewhere.
    pub(super) fn goes_on_from(&self, term: u64, epoch: u64) {
        let Kept { term: mine, next_epoch } = *self.kept.lock();
        if mine <= term || next_epoch < epoch {
            self.count(|kept| {
                kept.term = kept.term.max(term + 1);
                kept.next_epoch = kept.next_epoch.max(epoch);
            });
        }
    }

    /// Counts on. Where that cannot be made durable, it goes on from the time of day, which the next GCM does
    /// not come to before it is later.
    fn count(&self, on: impl Fn(&mut Kept)) -> Kept {
        let mut kept = self.kept.lock();
        on(&mut kept);
        let Some(file) = &self.file else { return *kept };
        if let Err(error) = write(file, *kept) {
            let by_time = Kept::by_time();
            if kept.next_epoch < by_time.next_epoch {
                log::error!(
                    "{} cannot be written: {error}; numbers go on from {}",
                    file.display(),
                    by_time.term
                );
                *kept = Kept { term: kept.term.max(by_time.term), next_epoch: by_time.next_epoch };
            }
        }
        *kept
    }
}

fn read(file: &Path) -> Kept {
    let damaged = |error: &dyn fmt::Display| {
        let kept = Kept::by_time();
        let (file, term) = (file.display(), kept.term);
        log::warn!(
            "{file} cannot be read ({error}), perhaps the disk was full: the count goes on from {term}"
        );
        kept
    };
    match fs::read(file) {
        Ok(text) => serde_json::from_slice(&text).unwrap_or_else(|error| damaged(&error)),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Kept::default(),
        Err(error) => damaged(&error),
    }
}

fn write(file: &Path, kept: Kept) -> io::Result<()> {
    let temporary = file.with_extension("json.new");
    let text = serde_json::to_vec(&kept).map_err(io::Error::other)?;
    let place = file.parent().unwrap_or(Path::new("."));
    // The state directory may have been emptied.
    fs::DirBuilder::new().recursive(true).mode(0o700).create(place)?;
    let mut new = fs::File::create(&temporary)?;
    // The file is whole on the disk before it takes the other's place.
    new.write_all(&text)?;
    new.sync_data()?;
    fs::rename(&temporary, file)?;
    fs::File::open(place)?.sync_all()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn numbers_go_on_where_the_file_is_damaged_and_none_is_given_twice() {
        let state = tempfile::tempdir().unwrap();
        let first = Ids::open(Some(state.path()));
        let (term, epoch) = (first.term(), first.next_epoch());
        drop(first);
        for damage in ["", "{", "{}", "\0\0\0\0"] {
            fs::write(state.path().join("gcm.json"), damage).unwrap();
            let then = Ids::open(Some(state.path()));
            assert!(then.term() > term && then.next_epoch() > epoch, "after {damage:?}");
        }
    }

    #[test]
    fn a_term_has_epochs_of_its_own_and_knows_those_of_earlier_ones() {
        let (first, next) = (Ids::of_term(3), Ids::of_term(4));
        let (early, late) = (first.next_epoch(), next.next_epoch());
        assert!(early < late && first.next_epoch() < late);
        assert!(next.may_be(early) && next.not_below(early) == early);
        assert_eq!(next.next_epoch(), late + 1);
    }

    #[test]
    fn a_number_that_nobody_gave_out_is_not_counted_on_from() {
        let ids = Ids::open(None);
        assert!(!ids.may_be(0) && !ids.may_be(u64::MAX) && !ids.may_be(1 << 40));
        let by_time = Kept::by_time().next_epoch;
        assert!(ids.may_be(by_time), "one that a GCM with a damaged file gave out");
        ids.not_below(by_time);
        assert_eq!(ids.next_epoch(), by_time + 1);
    }
}
