//! Has processes made for single components, started again and ended, by the supervisors that listen.
//!
//! Invariant: a process that was wanted for a request that failed, or whose component was removed, is taken
//! off the list again, so none is left behind.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use trocar_lcm_api::{Decision, clock};
use trocar_model::{
    Change, ComponentId, Name, Plan, Process, ProcessState, Refusal, Request, SystemGraph, Target,
};

use super::Gcm;
use super::answer::{ExecuteOptions, Executed};
use super::away::plan_away;
use super::changes::id_of;
use super::isolation::{Isolated, Isolation, Orders};
use super::journal::Asked;
use super::observed::After;

/// Longest wait for a process that is not wanted any more: its supervisor ends it all the same.
const GONE: Duration = Duration::from_secs(3);

/// Facts a supervisor tells about itself.
#[derive(Clone, Debug, Default)]
pub struct Supervisor {
    /// The processes beside which it can make others.
    pub processes: BTreeSet<Name>,
    /// Processes it keeps for isolated components.
    pub isolated: Vec<Isolated>,
    /// The GCM that wanted those.
    pub term: u64,
}

/// A supervisor that listens; it is counted on until this is dropped.
pub struct Supervising {
    gcm: Gcm,
    number: u64,
    all: watch::Receiver<Isolation>,
    told: Option<Vec<Isolated>>,
    /// Restarts the supervisor was told, or that were asked before it was there.
    restarted: BTreeMap<Name, u64>,
}

impl Supervising {
    /// Returns all orders for the supervisor: at once, and then whenever they change.
    pub async fn next(&mut self) -> Orders {
        loop {
            let now = {
                let all = self.all.borrow_and_update();
                let orders = all.orders(self.number, &self.restarted);
                self.restarted.clone_from(all.restarts());
                orders
            };
            if self.told.as_ref() != Some(&now.isolated) || !now.restart.is_empty() {
                self.told = Some(now.isolated.clone());
                return now;
            }
            // The sender lives as long as the GCM, which this holds.
            let _ = self.all.changed().await;
        }
    }
}

impl Drop for Supervising {
    fn drop(&mut self) {
        self.gcm.inner.isolation.send_modify(|all| all.listens_no_more(self.number));
    }
}

impl Gcm {
    /// Takes a supervisor in. Processes it keeps for an earlier GCM are wanted; for those it keeps for this
    /// GCM, this GCM's own list counts.
    pub fn supervise(&self, who: Supervisor) -> Supervising {
        let (mut number, mut restarted) = (0, BTreeMap::new());
        self.inner.isolation.send_modify(|all| {
            number = all.listens(who.processes);
            restarted.clone_from(all.restarts());
            if who.term != self.term() {
                all.want(who.isolated);
            }
        });
        Supervising {
            gcm: self.clone(),
            number,
            all: self.inner.isolation.subscribe(),
            told: None,
            restarted,
        }
    }

    /// Tells whether supervisors are there that make these.
    pub(super) fn can_be_made(&self, isolated: &[Isolated]) -> Result<(), Refusal> {
        self.inner.isolation.borrow().can_be_made(isolated)
    }

    /// Has the processes made, and waits until they are here.
    ///
    /// # Errors
    /// ProcessNotUp, with how it ended; then all of them are to be ended.
    pub(super) async fn begin_isolated(
        &self,
        isolated: &[Isolated],
        deadline: Instant,
    ) -> Result<(), Refusal> {
        if isolated.is_empty() {
            return Ok(());
        }
        let began = clock::now();
        self.inner.isolation.send_modify(|all| all.want(isolated.iter().cloned()));
        let mut graphs = self.watch();
        for Isolated { process, .. } in isolated {
            let settled = |p: &Process| match p.state {
                ProcessState::Attached | ProcessState::Failed => true,
                ProcessState::Lost => !p.last_exit.is_empty(),
                ProcessState::Restarting => false,
            };
            let settled = graphs.wait_for(|graph| graph.processes.get(process).is_some_and(settled));
            let why = match tokio::time::timeout_at(deadline.into(), settled).await {
                Ok(Ok(graph)) => match graph.processes.get(process) {
                    Some(there) if there.state == ProcessState::Attached => continue,
                    Some(away) => {
                        format!("it {}, and {} restarts did not help", away.last_exit, away.restarts)
                    }
                    None => "it is gone again".to_owned(),
                },
                _ => self.not_heard(process, began),
            };
            return Err(Refusal::ProcessNotUp { process: process.clone(), why });
        }
        Ok(())
    }

    /// Returns the reason why a process counts as not up: it was not heard since then.
    fn not_heard(&self, process: &Name, began: Instant) -> String {
        let within = clock::since(began).as_secs_f64();
        let ended = self.graph().processes.get(process).map(|p| p.last_exit.clone());
        let ended = ended.filter(|exit| !exit.is_empty()).map(|exit| format!("; it {exit}"));
        format!("nothing was heard of it within {within:.1} s{}", ended.unwrap_or_default())
    }

    /// Has the supervisor of a process end it, if it runs, and start it again; waits until it is there with
    /// its components.
    ///
    /// # Errors
    /// PROCESS_NOT_FOUND; NOT_SUPERVISED; PROCESS_NOT_UP, with how it ended.
    pub async fn restart(&self, process: &Name, deadline: Instant) -> Result<Arc<SystemGraph>, Refusal> {
        let mut graphs = self.watch();
        let before = graphs.borrow_and_update().process(process)?.clone();
        self.inner.isolation.borrow().is_kept(process)?;
        // A process that ends in order stops its components first; those that ran before are to run again.
        self.edit_if(|graph| {
            self.inner.sessions.lock().on_return.of(graph, process);
            false
        });
        let restarted = self.have_restarted(process, &before, &mut graphs, deadline).await;
        let goes_on = |p: &Process| p.state == ProcessState::Attached && p.epoch == before.epoch;
        if restarted.is_err() && self.graph().processes.get(process).is_some_and(goes_on) {
            self.inner.sessions.lock().on_return.stays(process);
        }
        restarted
    }

    async fn have_restarted(
        &self,
        process: &Name,
        before: &Process,
        graphs: &mut watch::Receiver<Arc<SystemGraph>>,
        deadline: Instant,
    ) -> Result<Arc<SystemGraph>, Refusal> {
        let began = clock::now();
        self.inner.isolation.send_modify(|all| all.restart(process));
        log::info!("process {process} is to be started again");
        let settled = |p: &Process| match p.state {
            ProcessState::Attached => p.epoch != before.epoch,
            ProcessState::Failed => p.restarts != before.restarts,
            ProcessState::Lost | ProcessState::Restarting => false,
        };
        let settled = graphs.wait_for(|graph| graph.processes.get(process).is_none_or(settled));
        let why = match tokio::time::timeout_at(deadline.into(), settled).await {
            Ok(Ok(graph)) => match graph.processes.get(process) {
                Some(there) if there.state == ProcessState::Attached => return Ok(graph.clone()),
                Some(away) => format!("it {}", away.last_exit),
                None => "it is gone".to_owned(),
            },
            _ => self.not_heard(process, began),
        };
        Err(Refusal::ProcessNotUp { process: process.clone(), why })
    }

    /// Starts the process of a component again that was given up, when a Reset asks for the component.
    ///
    /// # Errors
    /// As [`Gcm::restart`]; without a supervisor the plan says more.
    pub(super) async fn bring_back(&self, requests: &[Request], deadline: Instant) -> Result<(), Refusal> {
        let graph = self.graph();
        let failed = |id: &ComponentId| {
            let process = graph.processes.get(&id.process);
            graph.components.contains_key(id) && process.is_some_and(|p| p.state == ProcessState::Failed)
        };
        let resets = requests.iter().filter_map(|request| match request {
            Request::Reset { targets } => Some(targets),
            _ => None,
        });
        let named = resets.flatten().filter_map(|target| match target {
            Target::One(id) if failed(id) => Some(id.process.clone()),
            _ => None,
        });
        for process in named.collect::<BTreeSet<Name>>() {
            match self.restart(&process, deadline).await {
                Ok(_) | Err(Refusal::NotSupervised { .. }) => {}
                Err(refusal) => return Err(refusal),
            }
        }
        Ok(())
    }

    /// Takes the processes off the list of wanted ones. Waits until they have gone.
    pub(super) async fn end_isolated(&self, processes: BTreeSet<Name>) {
        if processes.is_empty() {
            return;
        }
        self.not_wanted(&processes);
        let mut graphs = self.watch();
        let gone = graphs.wait_for(|graph| processes.iter().all(|name| !graph.processes.contains_key(name)));
        if tokio::time::timeout(GONE, gone).await.is_err() {
            log::warn!("not ended within {} s: {processes:?}; they are not wanted any more", GONE.as_secs());
        }
    }

    /// Tells whether an isolated component is to be removed whose process is away: that process is ended,
    /// with or without an answer of it.
    ///
    /// # Errors
    /// RevisionConflict.
    pub(super) fn is_away_isolated(
        &self,
        requests: &[Request],
        options: &ExecuteOptions,
    ) -> Result<bool, Refusal> {
        let [Request::Remove { id, force }] = requests else { return Ok(false) };
        let graph = self.graph();
        let Some(process) = graph.processes.get(&id.process) else { return Ok(false) };
        let used = || {
            let mut ends = graph.connections.values().flat_map(|c| [&c.client, &c.server]);
            ends.any(|end| end.component == *id)
        };
        let is_here = process.state == ProcessState::Attached || !graph.components.contains_key(id);
        if options.validate_only || is_here || !force && used() || !self.is_wanted(&id.process) {
            return Ok(false);
        }
        match options.expected_revision.filter(|expected| *expected != graph.revision) {
            Some(expected) => Err(Refusal::RevisionConflict { expected, actual: graph.revision }),
            None => Ok(true),
        }
    }

    /// Removes it. Its process is not wanted from now on, which cannot be taken back: should it come once
    /// more before it is ended, it has nothing that is wanted.
    ///
    /// # Errors
    /// The refusals of the plan.
    pub(super) async fn remove_away(
        &self,
        requests: &[Request],
        asked: &Asked,
        since: Decision,
    ) -> Result<(Executed, Option<u64>), Refusal> {
        let plan = plan_away(&self.graph(), requests)?;
        let ids: Vec<ComponentId> = plan.changes.iter().map(|change| id_of(change).clone()).collect();
        let mut done = Executed { plan, ..Executed::default() };
        let mut cut = Vec::new();
        self.edit(|graph| {
            for change in &done.plan.changes {
                if let Change::Disconnect { connection, .. } = change {
                    cut.push(After::cut(connection.clone()));
                }
                graph.carry_out(change);
            }
        });
        let record = self.done(&mut done, since, asked);
        self.inner.ledger.durable(record).await?;
        for id in &ids {
            self.inner.holds.lock().removed(id);
        }
        self.cut_off(cut);
        self.end_isolated(
            ids.into_iter().map(|id| id.process).filter(|process| self.is_wanted(process)).collect(),
        )
        .await;
        Ok((done, Some(record)))
    }

    fn is_wanted(&self, process: &Name) -> bool {
        self.inner.isolation.borrow().is_wanted(process)
    }

    pub(super) fn not_wanted(&self, processes: &BTreeSet<Name>) {
        self.inner.isolation.send_if_modified(|all| all.not_wanted(processes));
    }

    /// Returns the processes of isolated components that the plan has emptied.
    pub(super) fn emptied(&self, plan: &Plan) -> BTreeSet<Name> {
        let (graph, all) = (self.graph(), self.inner.isolation.borrow());
        let left = plan.changes.iter().filter_map(|change| match change {
            Change::Destroy { id, .. } => Some(&id.process),
            _ => None,
        });
        let is_empty = |process: &Name| graph.components.keys().all(|id| id.process != *process);
        left.filter(|process| all.is_wanted(process) && is_empty(process)).cloned().collect()
    }
}

/// The processes that requests are to make.
pub(super) fn asked_isolated(requests: &[Request]) -> Vec<Isolated> {
    let isolated = requests.iter().filter_map(|request| match request {
        Request::CreateIsolated { id, home, .. } => {
            Some(Isolated { process: id.process.clone(), home: home.clone() })
        }
        _ => None,
    });
    isolated.collect()
}
