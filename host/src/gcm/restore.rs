//! A process that was started again gets back what it was to have.
//!
//! Invariant: it counts as RESTARTING until that is done; nothing that moves something is put in motion, and what is stopped
//! meanwhile stays stopped. What cannot be made again is in FAULT with the reason, and keeps no other from coming back.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use trocar_model::{
    Change, ComponentId, Health, Name, ProcessState, Refusal, State, SystemGraph, Target, restore,
};

use super::Gcm;
use super::execute::id_of;
use super::manager::lock;
use super::stop::Carrying;
use super::text;

/// Time for all of it.
const WITHIN: Duration = Duration::from_secs(60);

impl Gcm {
    /// Makes the components of a process anew that it was to have, as `session` of it.
    pub(super) async fn restore(self, process: Name, session: u64) {
        let deadline = Instant::now() + WITHIN;
        let decide = |graph: &SystemGraph| {
            let wanted = lock(&self.inner.sessions).wanted(graph, &process);
            Ok(restore(graph, &process, &wanted))
        };
        let (claim, _, plan) = match self.claim_part(&[], deadline, decide).await {
            Ok(planned) => planned,
            Err(refusal) => {
                log::error!("the components of process {process} are not made again: {refusal}");
                return self.attached_again(&process, session);
            }
        };
        let carrying = Carrying::begin(&self, claim, &plan);
        for skipped in &plan.skipped {
            log::error!("{}: {}", skipped.id, skipped.why);
        }
        let made: BTreeSet<&ComponentId> = plan.changes.iter().map(id_of).collect();
        let mut failed: BTreeSet<ComponentId> = BTreeSet::new();
        for skipped in plan.skipped.iter().filter(|s| !made.contains(&s.id)) {
            self.not_made(&skipped.id, &skipped.why);
        }
        for change in &plan.changes {
            if !self.hears(&process, session) {
                return;
            }
            if concerns(change, &failed) {
                self.not_done(change, "one end of it could not be made again");
                continue;
            }
            let done = tokio::select! {
                done = carrying.one(change, deadline) => done,
                () = self.gone(&process, session) => return,
            };
            match done {
                Ok(_) => {}
                Err(refusal @ Refusal::ProcessLost { .. }) => {
                    return log::warn!("{}: {refusal}", text::line(change));
                }
                Err(refusal) => {
                    log::error!("making process {process} anew ({}): {refusal}", text::line(change));
                    failed.insert(id_of(change).clone());
                    self.not_done(change, &refusal.to_string());
                }
            }
        }
        log::info!("process {process} has its {} components again", made.len());
        self.attached_again(&process, session);
    }

    /// Ends when that session of the process has.
    async fn gone(&self, process: &Name, session: u64) {
        let mut graphs = self.watch();
        // It lives as long as this GCM.
        let _ = graphs.wait_for(|_| !self.hears(process, session)).await;
    }

    fn attached_again(&self, process: &Name, session: u64) {
        self.edit(|graph| {
            if self.hears(process, session)
                && let Some(p) = graph.processes.get_mut(process)
            {
                p.state = ProcessState::Attached;
                lock(&self.inner.sessions).has_again(process);
            }
        });
    }

    /// A component that is not there although it should be.
    fn not_made(&self, id: &ComponentId, why: &str) {
        self.edit(|graph| {
            if let Some(component) = graph.components.get_mut(id) {
                component.state = State::Fault;
                component.health = Health::Lost;
                component.fault =
                    format!("its process was started again and it could not be made anew: {why}; remove it and create it anew");
            }
            let before = graph.connections.len();
            graph.connections.retain(|_, c| c.client.component != *id && c.server.component != *id);
            if graph.connections.len() != before {
                graph.revision += 1;
            }
        });
    }

    fn not_done(&self, change: &Change, why: &str) {
        match change {
            Change::Create { id, .. } => self.not_made(id, why),
            Change::Connect { connection } => self.edit(|graph| {
                if graph.connections.remove(&connection.id).is_some() {
                    graph.revision += 1;
                }
            }),
            // It exists, and stands as its LCM reports.
            _ => {}
        }
    }

    /// Keeps in mind what was stopped and could not be told, because its process is away.
    pub(super) fn keep_stopped(&self, targets: &[Target]) {
        let graph = self.graph();
        let away = |id: &ComponentId| {
            graph.processes.get(&id.process).is_none_or(|p| p.state != ProcessState::Attached)
        };
        let named = |id: &ComponentId| {
            targets.iter().any(|target| match target {
                Target::One(one) => one == id,
                Target::Glob(pattern) => pattern.matches(id),
            })
        };
        let gone = graph.components.iter().filter(|(id, _)| away(id) && named(id));
        lock(&self.inner.sessions).keep_stopped(gone.map(|(id, c)| (id.clone(), c.state)));
    }
}

fn concerns(change: &Change, failed: &BTreeSet<ComponentId>) -> bool {
    match change {
        Change::Connect { connection: c } => {
            failed.contains(&c.client.component) || failed.contains(&c.server.component)
        }
        other => failed.contains(id_of(other)),
    }
}
