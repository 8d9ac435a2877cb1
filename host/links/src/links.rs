//! The handle on all sessions of this process, and the trait that hears of them.
//!
//! Invariant: the sessions belong to one thread, `trocar-links`; all other threads ask it.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use rustix::event::EventfdFlags;
use trocar_rt::house;

use crate::address;
use crate::card::Card;
use crate::serve::Server;
use crate::session::{Lost, Message, Session};

/// Told on the thread of the sessions: a handler that waits makes other processes believe that this one is
/// dead.
pub trait Handler: Send + 'static {
    /// The two processes made sure of each other.
    fn met(&mut self, session: &Arc<Session>);
    /// The process sent a message.
    fn said(&mut self, session: &Arc<Session>, message: Message);
    /// The process is gone. Nothing comes of this session any more.
    fn lost(&mut self, session: &Arc<Session>, why: &Lost);
}

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
        std::mem::take(&mut *self.asked.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn ask(&self, ask: Ask) {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).push(ask);
        // A counter that is full wakes as well.
        let _ = rustix::io::write(&self.bell, &1u64.to_ne_bytes());
    }
}

/// All sessions of this process.
pub struct Links {
    card: Card,
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Links {
    /// Listens at the socket of the card. The caller owns its folder: a socket left there by an earlier
    /// process is replaced.
    ///
    /// # Errors
    /// The socket cannot be made there, or the machine gives no more threads or files.
    pub fn start(card: Card, handler: impl Handler) -> io::Result<Links> {
        let shared = Arc::new(Shared::new()?);
        let listener = address::listen(&card.socket)?;
        let (own, asked) = (card.clone(), shared.clone());
        let thread = std::thread::Builder::new().name("trocar-links".into());
        // The server is made on its thread, since the words of its will belong to that thread.
        let thread = house::spawn(thread, move || Server::new(own, listener, asked, handler).run());
        // Nothing half made stays: without its thread no call at the socket would be answered.
        let thread = thread.inspect_err(|_| drop(std::fs::remove_file(&card.socket)))?;
        Ok(Links { card, shared, thread: Mutex::new(Some(thread)) })
    }

    /// Facts other processes need to reach this one.
    pub fn card(&self) -> &Card {
        &self.card
    }

    /// Wants a session with the process that listens at `socket`: this process dials it until it answers, and
    /// again whenever the session is lost. Each call needs one call to leave it.
    pub fn want(&self, socket: &Path) {
        self.shared.ask(Ask::Want(socket.into()));
    }

    /// Leaves the session: this caller does not need it any more.
    pub fn leave(&self, socket: &Path) {
        self.shared.ask(Ask::Unwant(socket.into()));
    }

    /// The live session that was wanted.
    pub fn session(&self, socket: &Path) -> Option<Arc<Session>> {
        self.shared.known().dialled.get(socket).filter(|session| !session.is_lost()).cloned()
    }

    /// Returns why there is no session with the process that should listen there, as it was found last.
    pub fn why_not(&self, socket: &Path) -> Option<String> {
        self.shared.known().failed.get(socket).map(|failed| failed.why.clone())
    }

    /// As [`Links::why_not`], where the other process, or this one, said no: to wait for it is of little use.
    pub fn refused(&self, socket: &Path) -> Option<String> {
        self.shared
            .known()
            .failed
            .get(socket)
            .filter(|failed| failed.refused)
            .map(|failed| failed.why.clone())
    }

    /// Ends all sessions and the thread.
    pub fn stop(&self) {
        self.shared.ask(Ask::Stop);
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(thread) = thread else { return };
        if thread.join().is_err() {
            log::error!("the thread of the links to other processes panicked");
        }
        // Removed only once, since later it is the socket of the next process of this name. A socket left
        // behind is replaced by that process.
        let _ = std::fs::remove_file(&self.card.socket);
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        self.stop();
    }
}
