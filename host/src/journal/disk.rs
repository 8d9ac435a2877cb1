//! The file of a journal as the database writes it, with an eye on what the disk answers.
//!
//! Invariant: a failed sync is told apart from a failed write: after it nobody knows what is on the disk. A
//! file never gets longer than one that is read.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::ops::Bound;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use redb::backends::FileBackend;
use redb::{BackendError, DatabaseError, StorageBackend};

use super::copy::MOST;

/// Answers of the disk so far.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// A sync failed.
    pub(super) unsynced: AtomicBool,
}

/// Errors that a test lets the disk answer.
#[cfg(test)]
#[derive(Debug, Default)]
pub(super) struct Faults {
    /// Writes that succeed before the next one fails once, with that error number.
    pub(super) write: parking_lot::Mutex<Option<(u32, i32)>>,
    /// The next sync fails with that error number.
    pub(super) sync: parking_lot::Mutex<Option<i32>>,
    /// Writes that succeed before the next one panics once.
    pub(super) panic: parking_lot::Mutex<Option<u32>>,
    /// Files can only be read, with that error number for all else.
    pub(super) unwritable: parking_lot::Mutex<Option<i32>>,
}

/// The file.
#[derive(Debug)]
pub(super) struct Disk {
    file: FileBackend,
    answers: Arc<Answers>,
    #[cfg(test)]
    faults: Arc<Faults>,
}

impl Disk {
    /// # Errors
    /// None on this machine; the library may have others.
    pub(super) fn new(
        file: File,
        #[cfg(test)] faults: Arc<Faults>,
    ) -> Result<(Disk, Arc<Answers>), DatabaseError> {
        let answers = Arc::new(Answers::default());
        let disk = Disk {
            file: FileBackend::new(file)?,
            answers: answers.clone(),
            #[cfg(test)]
            faults,
        };
        Ok((disk, answers))
    }

    #[cfg(test)]
    fn fails_to_write(&self) -> io::Result<()> {
        let mut panics = self.faults.panic.lock();
        match panics.take() {
            Some(0) => {
                drop(panics);
                panic!("a test has the database panic");
            }
            left => *panics = left.map(|left| left - 1),
        }
        drop(panics);
        let mut next = self.faults.write.lock();
        match *next {
            Some((0, error)) => {
                *next = None;
                Err(io::Error::from_raw_os_error(error))
            }
            Some((left, error)) => {
                *next = Some((left - 1, error));
                Ok(())
            }
            None => Ok(()),
        }
    }

    #[cfg(test)]
    fn fails_to_sync(&self) -> io::Result<()> {
        let error = self.faults.sync.lock().take();
        error.map_or(Ok(()), |error| Err(io::Error::from_raw_os_error(error)))
    }

    #[cfg(not(test))]
    fn fails_to_write(&self) -> io::Result<()> {
        Ok(())
    }

    #[cfg(not(test))]
    fn fails_to_sync(&self) -> io::Result<()> {
        Ok(())
    }
}

impl StorageBackend for Disk {
    fn len(&self) -> io::Result<u64> {
        self.file.len()
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.file.read(offset, out)
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        self.fails_to_write()?;
        if len > MOST {
            let why = format!("it would have {len} bytes, and no more than {MOST} are read");
            return Err(io::Error::new(ErrorKind::StorageFull, why));
        }
        self.file.set_len(len)
    }

    fn sync_data(&self) -> io::Result<()> {
        self.fails_to_sync().and_then(|()| self.file.sync_data()).inspect_err(|_| {
            self.answers.unsynced.store(true, Ordering::Relaxed);
        })
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.fails_to_write()?;
        self.file.write(offset, data)
    }

    fn close(&self) -> io::Result<()> {
        self.file.close()
    }

    fn try_lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        self.file.try_lock_range(start, end)
    }

    fn try_lock_shared_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        self.file.try_lock_shared_range(start, end)
    }

    fn lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        self.file.lock_range(start, end)
    }

    fn lock_shared_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        self.file.lock_shared_range(start, end)
    }

    fn unlock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<(), BackendError> {
        self.file.unlock_range(start, end)
    }

    fn query_lock_range(&self, start: Bound<u64>, end: Bound<u64>) -> Result<bool, BackendError> {
        self.file.query_lock_range(start, end)
    }
}
