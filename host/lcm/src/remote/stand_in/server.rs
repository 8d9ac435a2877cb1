//! Stands in for the server of a client that is here: takes its commands to the other machine, and gives it
//! the answers, events and results of reads that come from there.
//!
//! Invariant: a command goes to the other machine once. A call that was sent is under way for its
//! caller: what runs into its deadline may still run. There are never more commands on their way than
//! the server's queue has room for: a client that sends more finds its own queue full.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use trocar_lcm_api::LinkDetail;
use trocar_net::line::{Clock, Outbox};
use trocar_plugin_api::abi::PEER_LOST;
use trocar_rt::mailbox::{EntryHead, Overflow};
use trocar_rt::reply::{ReplyPool, Running};
use trocar_rt::segment::{Agreed, CallShape, ServedCalls};
use trocar_rt::state::StateWriter;
use trocar_rt::wake::Waker;

use super::super::super::boundary::replaced;
use super::super::super::inbox::ENTRY_EVENT;
use super::codec::{message, put, put_short};
use super::{Kind, Link, StandIn, Take};

pub(super) struct AbsentServer {
    calls: ServedCalls,
    /// Commands that may be on their way, or wait there.
    depth: u64,
    /// Bytes of results of each read.
    tables: Mutex<Tables>,
    book: Mutex<Book>,
    /// Rung when there is something to send.
    bell: Arc<Waker>,
    /// Messages that came.
    came: AtomicU64,
}

struct Tables {
    results: Vec<StateWriter>,
    whys: Vec<StateWriter>,
}

#[derive(Default)]
struct Book {
    /// Calls that were sent, by their tokens.
    running: BTreeMap<u64, Running<Arc<ReplyPool>>>,
    sent: u64,
    /// The connection is cut; then whether the other end was told.
    leaving: bool,
    left: bool,
    /// Commands the server has taken out of its queue, and those that have come there.
    took: u64,
    arrived: u64,
}

impl AbsentServer {
    /// Makes it, and its memory.
    pub(super) fn create(
        shape: &CallShape,
        agreed: Agreed,
        bell: Arc<Waker>,
    ) -> io::Result<(AbsentServer, OwnedFd)> {
        let mut calls = ServedCalls::create(shape, agreed)?;
        let memory =
            calls.fd().ok_or_else(|| io::Error::other("memory without a file"))?.try_clone_to_owned()?;
        let (results, whys) = (std::mem::take(&mut calls.reads), std::mem::take(&mut calls.whys));
        let tables = Mutex::new(Tables { results, whys });
        let server = AbsentServer {
            calls,
            depth: shape.depth.max(1) as u64,
            tables,
            book: Mutex::default(),
            bell,
            came: AtomicU64::new(0),
        };
        Ok((server, memory))
    }

    /// Gives a caller its answer.
    fn answer(&self, mut content: Take<'_>) -> Result<(), String> {
        let token = content.u64()?;
        let [outcome, value_bytes] = [content.u32()?, content.u32()?];
        let (value, said) = (content.bytes(value_bytes as usize)?, content.rest());
        // No such call is under way: it was answered when the connection was cut.
        let Some(running) = self.book.lock().running.remove(&token) else { return Ok(()) };
        running.finish(outcome.cast_signed(), |ret, text| {
            let (n, said_bytes) = (value.len().min(ret.len()), said.len().min(text.len()));
            ret[..n].copy_from_slice(&value[..n]);
            text[..said_bytes].copy_from_slice(&said[..said_bytes]);
            said_bytes
        });
        Ok(())
    }

    fn row(&self, kind: Kind, mut content: Take<'_>, clock: &Clock) -> Result<(), String> {
        let [stamp_ns, tick] = [content.u64()?, content.u64()?];
        let index = content.u32()? as usize;
        let row = content.rest();
        let mut tables = self.tables.lock();
        let Tables { results, whys } = &mut *tables;
        let all = if kind == Kind::Why { whys } else { results };
        let table = all.get_mut(index).ok_or_else(|| format!("a row of read {index}, which is none"))?;
        let mut fits = false;
        table.publish_with(|room| {
            fits = room.len() == row.len();
            if fits {
                room.copy_from_slice(row);
            }
            fits.then(|| (clock.here(stamp_ns), tick))
        });
        if fits {
            Ok(())
        } else {
            Err(format!("a row of {} bytes, of another size than the read has", row.len()))
        }
    }
}

impl StandIn for AbsentServer {
    fn came(&self, kind: Kind, mut content: Take<'_>, clock: &Clock) -> Result<(), String> {
        match kind {
            Kind::Answer => self.answer(content)?,
            Kind::Event => {
                let index = content.u32()?;
                let head = EntryHead { kind: ENTRY_EVENT, index, reply: 0, stamp_ns: 0 };
                // A full queue counts it.
                let _ = self.calls.events.push(head, content.rest(), Overflow::Reject);
                self.calls.for_client.notify();
            }
            Kind::Result | Kind::Why => self.row(kind, content, clock)?,
            Kind::Standing => self.calls.server.set(content.u64()?),
            Kind::Took => {
                let mut book = self.book.lock();
                (book.took, book.arrived) = (content.u64()?, content.u64()?);
                drop(book);
                self.bell.notify();
            }
            other => return Err(format!("{other:?} of a server")),
        }
        if kind != Kind::Took {
            self.came.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn fill(&self, link: Link, out: &mut Outbox) -> bool {
        let mut book = self.book.lock();
        let Book { running, sent, took, leaving, left, .. } = &mut *book;
        let mut room = self.depth.saturating_sub(sent.saturating_sub(*took));
        if *leaving {
            // The other end takes what was sent before the cut, and counts what it does not carry out.
            room = u64::MAX;
        }
        if room == 0 {
            return false;
        }
        if *leaving {
            // A caller that was just inside the old binding is told so, or its command goes along.
            self.calls.commands.seal();
        }
        let send = |head: EntryHead, arg: &[u8]| {
            if head.reply != 0 {
                // A caller that has given up wants nothing done any more.
                let Some(call) = self.calls.replies.begin_kept(head.reply, PEER_LOST) else { return };
                running.insert(head.reply, call);
            }
            *sent += 1;
            message(out, link, Kind::Command, |bytes| {
                put(bytes, [head.reply, head.stamp_ns]);
                put_short(bytes, [head.index, head.kind]);
                bytes.extend_from_slice(arg);
            });
        };
        let skip = |head: EntryHead| replaced(&self.calls.replies, head.reply);
        self.calls.commands.drain_some(room as usize, send, skip);
        // An entry that is just being pushed was told that it is queued: it goes the next time.
        if *leaving && !*left && self.calls.commands.is_empty() {
            *left = true;
            message(out, link, Kind::Left, |_| ());
        }
        false
    }

    fn correct(&self, detail: &mut LinkDetail) {
        detail.came = self.came.load(Ordering::Relaxed);
    }

    /// Commands that wait here, and that are not known to have come there.
    fn lost(&self) -> u64 {
        let book = self.book.lock();
        self.calls.commands.stats().queued + book.sent.saturating_sub(book.arrived)
    }

    fn leave(&self) {
        self.book.lock().leaving = true;
    }

    fn is_over(&self) -> bool {
        let book = self.book.lock();
        book.left && book.running.is_empty()
    }
}
