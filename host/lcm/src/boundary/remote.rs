//! Functions whose server is in another process: the same outcomes, through memory both share.
//!
//! Invariant: data from the other process are used only as bytes of a result, as a state, or as an outcome; a
//! server that is gone answers PEER_LOST at once, and a read that would have to ask it (`here.rs` answers
//! what can be answered in this process) is WOULD_BLOCK in a step.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use trocar_plugin_api::abi::{
    CallOpts, DISABLED, EXECUTED, ErrBuf, FAILED, INVALID_ARGUMENT, MODE_CALL, MODE_SEND, NOT_ACTIVE,
    Outcome, PEER_LOST, WOULD_BLOCK,
};
use trocar_rt::mailbox::Mailbox;
use trocar_rt::os;
use trocar_rt::reply::ReplyPool;
use trocar_rt::segment::Word;
use trocar_rt::state::StateReader;
use trocar_rt::wake::Waker;

use super::super::books::Misuse;
use super::super::context;
use super::super::gate::Presence;
use super::entry::ERR_BYTES;
use super::here::OwnRead;
use super::inside::misused;
use super::outcomes::{lacks, within_ns};
use super::queue::{Destination, Lane, queue};
use super::range::RangeCheck;
use super::texts::write_err;

/// Answer of a server's process to a read.
pub(crate) struct ReadAnswer {
    pub(crate) outcome: i32,
    pub(crate) stamp_ns: u64,
    pub(crate) value: Vec<u8>,
    pub(crate) text: String,
}

/// A peer that can be asked for the result of a read.
pub(crate) trait Asking: Send + Sync {
    /// Asks for the read at this place among the connection's functions and waits.
    ///
    /// # Errors
    /// DEADLINE, or PEER_LOST when no answer can come any more.
    fn ask(&self, index: u32, arg: &[u8], within_ns: u64) -> Result<ReadAnswer, Outcome>;
}

/// A server in another process, as its client sees it.
pub(crate) struct RemoteServer {
    pub(crate) commands: Mailbox,
    pub(crate) replies: Arc<ReplyPool>,
    /// State of the server, as its process publishes it.
    pub(crate) standing: Word,
    pub(crate) bell: Arc<Waker>,
    lost: AtomicBool,
}

impl RemoteServer {
    pub(crate) fn new(
        commands: Mailbox,
        replies: Arc<ReplyPool>,
        standing: Word,
        bell: Arc<Waker>,
    ) -> Arc<RemoteServer> {
        Arc::new(RemoteServer { commands, replies, standing, bell, lost: AtomicBool::new(false) })
    }

    /// Marks the server's process, or the connection, as gone: callers that wait for it are answered. Any
    /// thread.
    pub(crate) fn lose(&self) {
        self.lost.store(true, Ordering::SeqCst);
        self.replies.end_all(PEER_LOST);
    }
}

impl Destination for RemoteServer {
    fn mailbox(&self) -> &Mailbox {
        &self.commands
    }

    fn replies(&self) -> &Arc<ReplyPool> {
        &self.replies
    }

    fn signal(&self) {
        context::wake(&self.bell);
    }

    fn signal_now(&self) {
        self.bell.notify();
    }

    fn closed(&self) -> Outcome {
        PEER_LOST
    }

    fn away(&self) -> Option<Outcome> {
        if self.lost.load(Ordering::SeqCst) {
            return Some(PEER_LOST);
        }
        match Presence::of(self.standing.get()) {
            Presence::Active => None,
            Presence::NotActive => Some(NOT_ACTIVE),
            Presence::Gone => Some(PEER_LOST),
        }
    }
}

/// Tells whether the argument is missing or out of range.
fn unfit(arg: *const u8, arg_bytes: usize, range: Option<&RangeCheck>) -> bool {
    lacks(arg, arg_bytes) || range.is_some_and(|range| !range.holds(arg))
}

/// Warns the component whose step would have had to wait; its server's process is not told.
#[cold]
fn would_block() -> Outcome {
    misused(Misuse::CalledFromStep);
    WOULD_BLOCK
}

/// A command of a server in another process.
pub(crate) struct RemoteCommand {
    pub(crate) server: Arc<RemoteServer>,
    pub(crate) lane: Lane,
    pub(crate) range: Option<RangeCheck>,
    pub(crate) deadline_ns: u64,
}

impl RemoteCommand {
    #[inline(never)]
    pub(super) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        let mode = opts.as_ref().map_or(MODE_SEND, |o| o.mode);
        let unfit = unfit(arg, self.lane.arg_bytes, self.range.as_ref());
        if unfit || (mode == MODE_CALL && lacks(ret, self.lane.ret_bytes)) {
            return INVALID_ARGUMENT;
        }
        if let Some(away) = self.server.away() {
            return away;
        }
        if mode == MODE_CALL && context::stepping() {
            return would_block();
        }
        let deadline_ns = within_ns(opts.as_ref().map_or(0, |o| o.deadline_ns), self.deadline_ns);
        queue(&*self.server, &self.lane, arg, ret, mode, deadline_ns, opts)
    }
}

/// Source of a read's results.
pub(crate) enum RemoteSource {
    /// Tables that the server's process writes at every publication.
    Table(RemoteTable),
    /// The server's rows, read by the code of its class here; its process is asked where that does not work.
    Here(OwnRead, Arc<dyn Asking>),
    /// The server's process, which has to be asked.
    Ask(Arc<dyn Asking>),
}

/// Results of a read without an argument; the tick of a row is the outcome.
pub(crate) struct RemoteTable {
    pub(crate) results: StateReader,
    /// Sentences of failed reads; the tick of a row is the length.
    pub(crate) whys: StateReader,
    /// True for a `ComponentStatus`, which holds until the next one is published.
    pub(crate) status: bool,
}

impl RemoteTable {
    /// Outcome and stamp. Real-time.
    fn latest(&self, place: &mut [u8], err: *mut ErrBuf) -> (Outcome, u64) {
        let Some(row) = self.results.latest(place) else { return (NOT_ACTIVE, 0) };
        let outcome = outcome_in(row.tick as i32);
        if self.status
            && let Some(stamp) = place.first_chunk_mut::<8>()
        {
            // The status still holds: every change publishes a row.
            let now_ns = os::now_ns();
            *stamp = now_ns.to_le_bytes();
            return (outcome, now_ns);
        }
        if outcome == FAILED && !err.is_null() {
            self.say_why(err);
        }
        (outcome, row.stamp_ns)
    }

    #[cold]
    fn say_why(&self, err: *mut ErrBuf) {
        let mut text = [0; ERR_BYTES];
        let room = self.whys.row_bytes().min(ERR_BYTES);
        if let Some(said) = self.whys.latest(&mut text[..room]) {
            let bytes = usize::try_from(said.tick).map_or(room, |bytes| bytes.min(room));
            write_err(err, &text[..bytes]);
        }
    }
}

/// A read of a server in another process.
pub(crate) struct RemoteRead {
    pub(crate) server: Arc<RemoteServer>,
    /// Position among the functions of the connection.
    pub(crate) index: u32,
    pub(crate) source: RemoteSource,
    pub(crate) arg_bytes: usize,
    pub(crate) ret_bytes: usize,
    pub(crate) range: Option<RangeCheck>,
    pub(crate) deadline_ns: u64,
}

impl RemoteRead {
    #[inline(never)]
    pub(super) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        if unfit(arg, self.arg_bytes, self.range.as_ref()) || lacks(ret, self.ret_bytes) {
            return INVALID_ARGUMENT;
        }
        if self.server.away() == Some(PEER_LOST) {
            return PEER_LOST;
        }
        // SAFETY: not null, and with room for the command's result type, checked when bound; nothing of no
        // bytes.
        let place = |bytes| match bytes {
            0 => &mut [][..],
            // SAFETY: as above.
            _ => unsafe { std::slice::from_raw_parts_mut(ret, bytes) },
        };
        let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
        let (outcome, stamp_ns) = match &self.source {
            RemoteSource::Table(table) => table.latest(place(self.ret_bytes), err),
            RemoteSource::Here(read, asking) => match read.call(arg, ret, err) {
                Some(answered) => answered,
                None => self.ask(&**asking, arg, place(self.ret_bytes), opts.as_deref()),
            },
            RemoteSource::Ask(asking) => self.ask(&**asking, arg, place(self.ret_bytes), opts.as_deref()),
        };
        if let Some(opts) = opts {
            opts.stamp_ns = stamp_ns;
        }
        outcome
    }

    /// Waits for the server's process, where the caller may wait.
    #[inline(never)]
    fn ask(
        &self,
        asking: &dyn Asking,
        arg: *const u8,
        place: &mut [u8],
        opts: Option<&CallOpts>,
    ) -> (Outcome, u64) {
        if context::stepping() {
            return (would_block(), 0);
        }
        let arg: &[u8] = match self.arg_bytes {
            0 => &[],
            // SAFETY: not null, and an argument of the command's type, checked by `call`.
            bytes => unsafe { std::slice::from_raw_parts(arg, bytes) },
        };
        let within_ns = within_ns(opts.map_or(0, |o| o.deadline_ns), self.deadline_ns);
        let answer = match asking.ask(self.index, arg, within_ns) {
            Ok(answer) => answer,
            Err(why) => return (why, 0),
        };
        let n = place.len().min(answer.value.len());
        place[..n].copy_from_slice(&answer.value[..n]);
        write_err(opts.map_or(std::ptr::null_mut(), |o| o.err), answer.text.as_bytes());
        (outcome_in(answer.outcome), answer.stamp_ns)
    }
}

/// Limits the outcome to those a server's process may answer to a read; any other one counts as a failure.
fn outcome_in(said: i32) -> Outcome {
    match said {
        EXECUTED | FAILED | INVALID_ARGUMENT | NOT_ACTIVE | DISABLED | PEER_LOST => said,
        _ => FAILED,
    }
}
