//! The medium between processes of one machine: sockets, over which memory goes along.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;

use trocar_links::{Card, Handler, Links, Lost, Message, Session};

use super::medium;
use super::stand_in::StandIns;
use super::todo::Teller;
use super::words::Words;

/// Name of the carrier.
pub(crate) const NAME: &str = "memfd";

/// Listens at the socket of the card, and tells of what comes.
///
/// # Errors
/// The socket cannot be made there, or the machine gives no more threads.
pub(super) fn start(card: Card, teller: Teller) -> io::Result<Arc<dyn medium::Medium>> {
    Ok(Arc::new(Links::start(card, teller)?))
}

impl Handler for Teller {
    fn met(&mut self, session: &Arc<Session>) {
        Teller::met(self, session.clone());
    }

    fn said(&mut self, session: &Arc<Session>, mut message: Message) {
        let said = medium::Message {
            bytes: std::mem::take(&mut message.bytes),
            files: std::mem::take(&mut message.files),
            announced: message.announced,
            _held: Some(Box::new(message)),
        };
        Teller::said(self, session.clone(), said);
    }

    fn lost(&mut self, session: &Arc<Session>, why: &Lost) {
        Teller::lost(self, session.clone(), why.to_string());
    }
}

impl medium::Session for Session {
    fn number(&self) -> u64 {
        Session::number(self)
    }

    fn process(&self) -> &str {
        &self.peer().process
    }

    fn instance(&self) -> &str {
        &self.peer().instance
    }

    fn is_lost(&self) -> bool {
        Session::is_lost(self)
    }

    fn say(&self, words: &Words, behind: &[u8], files: &[OwnedFd]) -> Result<(), String> {
        let files: Vec<_> = files.iter().map(AsFd::as_fd).collect();
        self.send(&words.encode(behind), &files).map_err(|e| e.to_string())
    }

    fn condemn(&self, what: &str) {
        Session::condemn(self, what);
    }

    fn stand_ins(&self) -> Option<&StandIns> {
        None
    }
}

impl medium::Medium for Links {
    fn name(&self) -> &'static str {
        NAME
    }

    fn card(&self) -> &Card {
        Links::card(self)
    }

    fn reaches(&self, card: &Card) -> Result<(), String> {
        Links::card(self).reaches(card).map_err(|e| e.to_string())
    }

    fn want(&self, card: &Card) {
        Links::want(self, &card.socket);
    }

    fn leave(&self, card: &Card) {
        Links::leave(self, &card.socket);
    }

    fn session(&self, card: &Card) -> Option<Arc<dyn medium::Session>> {
        Links::session(self, &card.socket).map(|session| session as Arc<dyn medium::Session>)
    }

    fn why_not(&self, card: &Card) -> Option<String> {
        Links::why_not(self, &card.socket)
    }

    fn refused(&self, card: &Card) -> Option<String> {
        Links::refused(self, &card.socket)
    }

    fn stop(&self) {
        Links::stop(self);
    }
}
