//! Carries out a single change: its LCM does it, then it is entered in the graph.
//!
//! Invariant: a change is entered only after its LCM did it, and the wait for the LCM ends by the deadline.

use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_lcm_api::{Decision, Order, Report};
use trocar_model::{Change, Component, Connection, Name, Plan, Refusal};

use super::changes::id_of;
use super::observed::{After, observe, stand_by};
use super::{Gcm, text};

/// Time an LCM gets beyond the deadline: it keeps deadlines itself and says what hung; after this it is not
/// waited for.
const GRACE: Duration = Duration::from_millis(50);

/// A number that a connection gets when it is made.
struct Connecting<'a> {
    gcm: &'a Gcm,
    number: u64,
}

impl<'a> Connecting<'a> {
    fn begin(gcm: &'a Gcm, number: u64) -> Connecting<'a> {
        gcm.inner.sessions.lock().connecting.insert(number);
        Connecting { gcm, number }
    }
}

impl Drop for Connecting<'_> {
    fn drop(&mut self) {
        self.gcm.inner.sessions.lock().connecting.remove(&self.number);
    }
}

impl Gcm {
    /// Carries out one change: done by the LCM, then entered in the graph.
    pub(super) async fn one(&self, change: &Change, order: Order) -> Result<Report, Refusal> {
        let (process, deadline, decision) = (&id_of(change).process, order.deadline, order.decision);
        let session = self.inner.sessions.lock().holder(process);
        let before = self.sessions_of(change);
        let connecting = match change {
            Change::Connect { connection } => Some(Connecting::begin(self, connection.id.0)),
            _ => None,
        };
        if let Change::Connect { connection } = change {
            // Whatever becomes of it, some process may have it under this number.
            self.edit_if(|graph| {
                let graph = Arc::make_mut(graph);
                graph.next_connection = graph.next_connection.max(connection.id.0 + 1);
                false
            });
        }
        let asking = async {
            match change {
                Change::Connect { connection } if !connection.is_near() => {
                    self.link_or_none(connection, deadline).await
                }
                Change::Disconnect { connection, replaced } if !connection.is_near() => {
                    self.unlink(connection, *replaced, deadline).await
                }
                near => self.lcm_of(process)?.apply(near.clone(), order).await,
            }
        };
        let asked = self.in_time(process, &text::asked(change), deadline, asking).await;
        let report = match asked {
            Ok(report) => report,
            // An LCM by itself cuts a connection that loses its port, and tells so after that: the wanted
            // change is done.
            Err(refusal @ Refusal::ConnectionNotFound { .. }) => self.as_known(change).ok_or(refusal)?,
            Err(refusal) => {
                self.hear_out(process).await;
                return Err(refusal);
            }
        };
        // From here on it is listed.
        let loose = self
            .done_in((process, session), (change, decision), &report)
            .inspect_err(|_| self.half_done(change))?;
        drop(connecting);
        if let Change::Destroy { id, .. } = change {
            self.inner.holds.lock().removed(id);
        }
        if let Change::Disconnect { connection, .. } = change {
            self.cut_of_returned(connection, &before);
        }
        self.cut_off(loose);
        Ok(report)
    }

    /// Enters a change that a process has done, as it told in that session.
    ///
    /// # Errors
    /// ProcessLost: it has come anew meanwhile, with what it has.
    fn done_in(
        &self,
        (process, session): (&Name, Option<u64>),
        (change, decision): (&Change, Decision),
        report: &Report,
    ) -> Result<Vec<After>, Refusal> {
        let (mut loose, mut is_over) = (Vec::new(), false);
        self.edit(|graph| {
            let mut sessions = self.inner.sessions.lock();
            is_over = sessions.holder(process) != session && session.is_some();
            if is_over {
                return;
            }
            let is_newest = sessions.is_newest(report);
            sessions.is_set_by(change, decision);
            drop(sessions);
            let known = graph.components.get(&report.id).cloned();
            let revision = graph.revision;
            graph.apply(&Plan { changes: vec![change.clone()], skipped: Vec::new() });
            graph.revision = revision;
            loose = observe(graph, report);
            if !is_newest {
                stand_by(graph, &report.id, known);
            }
        });
        if is_over { Err(Refusal::lost(process.clone())) } else { Ok(loose) }
    }

    /// Has both ends of a connection cut that one of them has forgotten.
    fn half_done(&self, change: &Change) {
        if let Change::Connect { connection } = change {
            self.cut_at_both(connection);
        }
    }

    /// Has each process that is there cut its half of a connection. Not waited for.
    pub(super) fn cut_at_both(&self, connection: &Connection) {
        let ends = [&connection.client, &connection.server].map(|end| end.component.process.clone());
        self.cut_strays(ends.into_iter().map(|process| (process, connection.clone())).collect());
    }

    /// Returns the sessions of the processes that a change of a connection concerns.
    fn sessions_of(&self, change: &Change) -> Vec<(Name, Option<u64>)> {
        let (Change::Connect { connection } | Change::Disconnect { connection, .. }) = change else {
            return Vec::new();
        };
        let sessions = self.inner.sessions.lock();
        let ends = [&connection.client, &connection.server].map(|end| end.component.process.clone());
        ends.into_iter().map(|process| (process.clone(), sessions.holder(&process))).collect()
    }

    /// Has a process cut its half of a connection that was away when that was cut, and came back before the
    /// graph said so.
    fn cut_of_returned(&self, connection: &Connection, before: &[(Name, Option<u64>)]) {
        let sessions = self.inner.sessions.lock();
        let came = before.iter().filter(|(process, was)| {
            let holder = sessions.holder(process);
            holder.is_some() && holder != *was
        });
        let strays: Vec<_> = came.map(|(process, _)| (process.clone(), connection.clone())).collect();
        drop(sessions);
        self.cut_strays(strays);
    }

    /// Waits for an LCM as long as it may take.
    ///
    /// # Errors
    /// The refusals of the LCM; LcmTimeout.
    pub(super) async fn in_time<T>(
        &self,
        process: &Name,
        what: &str,
        deadline: Instant,
        asking: impl Future<Output = Result<T, Refusal>>,
    ) -> Result<T, Refusal> {
        let asked = tokio::time::timeout_at((deadline + GRACE).into(), asking).await;
        let timeout = || Refusal::LcmTimeout { process: process.clone(), what: what.to_owned() };
        asked.unwrap_or_else(|_| Err(timeout()))
    }

    /// Enters the state of components of a process, as it told in that session, where nothing newer is known
    /// of them.
    pub(super) fn enter_states(&self, process: &Name, session: Option<u64>, reports: &[&Report]) {
        let mut loose = Vec::new();
        self.edit_if(|graph| {
            let (mut sessions, mut changed) = (self.inner.sessions.lock(), false);
            // One that has come anew meanwhile has told how it stands.
            if session.is_some() && sessions.holder(process) != session {
                return false;
            }
            for report in reports {
                let as_told = |c: &Component| {
                    (c.state, c.health, &c.fault) == (report.state, report.health, &report.fault)
                };
                let is_known = graph.components.get(&report.id).is_none_or(as_told);
                if sessions.is_newest(report) && !is_known {
                    loose.extend(observe(Arc::make_mut(graph), report));
                    changed = true;
                }
            }
            changed
        });
        self.cut_off(loose);
    }

    /// Returns the known state of the client of a connection that is to be cut.
    fn as_known(&self, change: &Change) -> Option<Report> {
        let Change::Disconnect { connection, .. } = change else { return None };
        let id = connection.client.component.clone();
        let Component { state, health, fault, .. } = self.graph().components.get(&id)?.clone();
        let (ports, lost_connections, warnings) = (None, Vec::new(), Vec::new());
        Some(Report { id, number: 0, state, health, fault, ports, lost_connections, warnings })
    }
}
