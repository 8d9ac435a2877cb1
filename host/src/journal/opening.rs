//! Opens the file of a journal for writing, and makes a new one.
//!
//! Invariant: nobody else has the file from before it is read until it is closed, and it is written only
//! after a copy of it was found good. A new file gets its name when it is whole.

use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use redb::{Builder, Database, WriteTransaction};
use trocar_rt::os::{Unshared, unshared};

use super::aside::put_aside;
use super::contents;
use super::copy::{self, Copy, caught};
#[cfg(test)]
use super::disk::Faults;
use super::disk::{Answers, Disk};
use super::fault::{Bad, Res};
use super::frame::Frame;
use crate::gcm::Unusable;

/// Pages kept in memory while it is written, bytes: only the newest are read again.
const CACHE: usize = 256 << 10;

/// A journal that is open for writing.
pub(super) struct Open {
    /// `None`: it is closed.
    database: Option<Database>,
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
    /// Opens the journal of that name for writing, and returns what is read from its copy.
    pub(super) fn open<T>(&self, path: &Path, read: impl FnOnce(&Copy, &Frame) -> Res<T>) -> Res<(Open, T)> {
        let (file, read) = checked(self.writable(path).map_err(failed)?, read)?;
        Ok((self.database(file)?, read))
    }

    /// Returns what is read from a copy of the journal of that name, which nobody else has.
    pub(super) fn look<T>(&self, path: &Path, read: impl FnOnce(&Copy, &Frame) -> Res<T>) -> Res<T> {
        let (_, read) = checked(self.writable(path).map_err(failed)?, read)?;
        Ok(read)
    }

    /// Returns what is read from a copy of the journal of that name, and the journal open for writing where
    /// it can be written. Where it cannot, the copy is made without the lock.
    pub(super) fn load<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&Copy, &Frame) -> Res<T>,
    ) -> Res<(Option<Open>, T)> {
        let unwritable = |why: &str| log::warn!("{} can be read and not written: {why}", path.display());
        let file = match self.writable(path) {
            Ok(file) => file,
            Err(e) if matches!(e.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => {
                let (copy, frame) = copy::unlocked(path)?;
                unwritable(&e.to_string());
                return Ok((None, read(&copy, &frame)?));
            }
            Err(e) => return Err(failed(e)),
        };
        let (file, read) = checked(file, read)?;
        match self.database(file) {
            Ok(open) => Ok((Some(open), read)),
            Err(bad) if bad.unusable == Unusable::Now => {
                unwritable(&bad.why);
                Ok((None, read))
            }
            Err(bad) => Err(bad),
        }
    }

    /// Makes a journal of that name with what `lay` lays in it; `None`: another process was faster. A journal
    /// that is there is put aside if `replaces` says so.
    pub(super) fn create<T>(
        &self,
        path: &Path,
        replaces: bool,
        lay: impl FnOnce(&WriteTransaction) -> Res<T>,
    ) -> Res<Option<T>> {
        let new = path.with_extension("new");
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&new);
        let file = file.map_err(failed)?;
        lock(&file)?;
        if !replaces && path.exists() {
            fs::remove_file(&new).map_err(failed)?;
            return Ok(None);
        }
        file.set_len(0).map_err(failed)?;
        let mut open = self.database(file)?;
        let laid = open.write(lay)?;
        open.close()?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        if replaces {
            let aside = put_aside(folder).map_err(failed)?;
            log::warn!("{} is begun anew: the journal before it is {}", path.display(), aside.display());
        }
        fs::rename(&new, path).map_err(failed)?;
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
        Ok(Some(laid))
    }

    fn writable(&self, path: &Path) -> io::Result<File> {
        #[cfg(test)]
        if let Some(error) = *self.faults.unwritable.lock() {
            return Err(io::Error::from_raw_os_error(error));
        }
        OpenOptions::new().read(true).write(true).open(path)
    }

    fn database(&self, file: File) -> Res<Open> {
        let place = Place::of(&file.metadata().map_err(failed)?);
        let unshared = unshared(&file);
        let (disk, answers) = Disk::new(
            file,
            #[cfg(test)]
            self.faults.clone(),
        )?;
        let opened = || Ok(Builder::new().set_cache_size(CACHE).create_with_backend(disk)?);
        let database = caught(opened, panicked).map_err(|bad| judged(&answers, bad))?;
        Ok(Open { database: Some(database), answers, place, _unshared: unshared })
    }
}

impl Open {
    /// Checks that the file is still there under its name.
    pub(super) fn is_there(&self, path: &Path) -> Res<()> {
        match fs::metadata(path) {
            Ok(metadata) if Place::of(&metadata) == self.place => Ok(()),
            Ok(_) => Err(Bad::now("another file was put in its place")),
            Err(e) if e.kind() == ErrorKind::NotFound => Err(Bad::now("it was removed")),
            Err(e) => Err(failed(e)),
        }
    }

    /// Commits one change. After an error the file has to be opened anew.
    ///
    /// One sync for each commit: pages, checksums and the new root are written, then synced together. After a
    /// crash the database checks each checksum and goes back to the root before where one does not fit, and
    /// the chain of hashes shows any part that is not as it was written.
    pub(super) fn write<T>(&self, change: impl FnOnce(&WriteTransaction) -> Res<T>) -> Res<T> {
        let written = || {
            let database = self.database.as_ref().ok_or_else(|| Bad::now("it is closed"))?;
            let txn = database.begin_write()?;
            let changed = change(&txn)?;
            txn.commit()?;
            Ok(changed)
        };
        caught(written, panicked).map_err(|bad| judged(&self.answers, bad))
    }

    /// Closes the file in order.
    fn close(&mut self) -> Res<()> {
        let database = self.database.take();
        let closed = || database.map_or(Ok(()), |database| Ok(database.close()?));
        caught(closed, panicked).map_err(|bad| judged(&self.answers, bad))
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        // Its records are on the disk already.
        let _ = self.close();
    }
}

/// Makes the directory of that file, if it is not there.
pub(super) fn make_folder(path: &Path) -> Res<()> {
    let Some(folder) = path.parent() else { return Ok(()) };
    DirBuilder::new().recursive(true).mode(0o700).create(folder).map_err(failed)
}

/// Checks that no other process has that file, if it can be opened at all.
pub(super) fn is_free(path: &Path) -> Res<()> {
    File::open(path).map_or(Ok(()), |file| lock(&file))
}

/// Locks a file, and reads from a copy of it.
fn checked<T>(file: File, read: impl FnOnce(&Copy, &Frame) -> Res<T>) -> Res<(File, T)> {
    lock(&file)?;
    let copy = Copy::checked(&copy::read(&file)?)?;
    let read = read(&copy, &copy.look(contents::frame)?)?;
    Ok((file, read))
}

fn failed(error: io::Error) -> Bad {
    Bad::of_disk(&error)
}

/// The bytes are not to blame: a copy of them was found good, and is looked at again before the next change.
fn panicked() -> Bad {
    Bad::now("the database panicked over it")
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
