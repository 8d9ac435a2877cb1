//! Room on the disk for the next bytes and for the end of the file, promised by the system before it is
//! needed.
//!
//! Invariant: as long as `ensure` says yes, all bytes up to there can be written, even on a full disk.

use std::fs::File;
use std::io;

use rustix::fs::{FallocateFlags, fallocate, fstatvfs};
use rustix::io::Errno;

/// Room that is asked for at once, if there is so much, bytes.
const STEP: u64 = 16 << 20;

/// Room for one file.
pub(crate) struct Room {
    file: File,
    /// The system has promised all bytes up to here.
    promised: u64,
    /// False if the file system promises nothing: then free space is looked at.
    promises: bool,
    /// In tests, the end of the disk.
    #[cfg(test)]
    end: Option<u64>,
}

impl Room {
    pub(crate) fn new(file: File) -> Room {
        Room {
            file,
            promised: 0,
            promises: true,
            #[cfg(test)]
            end: None,
        }
    }

    /// Whether the file can grow up to `end` bytes.
    ///
    /// # Errors
    /// The error of the system, if it is not about room.
    pub(crate) fn ensure(&mut self, end: u64) -> io::Result<bool> {
        if end <= self.promised {
            return Ok(true);
        }
        #[cfg(test)]
        if self.end.is_some_and(|last| end > last) {
            return Ok(false);
        }
        // All at once if there is plenty; else only the room needed now.
        for upto in [end.saturating_add(STEP), end] {
            #[cfg(test)]
            let upto = self.end.map_or(upto, |last| upto.min(last));
            if !self.promises {
                break;
            }
            let flags = FallocateFlags::KEEP_SIZE;
            match fallocate(&self.file, flags, self.promised, upto - self.promised) {
                Ok(()) => {
                    self.promised = upto;
                    return Ok(true);
                }
                Err(Errno::NOSPC | Errno::DQUOT | Errno::FBIG) => {}
                Err(Errno::OPNOTSUPP | Errno::NOSYS | Errno::INVAL) => self.promises = false,
                Err(Errno::INTR) => {}
                Err(other) => return Err(other.into()),
            }
        }
        if self.promises {
            return Ok(false);
        }
        let free = fstatvfs(&self.file)?;
        let free = free.f_bavail.saturating_mul(free.f_frsize);
        let more = end - self.promised;
        // Others write there, too: twice the needed room and a step more have to be free, and each call
        // beyond `end` looks again.
        if free < more.saturating_mul(2).saturating_add(STEP) {
            return Ok(false);
        }
        self.promised = end;
        Ok(true)
    }

    /// Gives back the unused part.
    pub(crate) fn trim(&self, len: u64) {
        // Room that stays promised behind the end is no part of the file: it does no harm if it cannot be
        // given back.
        let _ = self.file.set_len(len);
    }
}

#[cfg(test)]
impl Room {
    /// As if the disk had no room behind `end`.
    pub(crate) fn ending_at(room: Room, end: u64) -> Room {
        Room { end: Some(end), promised: room.promised.min(end), ..room }
    }
}
