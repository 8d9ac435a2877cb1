//! Questions of other threads to the thread of the sessions, and what they may look up of it.
//!
//! Invariant: nobody waits for an answer; the bell is rung for every question.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use rustix::event::EventfdFlags;

use crate::session::Session;

/// Questions to the thread of the sessions, and its answers.
pub(crate) struct Shared {
    asked: Mutex<Vec<Ask>>,
    /// Rung for every question.
    pub(crate) bell: OwnedFd,
    known: Mutex<Known>,
}

#[derive(Default)]
pub(crate) struct Known {
    /// Sessions this process asked for, by the socket of the other process.
    pub(crate) dialled: BTreeMap<PathBuf, Arc<Session>>,
    /// Reasons why there is no session.
    pub(crate) failed: BTreeMap<PathBuf, Failed>,
}

pub(crate) struct Failed {
    pub(crate) why: String,
    /// One of the two said no; else there was no answer.
    pub(crate) refused: bool,
}

pub(crate) enum Ask {
    Want(PathBuf),
    Unwant(PathBuf),
    /// The session of this number is with a process that died.
    Died(u64),
    Stop,
}

impl Shared {
    pub(crate) fn new() -> io::Result<Shared> {
        let bell = rustix::event::eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Shared { asked: Mutex::default(), bell, known: Mutex::default() })
    }

    pub(crate) fn take(&self) -> Vec<Ask> {
        std::mem::take(&mut *self.asked.lock())
    }

    pub(crate) fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock()
    }

    pub(crate) fn ask(&self, ask: Ask) {
        self.asked.lock().push(ask);
        // A counter that is full wakes as well.
        let _ = rustix::io::write(&self.bell, &1u64.to_ne_bytes());
    }
}
