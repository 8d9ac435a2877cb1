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

/// The file could not be read or written.
#[derive(Debug)]
pub struct IdsError {
    file: PathBuf,
    error: io::Error,
}

impl fmt::Display for IdsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} cannot be used: {}; choose another folder with --state, or make this one writable",
            self.file.display(),
            self.error
        )
    }
}

impl std::error::Error for IdsError {}

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

pub(super) struct Ids {
    file: Option<PathBuf>,
    kept: Mutex<Kept>,
}

impl Ids {
    /// Begins a new term.
    pub(super) fn open(state: Option<&Path>) -> Result<Ids, IdsError> {
        let file = state.map(|s| s.join("gcm.json"));
        let mut kept = Kept::default();
        if let Some(file) = &file {
            kept = match fs::read(file) {
                Ok(text) => serde_json::from_slice(&text).unwrap_or_else(|error| {
                    let kept = Kept::by_time();
                    let (file, term) = (file.display(), kept.term);
                    log::warn!("{file} is damaged ({error}), perhaps the disk was full: the count goes on from {term}");
                    kept
                }),
                Err(e) if e.kind() == io::ErrorKind::NotFound => Kept::default(),
                Err(error) => return Err(IdsError { file: file.clone(), error }),
            };
        }
        kept.term += 1;
        let ids = Ids { file, kept: Mutex::new(kept) };
        ids.write(kept)?;
        Ok(ids)
    }

    pub(super) fn term(&self) -> u64 {
        self.kept.lock().term
    }

    /// A number no process had before; on the disk before it is given out.
    pub(super) fn next_epoch(&self) -> Result<u64, IdsError> {
        let mut kept = self.kept.lock();
        let next = Kept { next_epoch: kept.next_epoch + 1, ..*kept };
        self.write(next)?;
        *kept = next;
        Ok(next.next_epoch)
    }

    /// Tells whether some GCM may have given this number out; otherwise a caller made it up, and counting on
    /// from it would soon end.
    pub(super) fn may_be(&self, epoch: u64) -> bool {
        let kept = self.kept.lock();
        epoch != 0 && epoch <= kept.next_epoch.saturating_add(AHEAD)
    }

    /// A number that was given out before, by this GCM or one before it, and is kept from now on, too.
    pub(super) fn not_below(&self, epoch: u64) -> Result<u64, IdsError> {
        let mut kept = self.kept.lock();
        if kept.next_epoch < epoch {
            let next = Kept { next_epoch: epoch, ..*kept };
            self.write(next)?;
            *kept = next;
        }
        Ok(epoch)
    }

    fn write(&self, kept: Kept) -> Result<(), IdsError> {
        let Some(file) = &self.file else { return Ok(()) };
        let temporary = file.with_extension("json.new");
        let done = serde_json::to_vec(&kept)
            .map_err(io::Error::other)
            .and_then(|text| {
                // The state directory may have been emptied.
                if let Some(place) = file.parent() {
                    fs::DirBuilder::new().recursive(true).mode(0o700).create(place)?;
                }
                let mut new = fs::File::create(&temporary)?;
                // The file is whole on the disk before it takes the other's place.
                new.write_all(&text).and_then(|()| new.sync_data())
            })
            .and_then(|()| fs::rename(&temporary, file));
        done.map_err(|error| IdsError { file: file.clone(), error })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn numbers_go_on_where_the_file_is_damaged_and_none_is_given_twice() {
        let state = tempfile::tempdir().unwrap();
        let first = Ids::open(Some(state.path())).unwrap();
        let (term, epoch) = (first.term(), first.next_epoch().unwrap());
        drop(first);
        for damage in ["", "{", "{}", "\0\0\0\0"] {
            fs::write(state.path().join("gcm.json"), damage).unwrap();
            let then = Ids::open(Some(state.path())).unwrap();
            assert!(then.term() > term && then.next_epoch().unwrap() > epoch, "after {damage:?}");
        }
    }

    #[test]
    fn a_number_that_nobody_gave_out_is_not_counted_on_from() {
        let ids = Ids::open(None).unwrap();
        assert!(!ids.may_be(0) && !ids.may_be(u64::MAX) && !ids.may_be(1 << 40));
        let by_time = Kept::by_time().next_epoch;
        assert!(ids.may_be(by_time), "one that a GCM with a damaged file gave out");
        ids.not_below(by_time).unwrap();
        assert_eq!(ids.next_epoch().unwrap(), by_time + 1);
    }
}
