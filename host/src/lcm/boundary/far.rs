//! Functions whose server is in another process: the same outcomes, through memory both share.
//!
//! Invariant: nothing the other process writes is used but as bytes of a result, as a state, or as an outcome; a server that is gone
//! answers PEER_LOST at once, and a read that would have to ask it is WOULD_BLOCK in a step.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use trocar_plugin_api::abi::{
    CallOpts, DISABLED, EXECUTED, FAILED, INVALID_ARGUMENT, MODE_CALL, MODE_SEND, NOT_ACTIVE, Outcome,
    PEER_LOST, WOULD_BLOCK,
};
use trocar_rt::mailbox::Mailbox;
use trocar_rt::reply::ReplyPool;
use trocar_rt::segment::Word;
use trocar_rt::state::StateReader;
use trocar_rt::wake::Waker;

use super::super::context;
use super::super::far::{Asking, Standing};
use super::super::instance::Misuse;
use super::call::{lacks, within_ns, write_err};
use super::misused;
use super::queue::{Destination, Lane, queue};
use super::range::RangeCheck;

/// A server in another process, as its client sees it.
pub(in crate::lcm) struct FarServer {
    pub(in crate::lcm) commands: Mailbox,
    pub(in crate::lcm) replies: Arc<ReplyPool>,
    /// How it stands, as its process says.
    pub(in crate::lcm) standing: Word,
    pub(in crate::lcm) bell: Arc<Waker>,
    lost: AtomicBool,
}

impl FarServer {
    pub(in crate::lcm) fn new(
        commands: Mailbox,
        replies: Arc<ReplyPool>,
        standing: Word,
        bell: Arc<Waker>,
    ) -> Arc<FarServer> {
        Arc::new(FarServer { commands, replies, standing, bell, lost: AtomicBool::new(false) })
    }

    /// Its process is gone, or the connection: whoever waits for it is answered. Any thread.
    pub(in crate::lcm) fn lose(&self) {
        self.lost.store(true, Ordering::SeqCst);
        self.replies.end_all(PEER_LOST);
    }
}

impl Destination for FarServer {
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
        match Standing::of(self.standing.get()) {
            Standing::Active => None,
            Standing::NotActive => Some(NOT_ACTIVE),
            Standing::Gone => Some(PEER_LOST),
        }
    }
}

/// Why an argument or a place for the result will not do.
fn unfit(arg: *const u8, arg_bytes: usize, range: Option<&RangeCheck>) -> bool {
    lacks(arg, arg_bytes) || range.is_some_and(|range| !range.holds(arg))
}

/// The component whose step would have had to wait is told so; its server's process is not.
#[cold]
fn would_block() -> Outcome {
    misused(Misuse::CalledFromStep);
    WOULD_BLOCK
}

/// A command of a server in another process.
pub(in crate::lcm) struct FarCommand {
    pub(in crate::lcm) server: Arc<FarServer>,
    pub(in crate::lcm) lane: Lane,
    pub(in crate::lcm) range: Option<RangeCheck>,
    pub(in crate::lcm) deadline_ns: u64,
}

impl FarCommand {
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

/// Where the results of a read come from.
pub(in crate::lcm) enum FarSource {
    /// A table its server's process writes at every publication.
    Table(StateReader),
    /// The server's process has to be asked.
    Ask(Arc<dyn Asking>),
}

/// A read of a server in another process.
pub(in crate::lcm) struct FarRead {
    pub(in crate::lcm) server: Arc<FarServer>,
    /// Position among the functions of the connection.
    pub(in crate::lcm) index: u32,
    pub(in crate::lcm) source: FarSource,
    pub(in crate::lcm) arg_bytes: usize,
    pub(in crate::lcm) ret_bytes: usize,
    pub(in crate::lcm) range: Option<RangeCheck>,
    pub(in crate::lcm) deadline_ns: u64,
}

impl FarRead {
    #[inline(never)]
    pub(super) fn call(&self, arg: *const u8, ret: *mut u8, opts: Option<&mut CallOpts>) -> Outcome {
        if unfit(arg, self.arg_bytes, self.range.as_ref()) || lacks(ret, self.ret_bytes) {
            return INVALID_ARGUMENT;
        }
        if self.server.away() == Some(PEER_LOST) {
            return PEER_LOST;
        }
        // SAFETY: not null, and with room for the command's result type, checked when bound; nothing of no bytes.
        let place = |bytes| match bytes {
            0 => &mut [][..],
            // SAFETY: as above.
            _ => unsafe { std::slice::from_raw_parts_mut(ret, bytes) },
        };
        let place = place(self.ret_bytes);
        match &self.source {
            FarSource::Table(table) => match table.latest(place) {
                Some(row) => {
                    if let Some(opts) = opts {
                        opts.stamp_ns = row.stamp_ns;
                    }
                    // Its tick is the outcome.
                    outcome_in(row.tick as i32)
                }
                None => NOT_ACTIVE,
            },
            FarSource::Ask(_) if context::stepping() => would_block(),
            FarSource::Ask(asking) => {
                let arg: &[u8] = match self.arg_bytes {
                    0 => &[],
                    // SAFETY: not null, and an argument of the command's type, checked above.
                    bytes => unsafe { std::slice::from_raw_parts(arg, bytes) },
                };
                let within_ns = within_ns(opts.as_ref().map_or(0, |o| o.deadline_ns), self.deadline_ns);
                let err = opts.as_ref().map_or(std::ptr::null_mut(), |o| o.err);
                let answer = match asking.ask(self.index, arg, within_ns) {
                    Ok(answer) => answer,
                    Err(why) => return why,
                };
                let n = place.len().min(answer.value.len());
                place[..n].copy_from_slice(&answer.value[..n]);
                write_err(err, answer.text.as_bytes());
                if let Some(opts) = opts {
                    opts.stamp_ns = answer.stamp_ns;
                }
                outcome_in(answer.outcome)
            }
        }
    }
}

/// What a server's process may answer to a read; anything else is a failure of it.
fn outcome_in(said: i32) -> Outcome {
    match said {
        EXECUTED | FAILED | INVALID_ARGUMENT | NOT_ACTIVE | DISABLED | PEER_LOST => said,
        _ => FAILED,
    }
}
