//! The medium between two LCMs: what is said goes over it, and the memory of links goes along or is made at
//! both ends.
//!
//! Invariant: the code that links and unlinks is the same over every medium.

use std::any::Any;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use trocar_links::Card;

use super::stand_in::StandIns;
use super::words::Words;

/// A session with one run of a process, until one of both is gone. Any thread may speak.
pub(super) trait Session: Send + Sync {
    /// Number in this process: no two sessions of a medium have the same.
    fn number(&self) -> u64;

    fn process(&self) -> &str;

    /// Identifies the run of the process.
    fn instance(&self) -> &str;

    /// Tells whether the session was given up, for good.
    fn is_lost(&self) -> bool;

    /// Says something, with bytes behind it and files that come along. Never waits.
    ///
    /// # Errors
    /// It is too much, or the other process does not listen, or is gone.
    fn say(&self, words: &Words, behind: &[u8], files: &[OwnedFd]) -> Result<(), String>;

    /// Ends the session, since the other process said what it may not.
    fn condemn(&self, what: &str);

    /// Whoever stands in for the other ends here; `None` where both ends share memory.
    fn stand_ins(&self) -> Option<&StandIns>;
}

/// Tells whether these are the same session.
pub(super) fn same(a: &Arc<dyn Session>, b: &Arc<dyn Session>) -> bool {
    a.number() == b.number()
}

/// All sessions of one kind.
pub(super) trait Medium: Send + Sync {
    /// Name by which connections are pinned to it and shown.
    fn name(&self) -> &'static str;

    /// Data by which other processes reach this one.
    fn card(&self) -> &Card;

    /// # Errors
    /// The sentence why the process of this card cannot be reached.
    fn reaches(&self, card: &Card) -> Result<(), String>;

    /// Wants a session with that process. Each call needs one call to leave it.
    fn want(&self, card: &Card);

    fn leave(&self, card: &Card);

    /// The live session that was wanted.
    fn session(&self, card: &Card) -> Option<Arc<dyn Session>>;

    /// Returns why there is none, as it was found last.
    fn why_not(&self, card: &Card) -> Option<String>;

    /// As [`Medium::why_not`], where one of both said no: to wait for it is of little use.
    fn refused(&self, card: &Card) -> Option<String>;

    /// Ends all sessions.
    fn stop(&self);
}

/// Something that the other process said.
pub(super) struct Message {
    pub(super) bytes: Vec<u8>,
    /// Files that came along.
    pub(super) files: Vec<OwnedFd>,
    /// Number of files that were announced.
    pub(super) announced: usize,
    /// Counts against its session until it is dropped.
    pub(super) _held: Option<Box<dyn Any + Send>>,
}
