//! Numbers that are never reused: the term of this GCM and the epochs of processes, durable when there is a state folder.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

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
                Ok(text) => serde_json::from_slice(&text)
                    .map_err(|e| IdsError { file: file.clone(), error: io::Error::other(e) })?,
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
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).term
    }

    /// A number no process had before; on the disk before it is given out.
    pub(super) fn next_epoch(&self) -> Result<u64, IdsError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let next = Kept { next_epoch: kept.next_epoch + 1, ..*kept };
        self.write(next)?;
        *kept = next;
        Ok(next.next_epoch)
    }

    /// A number that was given out before, by this GCM or one before it, and is kept from now on, too.
    pub(super) fn not_below(&self, epoch: u64) -> Result<u64, IdsError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
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
            .and_then(|text| fs::write(&temporary, text))
            .and_then(|()| fs::rename(&temporary, file));
        done.map_err(|error| IdsError { file: file.clone(), error })
    }
}
