//! Opens the file of a journal for writing, and makes a new one.
//!
//! Invariant: nobody else has the file from before it is read until it is closed, and it is written only
//! after a copy of it was found good. A new file gets its name when it is whole.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use redb::{Builder, Database};
use trocar_rt::os::{Unshared, unshared};

use super::contents::{self, Frame, Identity};
use super::copy::{self, Copy, guarded};
#[cfg(test)]
use super::disk::Faults;
use super::disk::{Answers, Disk};
use super::fault::{Bad, Res};

/// A journal that is open for writing.
pub(super) struct Open {
    pub(super) database: Database,
    answers: Arc<Answers>,
    place: Place,
    /// Keeps the locks from children that a plugin forks and leaves behind.
    _unshared: Unshared,
}

/// The very file, whatever its name leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    device: u64,
    inode: u64,
}

impl Place {
    fn of(metadata: &fs::Metadata) -> Place {
        Place { device: metadata.dev(), inode: metadata.ino() }
    }
}

/// Opener of files, in tests with a disk that fails.
#[derive(Clone, Debug, Default)]
pub(super) struct Opener {
    #[cfg(test)]
    pub(super) faults: Arc<Faults>,
}

impl Opener {
    /// Opens the journal of that name, and returns what is read from its copy.
    pub(super) fn open<T>(&self, path: &Path, read: impl FnOnce(&Copy, &Frame) -> Res<T>) -> Res<(Open, T)> {
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(|e| Bad::of_disk(&e))?;
        lock(&file)?;
        let copy = Copy::checked(&copy::read(&file)?)?;
        let read = read(&copy, &copy.look(contents::frame)?)?;
        drop(copy);
        Ok((self.database(file)?, read))
    }

    /// Makes a journal of that name, where there is none.
    pub(super) fn create(&self, path: &Path, identity: &Identity) -> Res<()> {
        let failed = |e: io::Error| Bad::of_disk(&e);
        let new = path.with_extension("new");
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&new);
        let file = file.map_err(failed)?;
        lock(&file)?;
        if path.exists() {
            // Another process was faster.
            return fs::remove_file(&new).map_err(failed);
        }
        file.set_len(0).map_err(failed)?;
        let open = self.database(file)?;
        let laid = (|| {
            let txn = open.database.begin_write()?;
            contents::lay(&txn, identity)?;
            Ok(txn.commit()?)
        })();
        laid.map_err(|bad| open.judged(bad))?;
        let Open { database, answers, .. } = open;
        database.close().map_err(|e| judged(&answers, e.into()))?;
        fs::rename(&new, path).map_err(failed)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all()).map_err(failed)
    }

    fn database(&self, file: File) -> Res<Open> {
        let place = Place::of(&file.metadata().map_err(|e| Bad::of_disk(&e))?);
        let unshared = unshared(&file);
        let (disk, answers) = Disk::new(
            file,
            #[cfg(test)]
            self.faults.clone(),
        )?;
        let opened = guarded(|| Ok(Builder::new().set_cache_size(copy::CACHE).create_with_backend(disk)?));
        let database = opened.map_err(|bad| judged(&answers, bad))?;
        Ok(Open { database, answers, place, _unshared: unshared })
    }
}

impl Open {
    /// Checks that the file is still there under its name.
    pub(super) fn is_there(&self, path: &Path) -> Res<()> {
        match fs::metadata(path) {
            Ok(metadata) if Place::of(&metadata) == self.place => Ok(()),
            Ok(_) => Err(Bad::now("another file was put in its place")),
            Err(e) if e.kind() == ErrorKind::NotFound => Err(Bad::now("it was removed")),
            Err(e) => Err(Bad::of_disk(&e)),
        }
    }

    /// Tells a failed sync from other failures.
    pub(super) fn judged(&self, bad: Bad) -> Bad {
        judged(&self.answers, bad)
    }
}

fn judged(answers: &Answers, bad: Bad) -> Bad {
    if answers.unsynced.load(Ordering::Relaxed) { Bad::not_synced() } else { bad }
}

/// Takes the lock by which the database, too, keeps others out: the file is not read while another writes.
fn lock(file: &File) -> Res<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Bad::in_use()),
        Err(TryLockError::Error(e)) => Err(Bad::of_disk(&e)),
    }
}
