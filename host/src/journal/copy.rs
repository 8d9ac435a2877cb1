//! A copy of a journal in memory, in which everything is checked before the file itself is touched.
//!
//! Invariant: a file that is refused stays as it is, byte for byte; opening it as a database would write to
//! it, repair it, or trust it.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use redb::backends::InMemoryBackend;
use redb::{Builder, Database, ReadableDatabase, StorageBackend};

use super::chain::Hash;
use super::contents;
use super::fault::{Bad, Res};
use super::frame::Frame;
use crate::gcm::Unusable;

/// Longest file that is read, bytes. No longer one is written, either.
pub(super) const MOST: u64 = 2 << 30;
/// Bytes that are read at a time.
const PIECE: usize = 1 << 20;
/// Copies that are made of a file that changes.
const TRIES: usize = 20;
/// Memory for pages, bytes.
pub(super) const CACHE: usize = 8 << 20;

/// A journal in memory.
pub(super) struct Copy(Option<Database>);

/// Reads a whole file.
pub(super) fn read(file: &File) -> Res<Vec<u8>> {
    let length = file.metadata().map_err(|e| Bad::of_disk(&e))?.len();
    if length == 0 {
        return Err(Bad::damaged("it is empty"));
    }
    if length > MOST {
        let why = format!("it has {length} bytes, and no more than {MOST} are read: put it aside");
        return Err(Bad::now(why));
    }
    let mut bytes = vec![0; length as usize];
    for (at, piece) in bytes.chunks_mut(PIECE).enumerate() {
        file.read_exact_at(piece, (at * PIECE) as u64).map_err(|e| Bad::of_disk(&e))?;
    }
    Ok(bytes)
}

impl Copy {
    /// Opens a copy after each of its pages was checked.
    ///
    /// # Errors
    /// With the first bad record, where one can be found.
    pub(super) fn checked(bytes: &[u8]) -> Res<Copy> {
        Copy::open(bytes, true).map_err(|bad| match bad.unusable {
            Unusable::Damaged => first_bad(bytes).unwrap_or(bad),
            _ => bad,
        })
    }

    fn open(bytes: &[u8], checked: bool) -> Res<Copy> {
        guarded(|| {
            let memory = InMemoryBackend::new();
            let filled = memory.set_len(bytes.len() as u64).and_then(|()| memory.write(0, bytes));
            filled.map_err(|e| Bad::of_disk(&e))?;
            let mut builder = Builder::new();
            let builder = builder.set_cache_size(CACHE).set_check_integrity_on_open(checked);
            Ok(Copy(Some(builder.create_with_backend(memory)?)))
        })
    }

    /// Reads from it.
    pub(super) fn look<T>(&self, read: impl FnOnce(&redb::ReadTransaction) -> Res<T>) -> Res<T> {
        let database = self.0.as_ref().ok_or_else(|| Bad::damaged("its copy is closed"))?;
        guarded(|| read(&database.begin_read()?))
    }
}

impl Drop for Copy {
    fn drop(&mut self) {
        // A damaged one may also panic as it is closed.
        let database = self.0.take();
        let _ = guarded(move || {
            drop(database);
            Ok(())
        });
    }
}

/// Reads a file without a lock, also while it is written: a damage that two copies have alike is in the file.
pub(super) fn unlocked(path: &Path) -> Res<(Copy, Frame)> {
    let mut seen: Option<Hash> = None;
    for _ in 0..TRIES {
        let bytes = read(&File::open(path).map_err(|e| Bad::of_disk(&e))?)?;
        let looked = Copy::checked(&bytes).and_then(|copy| {
            let frame = copy.look(contents::frame)?;
            Ok((copy, frame))
        });
        let hash = Hash::of(&bytes);
        match looked {
            Err(bad) if bad.unusable == Unusable::Damaged && seen != Some(hash) => seen = Some(hash),
            looked => return looked,
        }
    }
    Err(Bad::now("it changes too fast to be read: try again"))
}

/// Finds the first bad record of a damaged file, if it can be opened at all without a check.
fn first_bad(bytes: &[u8]) -> Option<Bad> {
    let copy = Copy::open(bytes, false).ok()?;
    let walked = copy.look(|txn| {
        let frame = contents::frame(txn)?;
        contents::walk(txn, &frame, None, 0, &mut |_| true)
    });
    walked.err().filter(|bad| bad.record.is_some() && bad.unusable == Unusable::Damaged)
}

/// Runs code of the database over a copy, which may be damaged: it may panic over bytes that it trusts.
fn guarded<T>(run: impl FnOnce() -> Res<T>) -> Res<T> {
    caught(run, || Bad::damaged("its tables are damaged"))
}

/// Runs code of the database, and says `panicked` where it panics.
pub(super) fn caught<T>(run: impl FnOnce() -> Res<T>, panicked: impl FnOnce() -> Bad) -> Res<T> {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err(panicked()))
}
