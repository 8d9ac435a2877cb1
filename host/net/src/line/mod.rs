//! Lines: encrypted connections between two processes of different machines, on which messages pass both
//! ways.
//!
//! A line has two lanes, each a connection of its own: one for what is short and awaited, one for what is
//! long ([`Lane`]). Each lane has two threads at each end: one receives (`trocar-line`, `trocar-bulk`), one
//! sends (`trocar-line-out`, `trocar-bulk-out`), woken through the lane's bell. What passes is the business
//! of the line's user. Invariant: a line lives as long as both its lanes; one that was given up stays given
//! up, and the next one with the same process is another.

mod clock;
mod door;
mod greeting;
mod guests;
mod lane;
mod lines;
mod run;
#[cfg(test)]
mod tests;
mod urgency;
mod wire;

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;
use trocar_rt::wake::Waker;

use crate::holder::Holder;
pub use clock::Clock;
pub use greeting::Who;
pub use lane::Lane;
pub use lines::{Ends, Lines, Place};
use wire::Wire;
pub use wire::{MOST_BYTES, Outbox};

/// Most bytes of messages that wait to be sent.
const MOST_WAITING: usize = 4 << 20;

/// A live connection with one run of a process. Any thread may speak.
pub struct Line {
    number: u64,
    who: Who,
    holder: Holder,
    clock: Clock,
    said: Mutex<Said>,
    prompt: Track,
    bulk: Track,
    /// Bytes/s of the bulk lane.
    most_rate: Option<u64>,
    lost: AtomicBool,
    why: Mutex<Option<String>>,
}

/// A lane, as it is made.
struct Track {
    wire: Wire,
    bell: Arc<Waker>,
}

impl Track {
    fn new(wire: Wire) -> Track {
        Track { wire, bell: Arc::new(Waker::new()) }
    }
}

#[derive(Default)]
struct Said {
    all: VecDeque<(u8, Vec<u8>)>,
    bytes: usize,
}

/// Why something was not said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsaid {
    /// The other end does not take what was said before.
    Busy,
    Lost,
}

impl fmt::Display for Unsaid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Unsaid::Busy => "the other process does not take what it was told before",
            Unsaid::Lost => "the other process is gone",
        })
    }
}

impl Line {
    /// Number in this process: no two lines have the same.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The process at the other end.
    pub fn who(&self) -> &Who {
        &self.who
    }

    /// The clock of the other end.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Wakes the thread that sends on this lane: there is something to send.
    pub fn bell(&self, lane: Lane) -> &Arc<Waker> {
        &self.track(lane).bell
    }

    fn track(&self, lane: Lane) -> &Track {
        match lane {
            Lane::Prompt => &self.prompt,
            Lane::Bulk => &self.bulk,
        }
    }

    /// Tells whether it was given up, for good.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Acquire)
    }

    /// Says something on the prompt lane, before whatever [`Traffic::fill`] adds later. Never waits.
    ///
    /// # Errors
    /// Too much waits already, or the line is gone.
    pub fn say(&self, kind: u8, content: Vec<u8>) -> Result<(), Unsaid> {
        if self.is_lost() {
            return Err(Unsaid::Lost);
        }
        let mut said = self.said.lock();
        // One message goes however long it is.
        if said.bytes > 0 && said.bytes + content.len() > MOST_WAITING {
            return Err(Unsaid::Busy);
        }
        said.bytes += content.len();
        said.all.push_back((kind, content));
        drop(said);
        self.prompt.bell.notify();
        Ok(())
    }

    /// Ends it; the first reason stays.
    pub fn end(&self, why: &str) {
        self.why.lock().get_or_insert_with(|| why.to_owned());
        self.lost.store(true, Ordering::Release);
        for track in [&self.prompt, &self.bulk] {
            track.wire.end();
            track.bell.notify();
        }
    }

    fn why(&self) -> String {
        self.why.lock().clone().unwrap_or_default()
    }
}

impl fmt::Debug for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Line").field("number", &self.number).field("who", &self.who).finish_non_exhaustive()
    }
}

/// The user of all lines of a process. Told on the threads of the lines.
pub trait Handler: Send + Sync + 'static {
    /// A line came about; returns whoever speaks and listens on it.
    fn met(&self, line: &Arc<Line>) -> Arc<dyn Traffic>;
    /// It is gone. Nothing comes of it any more.
    fn lost(&self, line: &Arc<Line>, why: &str);
}

/// The messages of one line.
pub trait Traffic: Send + Sync {
    /// Takes in a message. The thread that receives on this lane: whatever waits here keeps the lane's next
    /// messages waiting.
    ///
    /// # Errors
    /// It is none that the other end may send: the line ends.
    fn came(&self, lane: Lane, kind: u8, content: &[u8]) -> Result<(), String>;

    /// Appends what is to be sent now on this lane; the thread that sends there, after each ring of the
    /// lane's bell and at each beat. Returns true when there is more than was appended.
    fn fill(&self, lane: Lane, out: &mut Outbox) -> bool;
}
