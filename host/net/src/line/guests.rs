//! Lines that other processes have begun.
//!
//! Invariant: a process has one, its newest; a second connection belongs to the line of the same run of the
//! same process, under the same certificate, or to none.

use std::collections::{BTreeMap, BTreeSet};
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

fn full() -> Refused {
    let why = format!("{MOST_GUESTS} processes have lines to this one, which is as many as it takes");
    Refused { why, for_long: true }
}

impl Guests {
    /// Expects the second connection of a line that is begun.
    ///
    /// # Errors
    /// There are as many lines as this process takes.
    pub(super) fn await_second(&self, line: u64, who: &Who, holder: &Holder) -> Result<Awaited<'_>, Refused> {
        let (give, second) = sync_channel(1);
        let half = Half { who: who.clone(), serial: holder.serial.clone(), give };
        let mut halves = self.halves.lock();
        // An older one of the same process waits for nothing any more.
        halves.retain(|_, half| half.who.process != who.process);
        let live = self.live.lock();
        let lines = live.iter().filter(|line| !line.is_lost()).map(|line| &line.who);
        let processes: BTreeSet<&str> =
            lines.chain(halves.values().map(|half| &half.who)).map(|who| who.process.as_str()).collect();
        if processes.len() >= MOST_GUESTS && !processes.contains(who.process.as_str()) {
            return Err(full());
        }
        drop(live);
        halves.insert(line, half);
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
        if live.len() >= MOST_GUESTS {
            return Err(full());
        }
        live.push(line.clone());
        Ok(())
    }

    pub(super) fn remove(&self, line: &Arc<Line>) {
        self.live.lock().retain(|other| !Arc::ptr_eq(other, line));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Duration;

    use super::*;
    use crate::role::Role;

    fn who(process: &str) -> (Who, Holder) {
        let serial = process.as_bytes().to_vec();
        let holder =
            Holder { name: process.into(), role: Role::Host, processes: vec![process.into()], serial };
        (Who { process: process.into(), instance: "1".into() }, holder)
    }

    #[test]
    fn a_process_that_begins_anew_waits_for_one_second_connection_alone() {
        let guests = Guests::default();
        let (cart, holder) = who("cart");
        let first = guests.await_second(1, &cart, &holder).ok().unwrap();
        let other = who("other");
        let others = guests.await_second(2, &other.0, &other.1).ok().unwrap();
        let second = guests.await_second(3, &cart, &holder).ok().unwrap();
        // A watchdog, not a claim: the first ends at once, since nobody can give it anything any more.
        let until = Instant::now() + Duration::from_secs(60);
        assert!(first.wait(until).is_none() && Instant::now() < until);
        assert_eq!(guests.halves.lock().keys().copied().collect::<Vec<_>>(), [2, 3]);
        drop((first, second, others));
        assert!(guests.halves.lock().is_empty());
    }

    #[test]
    fn half_begun_lines_take_places_and_no_more_than_there_are() {
        let guests = Guests::default();
        let all: Vec<_> = (0..MOST_GUESTS as u64)
            .map(|n| {
                let (who, holder) = who(&format!("p{n}"));
                guests.await_second(n, &who, &holder).ok().unwrap()
            })
            .collect();
        let (one, holder) = who("one");
        let refused = guests.await_second(9999, &one, &holder).err().unwrap();
        assert!(refused.for_long && refused.why.contains("as many as it takes"), "{}", refused.why);
        drop(all);
        assert!(guests.await_second(9999, &one, &holder).is_ok());
    }
}
