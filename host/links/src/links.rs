//! The handle on all sessions of this process.
//!
//! Invariant: the sessions belong to one thread, `trocar-links`; all other threads ask it.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

use parking_lot::Mutex;
use trocar_rt::house;

use crate::address;
use crate::asked::{Ask, Shared};
use crate::card::Card;
use crate::handler::Handler;
use crate::serve::Server;
use crate::session::Session;

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
        // The server is made on its thread, since its robust words belong to that thread.
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
        let thread = self.thread.lock().take();
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
