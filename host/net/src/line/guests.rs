//! Lines that other processes have begun.
//!
//! Invariant: a process has one, its newest; a second connection belongs to the line of the same run of the
//! same process, under the same certificate, or to none.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

use parking_lot::Mutex;

use super::Line;
use super::greeting::{Refused, Who, hello, turn_away};
use super::wire::{Inbox, Wire};
use crate::holder::Holder;

/// Processes that may have begun a line to this one.
const MOST_GUESTS: usize = 256;

/// The second connection of a line, greeted.
pub(super) struct Second {
    pub(super) who: Who,
    /// Serial number of the certificate.
    pub(super) serial: Vec<u8>,
    pub(super) wire: Wire,
    pub(super) inbox: Inbox,
}

struct Half {
    who: Who,
    serial: Vec<u8>,
    give: SyncSender<Second>,
}

#[derive(Default)]
pub(super) struct Guests {
    live: Mutex<Vec<Arc<Line>>>,
    /// Lines that lack their second connection, by their number.
    halves: Mutex<BTreeMap<u64, Half>>,
}

/// A line that lacks its second connection.
pub(super) struct Awaited<'a> {
    guests: &'a Guests,
    line: u64,
    second: Receiver<Second>,
}

impl Awaited<'_> {
    pub(super) fn wait(&self, until: Instant) -> Option<Second> {
        self.second.recv_timeout(until.saturating_duration_since(Instant::now())).ok()
    }
}

impl Drop for Awaited<'_> {
    fn drop(&mut self) {
        self.guests.halves.lock().remove(&self.line);
    }
}

impl Guests {
    /// Expects the second connection of a line that is begun.
    ///
    /// # Errors
    /// There are as many lines as this process takes.
    pub(super) fn await_second(&self, line: u64, who: &Who, holder: &Holder) -> Result<Awaited<'_>, Refused> {
        self.has_room(who)?;
        let (give, second) = sync_channel(1);
        let half = Half { who: who.clone(), serial: holder.serial.clone(), give };
        self.halves.lock().insert(line, half);
        Ok(Awaited { guests: self, line, second })
    }

    /// Hands a second connection to the line that it belongs to.
    ///
    /// # Errors
    /// No such line waits for it.
    pub(super) fn join(&self, line: u64, second: Second, own: &Who) -> Result<(), Refused> {
        let mut halves = self.halves.lock();
        let is_of = |half: &Half| half.who == second.who && half.serial == second.serial;
        let Some(half) = halves.get(&line).is_some_and(is_of).then(|| halves.remove(&line)).flatten() else {
            drop(halves);
            let why = format!("it has no line here that waits for a second connection, {line} least of all");
            let refused = Refused::from(why);
            turn_away(&second.wire, &refused);
            return Err(refused);
        };
        drop(halves);
        hello(&second.wire, own, line)?;
        // Whoever waited may have given up.
        let _ = half.give.send(second);
        Ok(())
    }

    /// Takes in a line; an older one of the same process ends.
    ///
    /// # Errors
    /// There are as many lines as this process takes.
    pub(super) fn add(&self, line: &Arc<Line>) -> Result<(), Refused> {
        let mut live = self.live.lock();
        let before = live.iter().filter(|other| other.who.process == line.who.process);
        before.for_each(|other| other.end("that process has called anew"));
        live.retain(|other| !other.is_lost());
        drop(live);
        self.has_room(&line.who)?;
        self.live.lock().push(line.clone());
        Ok(())
    }

    fn has_room(&self, who: &Who) -> Result<(), Refused> {
        let live = self.live.lock();
        let others = live.iter().filter(|other| other.who.process != who.process).count();
        match others < MOST_GUESTS {
            true => Ok(()),
            false => {
                let why =
                    format!("{MOST_GUESTS} processes have lines to this one, which is as many as it takes");
                Err(Refused { why, for_long: true })
            }
        }
    }

    pub(super) fn remove(&self, line: &Arc<Line>) {
        self.live.lock().retain(|other| !Arc::ptr_eq(other, line));
    }
}
