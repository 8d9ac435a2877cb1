//! Everything that happened in a run, and what must never happen.
//!
//! Invariant: it looks at processes themselves and at answers, never at what a manager believes.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use parking_lot::Mutex;
use trocar::gcm::{Answer, Record};
use trocar_model::{ClassInfo, ComponentId, Connection, ConnectionId, Entry, Request, Safety, Target};

use crate::goes_on::{GoesOn, Rest};
use crate::ids::{Ids, Turn};

/// Kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Kind {
    Asked,
    Answered,
    Sent,
    Ordered,
    Written,
    Fails,
    Ended,
    Began,
    Network,
    Moves,
    Rests,
}

#[derive(Clone)]
pub(crate) struct Truth(Arc<Mutex<Happened>>);

#[derive(Default)]
struct Happened {
    events: u64,
    hash: u64,
    /// Events are told as they happen.
    is_told: bool,
    violation: Option<String>,
    /// Components that move.
    moving: BTreeSet<ComponentId>,
    /// Requests to set something in motion, by the event at which they were asked.
    starts: BTreeMap<u64, Start>,
    /// Stops that were answered, the last one last.
    stops: VecDeque<Stopped>,
    /// Event at which each incarnation of a process began.
    began: BTreeMap<u64, u64>,
    /// Events at which Stops came on record, by what they name.
    recorded_stops: BTreeMap<Vec<Target>, u64>,
    /// Revisions that are on record.
    recorded: BTreeSet<u64>,
    /// Revisions of accepted changes that are not on record yet.
    unrecorded: BTreeSet<u64>,
    /// Revisions that accepted changes expected.
    expected: BTreeMap<u64, String>,
    /// Revisions of accepted changes.
    accepted: BTreeMap<u64, String>,
    /// A manager was lost with decisions that were in memory alone: until the next rest the one after it does
    /// not know all that there is.
    is_blind: bool,
    /// Components as the last accepted request has left them.
    left: BTreeMap<ComponentId, Left>,
    /// Event before which nothing is known of others: an answer from memory to what was asked before says
    /// nothing of them.
    left_since: u64,
    goes_on: GoesOn,
    ids: Ids,
    /// Times that each kind of thing has happened.
    counts: BTreeMap<String, u64>,
}

struct Start {
    targets: Vec<Target>,
    /// Nobody knows yet what becomes of it.
    is_open: bool,
}

struct Stopped {
    /// Event at which it was asked.
    asked: u64,
    targets: Vec<Target>,
    /// Components that it did not reach, as its answer says.
    failed: BTreeSet<ComponentId>,
    /// Components of which it speaks: those of its answer, and those that were made by an accepted request.
    speaks_of: BTreeSet<ComponentId>,
    /// Event at which it was answered.
    answered: u64,
    /// It is on record.
    is_recorded: bool,
}

impl Stopped {
    fn holds(&self, id: &ComponentId) -> bool {
        self.speaks_of.contains(id)
            && !self.failed.contains(id)
            && self.targets.iter().any(|target| target.names(id))
    }
}

/// A component after an accepted request.
#[derive(Clone, Debug)]
struct Left {
    revision: u64,
    /// Its setting; `None`: it is removed.
    gain: Option<f64>,
    /// Event until which something was under way whose result nobody knows.
    unknown: Option<u64>,
}

/// End of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    pub events: u64,
    /// Hash of all events and their times: two runs with the same one are the same.
    pub hash: u64,
    pub violation: Option<String>,
    /// Times that each kind of request was answered so, and that things failed.
    pub counts: BTreeMap<String, u64>,
}

impl Truth {
    pub(crate) fn new(is_told: bool) -> Truth {
        Truth(Arc::new(Mutex::new(Happened { is_told, ..Happened::default() })))
    }

    /// Notes an event; returns its number.
    pub(crate) fn event(&self, kind: Kind, what: impl FnOnce() -> String) -> u64 {
        let mut happened = self.0.lock();
        happened.events += 1;
        let mut hasher = DefaultHasher::new();
        (happened.hash, kind, began().elapsed()).hash(&mut hasher);
        happened.hash = hasher.finish();
        if happened.is_told && happened.violation.is_none() {
            let ms = began().elapsed().as_secs_f64() * 1e3;
            println!("{:>7} {ms:>12.3} ms {kind:?}: {}", happened.events, what());
        }
        happened.events
    }

    pub(crate) fn events(&self) -> u64 {
        self.0.lock().events
    }

    pub(crate) fn violated(&self, what: String) {
        self.0.lock().violated(what);
    }

    pub(crate) fn is_violated(&self) -> bool {
        self.0.lock().violation.is_some()
    }

    pub(crate) fn ended(&self) -> Ended {
        let happened = self.0.lock();
        Ended {
            events: happened.events,
            hash: happened.hash,
            violation: happened.violation.clone(),
            counts: happened.counts.clone(),
        }
    }

    /// Counts one more of a kind.
    pub(crate) fn counts(&self, kind: String) {
        *self.0.lock().counts.entry(kind).or_default() += 1;
    }

    // -- motion --------------------------------------------------------------------------------------------

    /// Somebody asks for something to be set in motion.
    pub(crate) fn start_asked(&self, event: u64, targets: Vec<Target>) {
        self.0.lock().starts.insert(event, Start { targets, is_open: true });
    }

    /// It was answered.
    pub(crate) fn start_answered(&self, event: u64) {
        if let Some(start) = self.0.lock().starts.get_mut(&event) {
            start.is_open = false;
        }
    }

    /// Somebody asks for this, by which something else may end.
    pub(crate) fn end_asked(&self, event: u64, requests: &[Request]) {
        self.0.lock().goes_on.asked(event, requests);
    }

    /// It was answered, and nothing of it is done later.
    pub(crate) fn end_answered(&self, event: u64) {
        let mut happened = self.0.lock();
        let now = happened.events;
        happened.goes_on.closed(event, now);
    }

    /// A component was set in motion by an accepted request, asked at that event.
    pub(crate) fn started(&self, id: &ComponentId, asked: u64, is_first: bool) {
        let mut happened = self.0.lock();
        if happened.is_blind {
            return;
        }
        let moves = happened.moving.contains(id);
        if let Some(wrong) = happened.goes_on.started(id, (asked, is_first), moves) {
            happened.violated(wrong);
        }
    }

    /// A connection was accepted, asked for at that event.
    pub(crate) fn connected(&self, connection: &Connection, asked: u64) {
        let mut happened = self.0.lock();
        if !happened.is_blind {
            happened.goes_on.connected(connection, asked);
        }
    }

    /// A component has failed when it was to be set in motion.
    pub(crate) fn failed(&self, id: &ComponentId) {
        let mut happened = self.0.lock();
        let now = happened.events;
        happened.goes_on.failed(id, now);
    }

    /// A component has refused something, and stays so until somebody asks again.
    pub(crate) fn refused(&self, id: &ComponentId) {
        let mut happened = self.0.lock();
        let now = happened.events;
        happened.goes_on.refused(id, now);
    }

    /// Tells whether a component has refused something since these incarnations of processes have begun.
    pub(crate) fn has_refused(&self, id: &ComponentId, incarnations: &[u64]) -> bool {
        let happened = self.0.lock();
        let began = incarnations.iter().filter_map(|number| happened.began.get(number)).max();
        happened.goes_on.has_refused(id, began.copied().unwrap_or_default())
    }

    /// A Stop, asked at that event, was answered: everything that it names stands still, but for what failed.
    /// `told`: components of which its answer speaks.
    pub(crate) fn stopped(
        &self,
        asked: u64,
        targets: Vec<Target>,
        failed: BTreeSet<ComponentId>,
        told: BTreeSet<ComponentId>,
    ) {
        let mut happened = self.0.lock();
        let mut speaks_of = told;
        if !happened.is_blind {
            let there =
                happened.left.iter().filter(|(_, left)| left.gain.is_some() && left.unknown.is_none());
            speaks_of.extend(there.map(|(id, _)| id.clone()));
        }
        let (answered, is_recorded) =
            (happened.events, happened.recorded_stops.get(&targets).is_some_and(|at| *at > asked));
        let stopped = Stopped { asked, targets, failed, speaks_of, answered, is_recorded };
        let started_since = |id: &ComponentId| {
            let mut since = happened.starts.range(asked..);
            since.any(|(_, start)| start.targets.iter().any(|target| target.names(id)))
        };
        let moves = |id: &&ComponentId| stopped.holds(id) && !started_since(id);
        if let Some(id) = happened.moving.iter().find(moves).cloned() {
            happened.violated(format!("{id} moves although a Stop asked at event {asked} was answered"));
        }
        happened.stops.push_back(stopped);
        if happened.stops.len() > 256 {
            happened.stops.pop_front();
        }
    }

    /// A component is set in motion.
    pub(crate) fn moves(&self, id: &ComponentId, class: &ClassInfo, incarnation: u64) {
        self.event(Kind::Moves, || format!("{id} moves, in incarnation {incarnation}"));
        let mut happened = self.0.lock();
        happened.moving.insert(id.clone());
        happened.goes_on.moves(id);
        let began = happened.began.get(&incarnation).copied().unwrap_or_default();
        // The answer to a Stop waits a moment for its record, and no longer. Of one that a manager has lost
        // and that the process cannot know of, since it began later, nobody knows.
        let counts = |stop: &&Stopped| stop.holds(id) && (stop.is_recorded || stop.answered > began);
        let stop = happened.stops.iter().rev().find(counts).map_or(0, |stop| stop.asked);
        let is_actuator = class.safety == Safety::Actuator;
        let mut asked = happened.starts.range(stop..);
        let is_asked = asked.any(|(_, start)| {
            (start.is_open || !is_actuator) && start.targets.iter().any(|target| target.names(id))
        });
        if !is_asked {
            let since =
                if stop > 0 { format!(" since the Stop asked at event {stop}") } else { String::new() };
            happened.violated(format!("{id} is set in motion, which nobody asks for{since}"));
        }
    }

    /// An incarnation of a process begins.
    pub(crate) fn begins(&self, incarnation: u64, event: u64) {
        self.0.lock().began.insert(incarnation, event);
    }

    /// A component stands still, or is gone.
    pub(crate) fn stands(&self, id: &ComponentId, how: Rest, class: &ClassInfo) {
        let mut happened = self.0.lock();
        if !happened.moving.remove(id) {
            return;
        }
        let now = happened.events;
        if let Some(wrong) = happened.goes_on.stands(id, how, class.safety, now) {
            happened.violated(wrong);
        }
    }

    // -- request ids ---------------------------------------------------------------------------------------

    /// Somebody asks a manager for something under an id, at that event.
    pub(crate) fn id_asked(&self, id: &str, requests: &[Request], manager: u64, event: u64) -> Turn {
        self.0.lock().ids.asked(id, format!("{requests:?}"), manager, event)
    }

    /// It was answered.
    pub(crate) fn id_answered(&self, id: &str, turn: Turn, answer: &Answer) {
        let mut happened = self.0.lock();
        if let Some(wrong) = happened.ids.answered(id, turn, answer) {
            happened.violated(wrong);
        }
    }

    // -- records -------------------------------------------------------------------------------------------

    pub(crate) fn on_record(&self, record: &Record) {
        let twice = self.0.lock().ids.on_record(record);
        twice.into_iter().for_each(|wrong| self.violated(wrong));
        if let Entry::Stopped { targets, .. } = &record.entry {
            let mut happened = self.0.lock();
            let event = happened.events;
            happened.recorded_stops.insert(targets.clone(), event);
            let same = happened.stops.iter_mut().filter(|stop| stop.targets == *targets);
            same.for_each(|stop| stop.is_recorded = true);
        }
        if let Some(revision) = record.entry.revision() {
            let mut happened = self.0.lock();
            happened.recorded.insert(revision);
            happened.unrecorded.remove(&revision);
        }
    }

    /// A request that changes something was accepted. `on_record`: its record is to be on the disk.
    /// `expected`: revision that it was to be asked at.
    pub(crate) fn accepted(&self, revision: u64, expected: Option<u64>, what: &str, on_record: bool) {
        let mut happened = self.0.lock();
        let first = expected.and_then(|expected| happened.expected.insert(expected, what.to_owned()));
        if let Some(first) = first {
            happened.violated(format!("{what} and {first} have both passed at revision {expected:?}"));
        }
        if on_record && !happened.recorded.contains(&revision) {
            happened
                .violated(format!("{what} was answered with revision {revision}, which is not on record"));
        }
        if !happened.recorded.contains(&revision) {
            happened.unrecorded.insert(revision);
        }
        if let Some(other) = happened.accepted.insert(revision, what.to_owned()) {
            happened.violated(format!("{what} and {other} have both revision {revision}"));
        }
    }

    /// A component is left so by the accepted request of that revision.
    /// `asked`: event at which that was asked.
    pub(crate) fn left(&self, id: &ComponentId, asked: u64, revision: u64, gain: Option<f64>) {
        let mut happened = self.0.lock();
        let since = happened.left_since;
        match happened.left.get_mut(id) {
            Some(left) if left.revision > revision => {}
            Some(left) => {
                (left.revision, left.gain) = (revision, gain);
                // Whatever was under way before it was asked.
                left.unknown.take_if(|until| asked > *until);
            }
            None if asked < since => {}
            None => _ = happened.left.insert(id.clone(), Left { revision, gain, unknown: None }),
        }
    }

    /// Nobody knows what became of a request that would change the component.
    pub(crate) fn unknown(&self, id: &ComponentId) {
        let mut happened = self.0.lock();
        let now = happened.events;
        let left = Left { revision: 0, gain: None, unknown: None };
        happened.left.entry(id.clone()).or_insert(left).unknown = Some(now);
    }

    /// Returns how a component differs from what the last accepted request has left.
    pub(crate) fn differs(&self, id: &ComponentId, gain: Option<f64>) -> Option<String> {
        let happened = self.0.lock();
        let left = happened.left.get(id).filter(|left| left.unknown.is_none())?;
        let differs = left.gain != gain;
        differs.then(|| format!("{id} has gain {gain:?}, and {left:?} was the last accepted"))
    }

    /// A manager was lost with decisions that were in memory alone.
    pub(crate) fn forgets(&self) {
        let mut happened = self.0.lock();
        happened.accepted.clear();
        happened.expected.clear();
        happened.left.clear();
        happened.left_since = happened.events;
        happened.unrecorded.clear();
        happened.goes_on.forgets();
        happened.is_blind = true;
    }

    /// Returns what was accepted and is not there at rest, when these connections are on record.
    pub(crate) fn missing(&self, connections: &BTreeMap<ConnectionId, Connection>) -> Vec<String> {
        let happened = self.0.lock();
        let (moves, on_record) =
            (|id: &ComponentId| happened.moving.contains(id), |id| connections.get(&ConnectionId(id)));
        let mut wrong = happened.goes_on.at_rest(moves, on_record);
        let late = happened.unrecorded.iter();
        wrong.extend(late.map(|revision| format!("revision {revision} was answered, and is not on record")));
        wrong
    }

    /// Everything is at rest: what is open stays so, and components and connections are as they are.
    pub(crate) fn rests(&self, connections: &BTreeMap<ConnectionId, Connection>) {
        self.event(Kind::Rests, || "everything rests".into());
        let mut happened = self.0.lock();
        happened.left.retain(|_, left| left.unknown.is_none());
        happened.left_since = happened.events;
        happened.is_blind = false;
        let (now, moving) = (happened.events, happened.moving.clone());
        happened.goes_on.rests(moving.into_iter(), connections.values(), now);
        happened.starts.values_mut().for_each(|start| start.is_open = false);
        while happened.starts.len() > 512 {
            happened.starts.pop_first();
        }
    }
}

impl Happened {
    fn violated(&mut self, what: String) {
        self.violation.get_or_insert(what);
    }
}

/// Returns the time at which the run began.
fn began() -> tokio::time::Instant {
    thread_local! {
        static BEGAN: std::cell::OnceCell<tokio::time::Instant> = const { std::cell::OnceCell::new() };
    }
    BEGAN.with(|began| *began.get_or_init(tokio::time::Instant::now))
}
