//! Stands in for the client of a server that is here: puts its commands into the server's queue, and takes
//! answers, events and results of reads to the other machine.
//!
//! Invariant: a command is put into the queue once and answered once; what is told never overtakes what was
//! published before it.

use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use trocar_lcm_api::LinkDetail;
use trocar_net::line::{Clock, Outbox};
use trocar_plugin_api::abi::{DEADLINE, NOT_ACTIVE, Outcome, PEER_LOST, QUEUE_FULL};
use trocar_rt::mailbox::{EntryHead, Overflow, Push};
use trocar_rt::os;
use trocar_rt::reply::{Reply, Ticket};
use trocar_rt::segment::{Agreed, CallShape, RemoteCalls};
use trocar_rt::state::StateReader;
use trocar_rt::wake::Waker;

use super::super::super::boundary::{Lane, replaced};
use super::super::super::gate::Presence;
use super::super::super::inbox::ENTRY_DUE;
use super::super::super::instance::Instance;
use super::codec::{message, put, put_short, state_of};
use super::{Kind, Link, StandIn, Take};

/// Bytes of rows that the other end has before it is ready.
const MOST_STATE: usize = 1 << 20;

pub(super) struct AbsentClient {
    calls: RemoteCalls,
    /// The commands by their index.
    lanes: Vec<Lane>,
    /// Commands that may wait in the queue of the server.
    depth: u64,
    /// Rung when there is something to send.
    bell: Arc<Waker>,
    book: Mutex<Book>,
    /// Commands that were only sent, and could not be put into the queue.
    refused: AtomicU64,
    /// The server, whose books count commands that come too late.
    server: Weak<Instance>,
}

#[derive(Default)]
struct Book {
    /// The other end is there.
    ready: bool,
    /// It sends no more commands.
    left: bool,
    /// Calls without an answer yet.
    waiting: Vec<Waiting>,
    /// Answers that are not sent yet.
    answers: Vec<Answer>,
    /// Commands that came, and messages that were sent.
    came: u64,
    sent: u64,
    told: Told,
}

/// News that the other end was told.
#[derive(Default)]
struct Told {
    /// Publications of each read's results and sentences.
    results: Vec<u64>,
    whys: Vec<u64>,
    standing: Option<u64>,
    /// Commands that the server has taken, and that had come.
    took: (u64, u64),
}

struct Waiting {
    token: u64,
    until_ns: u64,
    ret_bytes: usize,
    ticket: Ticket,
}

struct Answer {
    token: u64,
    outcome: Outcome,
    value: Vec<u8>,
    text: Vec<u8>,
}

impl Answer {
    fn bare(token: u64, outcome: Outcome) -> Answer {
        Answer { token, outcome, value: Vec::new(), text: Vec::new() }
    }
}

/// Appends the rows that were published since `told`.
fn put_news(all: &[StateReader], told: &mut Vec<u64>, kind: Kind, mut put_row: impl FnMut(Kind, &[u8])) {
    told.resize(all.len(), 0);
    for (index, (table, told)) in all.iter().zip(told).enumerate() {
        let published = table.published();
        if published == *told {
            continue;
        }
        *told = published;
        let mut row = vec![0; table.row_bytes()];
        if let Some(info) = table.latest(&mut row) {
            let mut content = Vec::with_capacity(row.len() + 24);
            put(&mut content, [info.stamp_ns, info.tick]);
            put_short(&mut content, [index as u32]);
            content.extend_from_slice(&row);
            put_row(kind, &content);
        }
    }
}

impl AbsentClient {
    pub(super) fn open(
        memory: OwnedFd,
        shape: &CallShape,
        agreed: Agreed,
        (lanes, bell): (Vec<Lane>, Arc<Waker>),
        server: Weak<Instance>,
    ) -> Result<AbsentClient, String> {
        let calls = RemoteCalls::open(memory, shape, agreed).map_err(|e| e.to_string())?;
        Ok(AbsentClient {
            depth: shape.depth.max(1) as u64,
            calls,
            lanes,
            bell,
            book: Mutex::default(),
            refused: AtomicU64::new(0),
            server,
        })
    }

    /// Handles a command that came.
    fn command(&self, mut content: Take<'_>, clock: &Clock) -> Result<(), String> {
        let [token, time_ns] = [content.u64()?, content.u64()?];
        let [index, kind] = [content.u32()?, content.u32()?];
        let arg = content.rest();
        let lane = self.lanes.get(index as usize).ok_or_else(|| format!("command {index}, which is none"))?;
        if arg.len() != lane.arg_bytes {
            return Err(format!("command {index} with {} bytes, where it has {}", arg.len(), lane.arg_bytes));
        }
        let mut book = self.book.lock();
        book.came += 1;
        // As many as its own queue holds come after the cut, whatever room is here.
        if book.came.saturating_sub(book.told.took.0) > 2 * self.depth {
            return Err("more commands than there is room for".into());
        }
        let head = EntryHead { kind, index, reply: 0, stamp_ns: clock.here(time_ns) };
        match self.put(head, arg, lane.overflow, token != 0) {
            Ok(None) => {}
            Ok(Some(ticket)) => {
                let until_ns = if kind == ENTRY_DUE { head.stamp_ns } else { u64::MAX };
                book.waiting.push(Waiting { token, until_ns, ret_bytes: lane.ret_bytes, ticket });
            }
            Err(outcome) if token != 0 => {
                book.answers.push(Answer::bare(token, outcome));
                self.bell.notify();
            }
            Err(_) => _ = self.refused.fetch_add(1, Ordering::Relaxed),
        }
        Ok(())
    }

    /// Puts a command into the queue of the server; returns the right to the answer, if one is wanted.
    ///
    /// # Errors
    /// The reason why it is not queued.
    fn put(
        &self,
        head: EntryHead,
        arg: &[u8],
        overflow: Overflow,
        is_call: bool,
    ) -> Result<Option<Ticket>, Outcome> {
        let away = || match Presence::of(self.calls.server.get()) {
            Presence::Active => None,
            Presence::NotActive => Some(NOT_ACTIVE),
            Presence::Gone => Some(PEER_LOST),
        };
        let ticket = match is_call {
            true => Some(self.calls.replies.acquire().ok_or(QUEUE_FULL)?),
            false => None,
        };
        let reply = ticket.as_ref().map_or(0, Ticket::token);
        if let Some(away) = away() {
            return Err(self.too_late(away));
        }
        match self.calls.commands.push(EntryHead { reply, ..head }, arg, overflow) {
            Push::Queued => {}
            Push::DroppedOldest(old) => {
                replaced(&self.calls.replies, old.reply);
                self.bell.notify();
            }
            // A full queue counts them itself.
            Push::Full | Push::TooLong => return Err(QUEUE_FULL),
            Push::Closed => return Err(self.too_late(PEER_LOST)),
        }
        self.calls.for_server.notify();
        // The server may have been stopped since: then nobody looks into the queue any more.
        if let Some(away) = away() {
            self.calls.replies.fail(reply, away);
            self.bell.notify();
        }
        Ok(ticket)
    }

    /// Counts a command that comes to nothing in the books of the server.
    fn too_late(&self, outcome: Outcome) -> Outcome {
        if let Some(server) = self.server.upgrade() {
            server.books.lose(false, 1);
        }
        outcome
    }
}

impl Book {
    /// Takes the answers that are there; a call whose time is over is recalled.
    fn take_answers(&mut self) {
        let now_ns = os::now_ns();
        for waiting in std::mem::take(&mut self.waiting) {
            let Waiting { token, until_ns, ret_bytes, ticket } = waiting;
            let (mut value, mut text) = (Vec::new(), Vec::new());
            let taken = ticket.take(|ret, said| {
                value.extend_from_slice(&ret[..ret_bytes.min(ret.len())]);
                text.extend_from_slice(said);
            });
            match taken {
                Ok(Reply::Done(outcome)) => self.answers.push(Answer { token, outcome, value, text }),
                Ok(_) => self.answers.push(Answer::bare(token, DEADLINE)),
                // A call that has not begun by then never will; one that has is carried to its end.
                Err(ticket) => match if now_ns > until_ns { ticket.recall() } else { Err(ticket) } {
                    Ok(()) => self.answers.push(Answer::bare(token, DEADLINE)),
                    Err(ticket) => self.waiting.push(Waiting { token, until_ns, ret_bytes, ticket }),
                },
            }
        }
    }
}

impl StandIn for AbsentClient {
    fn came(&self, kind: Kind, content: Take<'_>, clock: &Clock) -> Result<(), String> {
        match kind {
            Kind::Ready => {
                self.book.lock().ready = true;
                Ok(())
            }
            Kind::Command => self.command(content, clock),
            Kind::Left => {
                self.book.lock().left = true;
                self.bell.notify();
                Ok(())
            }
            other => Err(format!("{other:?} of a client")),
        }
    }

    fn fill(&self, link: Link, out: &mut Outbox) -> bool {
        let mut book = self.book.lock();
        if !book.ready {
            return false;
        }
        // Answers and events first come here and are sent last: rows that were published before are then
        // sent before.
        book.take_answers();
        let mut events = Vec::new();
        self.calls.events.drain(|head, payload| events.push((head.index, payload.to_vec())), |_| ());
        let Book { answers, came, told, sent, .. } = &mut *book;
        let mut rows = 0;
        let mut put_row = |kind, content: &[u8]| {
            rows += 1;
            message(out, link, kind, |bytes| bytes.extend_from_slice(content));
        };
        put_news(&self.calls.whys, &mut told.whys, Kind::Why, &mut put_row);
        put_news(&self.calls.reads, &mut told.results, Kind::Result, &mut put_row);
        *sent += rows + (events.len() + answers.len()) as u64;
        let standing = self.calls.server.get();
        if told.standing.replace(standing) != Some(standing) {
            *sent += 1;
            message(out, link, Kind::Standing, |bytes| put(bytes, [standing]));
        }
        for (index, payload) in events {
            message(out, link, Kind::Event, |bytes| {
                put_short(bytes, [index]);
                bytes.extend_from_slice(&payload);
            });
        }
        for Answer { token, outcome, value, text } in answers.drain(..) {
            message(out, link, Kind::Answer, |bytes| {
                put(bytes, [token]);
                put_short(bytes, [outcome.cast_unsigned(), value.len() as u32]);
                bytes.extend_from_slice(&value);
                bytes.extend_from_slice(&text);
            });
        }
        let took = came.saturating_sub(self.calls.commands.stats().queued);
        let now = (took, *came);
        if std::mem::replace(&mut told.took, now) != now {
            message(out, link, Kind::Took, |bytes| put(bytes, [took, *came]));
        }
        false
    }

    fn state(&self) -> Vec<u8> {
        let (mut state, mut rows) = (Vec::new(), 0);
        let mut put_row = |kind, content: &[u8]| {
            rows += 1;
            state_of(&mut state, kind, content);
        };
        put_news(&self.calls.whys, &mut Vec::new(), Kind::Why, &mut put_row);
        put_news(&self.calls.reads, &mut Vec::new(), Kind::Result, &mut put_row);
        if state.len() > MOST_STATE {
            // They come when the other end is ready.
            (state, rows) = (Vec::new(), 0);
        }
        state_of(&mut state, Kind::Standing, &self.calls.server.get().to_le_bytes());
        self.book.lock().sent += rows + 1;
        state
    }

    fn correct(&self, detail: &mut LinkDetail) {
        detail.unexecuted += self.refused.load(Ordering::Relaxed);
        let book = self.book.lock();
        let is_new = |tables: &[StateReader], told: &[u64]| {
            let told = told.iter().copied().chain(std::iter::repeat(0));
            tables.iter().zip(told).filter(|(table, told)| table.published() != *told).count() as u64
        };
        let news = is_new(&self.calls.reads, &book.told.results) + is_new(&self.calls.whys, &book.told.whys);
        let stands = u64::from(book.told.standing != Some(self.calls.server.get()));
        detail.sent = book.sent + book.answers.len() as u64 + news + stands;
        // Events that found the queue on this side full.
        let lost = self.calls.events.stats().rejected;
        detail.dropped += lost;
        detail.rejected += lost;
    }

    fn is_over(&self) -> bool {
        let book = self.book.lock();
        // Commands that are on their way still come, and are answered or counted.
        book.left && book.waiting.is_empty() && book.answers.is_empty()
    }
}
