//! The processes there are and were: their sessions, and what is kept of those that are away.
//!
//! Invariant: a name belongs to one incarnation at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};
use trocar_lcm_api::{Decision, Lcm, Report};
use trocar_links::Card;
use trocar_model::{
    Change, Component, ComponentId, Connection, Health, Name, ProcessState, Refusal, State, SystemGraph,
    Target,
};

use super::guest_lcm::GuestLcm;
use super::on_return::{OnReturn, RESTARTED};

/// Most targets of Stops that are kept for one process; more are kept as one for all of it.
const MOST_UNTOLD: usize = 1024;

/// Facts a process tells when it registers.
#[derive(Clone, Debug)]
pub struct Registration {
    pub process: Name,
    pub endpoint: String,
    pub pid: u32,
    /// Random, one per incarnation of the process.
    pub instance: u128,
    /// Epoch this incarnation was given before; 0 = none yet.
    pub epoch: u64,
    /// Components and connections it was told to have before; empty for a new process.
    pub slice: Slice,
    /// Last revision it was told: a GCM that knows less than that learns from it.
    pub revision: u64,
    /// Program of a process without an LCM; empty otherwise.
    pub guest: String,
    /// It registers again when its session ends.
    pub comes_again: bool,
}

/// The desired components and connections of one process.
#[derive(Clone, Debug, Default)]
pub struct Slice {
    pub components: Vec<(ComponentId, Component)>,
    pub connections: Vec<Connection>,
}

impl Registration {
    /// A registration of this very process.
    pub fn new(process: Name, endpoint: String) -> Registration {
        // Each RandomState has keys of its own, so these are two random halves.
        let half = || u128::from(RandomState::new().hash_one(std::process::id()));
        let instance = half() << 64 | half();
        Registration {
            process,
            endpoint,
            pid: std::process::id(),
            instance,
            epoch: 0,
            slice: Slice::default(),
            revision: 0,
            guest: String::new(),
            comes_again: false,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    /// Number of this stream; it tells a later stream of the same process apart.
    pub session: u64,
    pub epoch: u64,
    pub term: u64,
    pub revision: u64,
}

#[derive(Default)]
pub(super) struct Sessions {
    live: BTreeMap<Name, Session>,
    /// Instance that held each name last, and its epoch.
    last: BTreeMap<Name, (u128, u64)>,
    /// Processes that were here at some time in the life of this GCM.
    met: BTreeSet<Name>,
    /// Processes of which this GCM has seen how they stand.
    entered: BTreeSet<Name>,
    /// Processes whose word was taken for what was decided.
    pub(super) believed: BTreeSet<Name>,
    /// Number of the newest session.
    newest: u64,
    pub(super) on_return: OnReturn,
    /// Processes that were taken down, with the pid they had: later news of that pid is stale.
    dismissed: BTreeMap<Name, u32>,
    /// Connections to processes that are not there yet, by the process that brought them along from a GCM
    /// before this one.
    pub(super) brought: BTreeMap<Name, Vec<Connection>>,
    /// Guests that have joined without an LCM.
    pub(super) guests: BTreeMap<Name, Arc<GuestLcm>>,
    /// Processes that their supervisor has seen end, and that have not come back since.
    ended: BTreeSet<Name>,
    /// Stops that a process could not be told: it is told them when it comes back as it was.
    untold: BTreeMap<Name, Untold>,
    /// Components for which a Start was ordered and not answered: they may be moving, whatever was seen last.
    unanswered: BTreeSet<ComponentId>,
    /// Numbers of connections that are only being made, which nobody else may bring along.
    pub(super) connecting: BTreeSet<u64>,
    /// Number of the newest report of each component; see [`Report::number`].
    reported: BTreeMap<ComponentId, u64>,
    /// Decisions by which components have their settings, as this GCM has entered them.
    set_by: BTreeMap<ComponentId, Decision>,
}

/// Stops that could not be told: each target with the last decision that named it, by which nothing is
/// stopped that was started later.
pub(super) type Untold = BTreeMap<Target, Decision>;

struct Session {
    number: u64,
    /// Number of the last Stop at the process itself that was answered.
    stopped_here: u64,
    pid: u32,
    /// The process registers again when this ends.
    comes_again: bool,
    lcm: Arc<dyn Lcm>,
    /// Questions that are answered when all present news has been entered; closed with the session.
    asks: mpsc::Sender<oneshot::Sender<()>>,
    /// Card other processes need to reach it.
    card: Option<Card>,
}

/// Session and epoch of a process whose name was free.
pub(super) struct Claimed {
    pub(super) session: u64,
    pub(super) epoch: u64,
    /// The same instance held it last.
    pub(super) back: bool,
    /// The name was held in the life of this GCM.
    pub(super) was_here: bool,
}

impl Sessions {
    /// Sessions of a GCM that goes on from there: it hears no process yet, and knows each by its incarnation.
    pub(super) fn after(wanted: &trocar_model::Wanted) -> Sessions {
        let known = wanted.processes.iter();
        let last = known.map(|(name, held)| (name.clone(), (held.instance, held.epoch))).collect();
        Sessions { last, ..Sessions::default() }
    }

    /// Notes by which decision a component has its settings.
    pub(super) fn is_set_by(&mut self, change: &Change, decision: Decision) {
        match change {
            Change::Create { id, .. } | Change::Configure { id, .. } => {
                _ = self.set_by.insert(id.clone(), decision)
            }
            Change::Destroy { id, .. } => _ = self.set_by.remove(id),
            Change::Run { .. } | Change::Connect { .. } | Change::Disconnect { .. } => {}
        }
    }

    /// Tells whether a component was given settings by a later decision than that one.
    pub(super) fn is_set_since(&self, id: &ComponentId, decision: Decision) -> bool {
        self.set_by.get(id).is_some_and(|by| *by > decision)
    }

    /// Tells whether this report was looked up later than all that were entered before. News and answers come
    /// by different ways.
    pub(super) fn is_newest(&mut self, report: &Report) -> bool {
        if report.number == 0 {
            return true;
        }
        let newest = self.reported.entry(report.id.clone()).or_default();
        let is_newest = report.number > *newest;
        *newest = report.number.max(*newest);
        is_newest
    }

    pub(super) fn card(&self, process: &Name) -> Option<Card> {
        self.live.get(process).and_then(|session| session.card.clone())
    }

    /// The LCM of a process that is heard.
    pub(super) fn lcm(&self, process: &Name) -> Option<Arc<dyn Lcm>> {
        self.live.get(process).map(|session| session.lcm.clone())
    }

    /// Takes questions that are answered when all present news of the process has been entered.
    pub(super) fn asks(&self, process: &Name) -> Option<mpsc::Sender<oneshot::Sender<()>>> {
        self.live.get(process).map(|session| session.asks.clone())
    }

    /// The processes that are heard.
    pub(super) fn heard(&self) -> Vec<Name> {
        self.live.keys().cloned().collect()
    }

    /// Notes whether the supervisor of a process has seen it end.
    pub(super) fn has_ended(&mut self, process: &Name, ended: bool) {
        if ended {
            self.ended.insert(process.clone());
        } else {
            self.ended.remove(process);
        }
    }

    /// Tells whether nothing of the process runs, as its supervisor has seen.
    pub(super) fn is_over(&self, process: &Name) -> bool {
        self.ended.contains(process) && !self.live.contains_key(process)
    }

    /// Keeps a Stop that a process could not be told.
    pub(super) fn not_told(&mut self, process: &Name, targets: &[Target], decision: Decision) {
        let mut mine = targets.iter().filter_map(|target| target.within(process)).peekable();
        if mine.peek().is_none() {
            return;
        }
        let untold = self.untold.entry(process.clone()).or_default();
        for target in mine {
            let last = untold.entry(target).or_default();
            *last = decision.max(*last);
        }
        if untold.len() > MOST_UNTOLD {
            let last = untold.values().max().copied().unwrap_or_default();
            let everything = Target::everything().within(process);
            *untold = everything.into_iter().map(|target| (target, last)).collect();
        }
    }

    /// Takes the Stops that a process, which is back as it was, could not be told.
    pub(super) fn take_untold(&mut self, process: &Name) -> Option<Untold> {
        self.untold.remove(process)
    }

    /// Another incarnation of the process moves nothing by itself.
    pub(super) fn forgets(&mut self, process: &Name) {
        self.untold.remove(process);
    }

    /// Notes that the order to set a component in motion was not answered.
    pub(super) fn not_answered(&mut self, id: &ComponentId) {
        self.unanswered.insert(id.clone());
    }

    /// Notes that it was, or that somebody saw how it stands.
    pub(super) fn answered(&mut self, id: &ComponentId) {
        self.unanswered.remove(id);
    }

    /// Tells whether a component of a process that is not heard may be moving. Where this GCM has never seen
    /// how it stands, the one before may have ordered what was never answered.
    pub(super) fn may_move(&self, id: &ComponentId, seen: State) -> bool {
        matches!(seen, State::Active | RESTARTED)
            || self.unanswered.contains(id)
            || !self.entered.contains(&id.process)
    }

    /// Notes that everything that a process has is entered.
    pub(super) fn is_entered(&mut self, process: &Name) {
        self.entered.insert(process.clone());
    }

    /// Takes the Stops at the process itself up to that number to be answered; returns that of the last one
    /// that was.
    pub(super) fn answers_here(&mut self, process: &Name, number: u64) -> u64 {
        let Some(session) = self.live.get_mut(process) else { return u64::MAX };
        let answered = session.stopped_here;
        session.stopped_here = number.max(answered);
        answered
    }

    /// The session of a process that is heard.
    pub(super) fn holder(&self, process: &Name) -> Option<u64> {
        self.live.get(process).map(|s| s.number)
    }

    /// The session of a process that registers again when it ends.
    pub(super) fn comes_again(&self, process: &Name) -> Option<u64> {
        self.live.get(process).filter(|session| session.comes_again).map(|session| session.number)
    }

    /// Tells whether the process was here at some time in the life of this GCM.
    pub(super) fn knows(&self, process: &Name) -> bool {
        self.met.contains(process)
    }

    /// The pid of a process that is heard.
    pub(super) fn pid(&self, process: &Name) -> Option<u32> {
        self.live.get(process).map(|s| s.pid)
    }

    /// Takes a process down: it is away, and nothing is kept for it to come back to.
    pub(super) fn dismiss(&mut self, process: &Name, pid: u32) {
        self.live.remove(process);
        self.on_return.here(process, &[]);
        self.brought.remove(process);
        // Processes that were never spawned cannot be told apart by a pid.
        if pid != 0 {
            self.dismissed.insert(process.clone(), pid);
        }
    }

    pub(super) fn was_dismissed(&self, process: &Name, pid: u32) -> bool {
        self.dismissed.get(process) == Some(&pid)
    }

    /// Ends the session of a process: its components stay listed as LOST. Returns its epoch, if that session
    /// counts.
    pub(super) fn lose(&mut self, graph: &mut SystemGraph, process: &Name, session: u64) -> Option<u64> {
        if self.holder(process) != Some(session) {
            return None;
        }
        self.live.remove(process);
        let p = graph.processes.get_mut(process)?;
        p.state = ProcessState::Lost;
        p.classes.clear();
        let epoch = p.epoch;
        graph.components.change(|id, _| id.process == *process, |component| component.health = Health::Lost);
        graph.proxies.retain(|_, half| half.process != *process);
        Some(epoch)
    }

    /// Returns the epoch that a process keeps, as far as some GCM may have given it that.
    pub(super) fn keeps(&self, who: &Registration) -> Option<u64> {
        let known = match self.last.get(&who.process) {
            Some((instance, epoch)) if *instance == who.instance => *epoch,
            // A process that comes from a GCM before this one.
            None => who.epoch,
            // Another process had the name meanwhile.
            Some(_) => return None,
        };
        let taken = self.last.iter().any(|(name, (_, epoch))| *name != who.process && *epoch == known);
        (!taken).then_some(known)
    }

    /// Checks the name and takes it, in one step.
    ///
    /// # Errors
    /// The name is taken by another process that is heard; the epoch by one that came just now.
    pub(super) fn claim(
        &mut self,
        graph: &SystemGraph,
        epoch: u64,
        who: &Registration,
        lcm: Arc<dyn Lcm>,
        asks: mpsc::Sender<oneshot::Sender<()>>,
        card: Option<Card>,
    ) -> Result<Claimed, Refusal> {
        let last = self.last.get(&who.process).copied();
        let back = last.is_some_and(|(instance, _)| instance == who.instance);
        if self.live.contains_key(&who.process) && !back {
            let holder = graph.processes.get(&who.process);
            return Err(Refusal::ProcessExists {
                endpoint: holder.map(|p| p.endpoint.clone()).unwrap_or_default(),
                pid: holder.map_or(0, |p| p.pid),
                process: who.process.clone(),
            });
        }
        if self.last.iter().any(|(name, (_, theirs))| *name != who.process && *theirs == epoch) {
            return Err(Refusal::Busy { doing: format!("a process that came with the same epoch {epoch}") });
        }
        self.newest += 1;
        let session = self.newest;
        self.live.insert(
            who.process.clone(),
            Session {
                number: session,
                stopped_here: 0,
                pid: who.pid,
                comes_again: who.comes_again,
                lcm,
                asks,
                card,
            },
        );
        // Earlier orders are over: it comes with what became of them. Until that is entered nobody knows how
        // it stands.
        self.unanswered.retain(|id| id.process != who.process);
        self.entered.remove(&who.process);
        self.dismissed.remove(&who.process);
        self.ended.remove(&who.process);
        self.last.insert(who.process.clone(), (who.instance, epoch));
        let was_here = !self.met.insert(who.process.clone());
        Ok(Claimed { session, epoch, back, was_here })
    }

    /// Notes that the process may count its reports from the beginning.
    pub(super) fn counts_anew(&mut self, process: &Name) {
        self.reported.retain(|id, _| id.process != *process);
    }
}
