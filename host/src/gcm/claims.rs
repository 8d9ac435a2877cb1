//! Which part of the system a request has to itself while it is planned and done.
//!
//! Invariant: no two requests under way touch the same component, and no two make connections; requests that
//! would wait for each other go in the order they came. A plan is made in the step that takes its part, so
//! nothing it rests on changes before it is done.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::watch;
use trocar_lcm_api::Decision;
use trocar_model::{
    Change, ComponentId, Name, Pattern, Plan, Refusal, Request, SystemGraph, Target, Verb, Which, host_of,
};

use super::changes::id_of;
use super::ledger::wall_ns;

/// Most Stops that are told apart.
const MOST_STOPS: usize = 1024;
/// No GCM has decided so much more than the one after it.
const AHEAD: u64 = 1 << 32;
/// Time by which clocks may differ, s.
const DAY_S: u64 = 86_400;

/// Part of the system that a request touches.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    ids: BTreeSet<ComponentId>,
    /// Globs not resolved yet: only of a request that waits.
    globs: Vec<Pattern>,
    /// Makes connections or shares threads: whether that closes a circle depends on all others.
    wires: bool,
    /// Revision that it expects: of several that expect the same, one passes.
    expects: Option<u64>,
}

impl Part {
    /// Returns the part the requests name.
    pub(super) fn named(graph: &SystemGraph, requests: &[Request]) -> Part {
        let mut part = Part::default();
        for request in requests {
            match request {
                Request::Create { id, execution, .. } | Request::CreateIsolated { id, execution, .. } => {
                    part.ids.insert(id.clone());
                    part.ids.extend(host_of(execution));
                }
                Request::Remove { id, .. } => _ = part.ids.insert(id.clone()),
                Request::Forget { process } => {
                    part.ids.extend(graph.components.keys().filter(|id| id.process == *process).cloned());
                }
                Request::Configure { id, execution, .. } => {
                    part.ids.insert(id.clone());
                    part.ids.extend(execution.as_ref().and_then(host_of));
                }
                Request::Start { targets }
                | Request::Stop { targets }
                | Request::Resume { targets }
                | Request::Reset { targets } => {
                    for target in targets {
                        match target {
                            Target::One(id) => _ = part.ids.insert(id.clone()),
                            Target::Glob(pattern) => part.globs.push(pattern.clone()),
                        }
                    }
                }
                Request::Connect { client, server, .. } => {
                    part.ids.extend([client.component.clone(), server.component.clone()]);
                    part.wires = true;
                }
                Request::Disconnect { which: Which::Pair { client, server } } => {
                    part.ids.extend([client.component.clone(), server.component.clone()]);
                }
                Request::Disconnect { which: Which::Id(number) } => {
                    let ends = graph.connections.get(number).map(|c| [&c.client, &c.server]);
                    part.ids.extend(ends.into_iter().flatten().map(|end| end.component.clone()));
                }
            }
        }
        part
    }

    /// Returns it as the part of requests that expect this revision.
    pub(super) fn expecting(self, expects: Option<u64>) -> Part {
        Part { expects, ..self }
    }

    /// Adds what their plan touches besides; the globs are resolved when the whole is planned.
    fn planned(mut self, plan: &Plan, is_whole: bool) -> Part {
        if is_whole {
            self.globs.clear();
        }
        // A plan that only takes away is never taken back; a Disconnect beside other changes may have to be
        // connected again.
        let takes_away = |change: &Change| match change {
            Change::Disconnect { .. } | Change::Destroy { .. } => true,
            Change::Run { verb, .. } => *verb == Verb::Stop,
            _ => false,
        };
        let only_takes_away = plan.changes.iter().all(takes_away);
        for change in &plan.changes {
            self.ids.insert(id_of(change).clone());
            match change {
                Change::Connect { connection: c } => {
                    self.ids.insert(c.server.component.clone());
                    self.wires = true;
                }
                Change::Disconnect { connection: c, .. } => {
                    self.ids.insert(c.server.component.clone());
                    self.wires |= !only_takes_away;
                }
                Change::Create { component, .. } => {
                    let host = host_of(&component.execution);
                    self.wires |= host.is_some();
                    self.ids.extend(host);
                }
                Change::Destroy { .. } | Change::Configure { .. } | Change::Run { .. } => {}
            }
        }
        self
    }

    fn meets(&self, other: &Part) -> bool {
        let matched = |globs: &[Pattern], ids: &BTreeSet<ComponentId>| {
            globs.iter().any(|glob| ids.iter().any(|id| glob.matches(id)))
        };
        self.wires && other.wires
            || self.expects.is_some() && self.expects == other.expects
            || !self.ids.is_disjoint(&other.ids)
            || !self.globs.is_empty() && !other.globs.is_empty()
            || matched(&self.globs, &other.ids)
            || matched(&other.globs, &self.ids)
    }
}

/// A plan, and whether it is one of all that was asked.
pub(super) struct Planned {
    pub(super) plan: Plan,
    pub(super) is_whole: bool,
}

impl From<Plan> for Planned {
    fn from(plan: Plan) -> Planned {
        Planned { plan, is_whole: true }
    }
}

/// Wishes of other requests towards one that is being carried out.
#[derive(Clone, Debug, Default)]
pub(super) struct Marks {
    /// Components that are to be removed whatever becomes of the request.
    pub(super) removed: BTreeSet<ComponentId>,
}

/// A request that waits or is being carried out.
#[derive(Debug)]
struct Entry {
    number: u64,
    part: Part,
    under_way: bool,
    marks: Marks,
    /// Name of the request, and once it is begun of the change it waits for now: "Start host/robot".
    doing: String,
}

#[derive(Default)]
struct List {
    /// In the order of arrival.
    entries: Vec<Entry>,
    next: u64,
    /// Number of the last request, a Stop or another one: their place among all decisions.
    last: u64,
    /// The last Stops, in the order in which they came.
    stops: VecDeque<(Decision, Vec<Target>)>,
    /// The last Stop that was forgotten: for what came before it, everything was stopped.
    forgotten: Decision,
}

impl List {
    fn decide(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    /// Returns what the request does that another one, with this number and part, has to wait for.
    fn before(&self, number: u64, part: &Part) -> Option<String> {
        let mut others = self.entries.iter().filter(|e| e.number != number);
        let before = others.find(|e| (e.under_way || e.number < number) && e.part.meets(part));
        before.map(|e| e.doing.clone())
    }
}

/// The requests that wait or are being carried out.
#[derive(Default)]
pub(super) struct Claims {
    list: Mutex<List>,
    /// Notified when one ends or is marked.
    news: watch::Sender<()>,
}

impl Claims {
    pub(super) fn news(&self) -> watch::Receiver<()> {
        self.news.subscribe()
    }

    /// Tells those being carried out something.
    pub(super) fn mark(&self, mut tell: impl FnMut(&mut Marks)) {
        for entry in self.list.lock().entries.iter_mut().filter(|e| e.under_way) {
            tell(&mut entry.marks);
        }
        self.news.send_replace(());
    }

    /// Decides a Stop: requests that came before it, under way or waiting, set nothing in motion any more
    /// that it names.
    pub(super) fn decide_stop(&self, targets: &[Target]) -> Decision {
        let mut list = self.list.lock();
        let decision = Decision(list.decide());
        list.stops.push_back((decision, targets.to_vec()));
        if list.stops.len() > MOST_STOPS
            && let Some((forgotten, _)) = list.stops.pop_front()
        {
            list.forgotten = forgotten;
        }
        drop(list);
        self.news.send_replace(());
        decision
    }

    /// Takes the place of a request among all decisions: when it comes, however long it waits then.
    pub(super) fn arrive(&self) -> Decision {
        Decision(self.list.lock().decide())
    }

    /// Tells whether a Stop named the component after that decision.
    pub(super) fn is_stopped_since(&self, id: &ComponentId, decision: Decision) -> bool {
        let list = self.list.lock();
        let later = list.stops.iter().rev().take_while(|(stop, _)| *stop > decision);
        list.forgotten > decision || later.into_iter().any(|(_, targets)| targets.iter().any(|t| t.names(id)))
    }

    /// Counts on from the last decision of the GCM before this one.
    pub(super) fn count_from(&self, last: Decision) {
        let mut list = self.list.lock();
        list.last = list.last.max(last.0.min(Decision::MOST.0));
    }

    /// Counts on from a decision that a process has seen: of a GCM before this one. One that no GCM can have
    /// come to is not taken, since numbers do not come back.
    pub(super) fn count_on(&self, seen: Decision) {
        let mut list = self.list.lock();
        // Terms go on from the time of day at most.
        let by_tomorrow = Decision::before(wall_ns() / 1_000_000_000 + DAY_S).0;
        if seen.0 <= by_tomorrow.max(list.last.saturating_add(AHEAD)) {
            list.last = list.last.max(seen.0);
        } else {
            log::warn!("a process says that it has seen decision {}, which nobody has come to", seen.0);
        }
    }

    /// Returns the components of a process that requests under way touch.
    pub(super) fn under_way(&self, process: &Name) -> Vec<ComponentId> {
        let list = self.list.lock();
        let parts = list.entries.iter().filter(|e| e.under_way).flat_map(|e| &e.part.ids);
        parts.filter(|id| id.process == *process).cloned().collect()
    }

    /// Waits for a part of the system and takes it in the step that plans.
    ///
    /// # Errors
    /// The refusals of `plan`; Busy when others took all the time.
    pub(super) async fn claim(
        &self,
        (named, doing): (Part, String),
        (since, deadline): (Decision, Instant),
        plan: impl Fn() -> Result<(Arc<SystemGraph>, Planned), Refusal>,
    ) -> Result<(Claim<'_>, Arc<SystemGraph>, Plan), Refusal> {
        let claim = self.queue(named.clone(), doing, since);
        let mut news = claim.news();
        loop {
            news.mark_unchanged();
            let behind = match claim.take(&named, &plan) {
                Ok(planned) => return planned.map(|(graph, plan)| (claim, graph, plan)),
                Err(behind) => behind,
            };
            if tokio::time::timeout_at(deadline.into(), news.changed()).await.is_err() {
                // A request goes on to its next change without news for those that wait.
                let doing = self.list.lock().before(claim.number, &named).unwrap_or(behind);
                return Err(Refusal::Busy { doing });
            }
        }
    }

    fn queue(&self, part: Part, doing: String, since: Decision) -> Claim<'_> {
        let mut list = self.list.lock();
        list.next += 1;
        let (number, marks) = (list.next, Marks::default());
        list.entries.push(Entry { number, part, under_way: false, marks, doing });
        Claim { claims: self, number, since }
    }
}

/// A place in the list; given back when dropped.
pub(super) struct Claim<'a> {
    claims: &'a Claims,
    number: u64,
    since: Decision,
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        self.claims.list.lock().entries.retain(|e| e.number != self.number);
        self.claims.news.send_replace(());
    }
}

impl Claim<'_> {
    /// Tells whether others have something of this process under way.
    pub(super) fn is_beside_others(&self, process: &Name) -> bool {
        let list = self.claims.list.lock();
        let others = list.entries.iter().filter(|e| e.under_way && e.number != self.number);
        others.flat_map(|e| &e.part.ids).any(|id| id.process == *process)
    }

    pub(super) fn news(&self) -> watch::Receiver<()> {
        self.claims.news()
    }

    /// Place of its request among all decisions.
    pub(super) fn decision(&self) -> Decision {
        self.since
    }

    /// Tells whether a Stop named the component after the request came.
    pub(super) fn is_stopped(&self, id: &ComponentId) -> bool {
        self.claims.is_stopped_since(id, self.since)
    }

    /// Looks at, or changes, the wishes of other requests.
    pub(super) fn marks<R>(&self, look: impl FnOnce(&mut Marks) -> R) -> R {
        let mut list = self.claims.list.lock();
        match list.entries.iter_mut().find(|e| e.number == self.number) {
            Some(entry) => look(&mut entry.marks),
            // Impossible while this exists.
            None => look(&mut Marks::default()),
        }
    }

    /// Sets what this request waits for from now on, for requests that wait for it.
    pub(super) fn doing(&self, what: String) {
        if let Some(entry) = self.claims.list.lock().entries.iter_mut().find(|e| e.number == self.number) {
            entry.doing = what;
        }
    }

    /// Takes what `plan` touches besides, which was not known before.
    ///
    /// # Errors
    /// PartTaken: another request has some of it.
    pub(super) fn widen(&self, plan: &Plan, is_whole: bool) -> Result<(), Refusal> {
        let mut list = self.claims.list.lock();
        let own = list.entries.iter().position(|e| e.number == self.number);
        let Some(own) = own else {
            return Err(Refusal::Internal { text: "a request under way has no part of the system".into() });
        };
        let part = list.entries[own].part.clone().planned(plan, is_whole);
        let mut others = list.entries.iter().filter(|e| e.number != self.number && e.under_way);
        if let Some(other) = others.find(|e| e.part.meets(&part)) {
            return Err(Refusal::PartTaken { doing: other.doing.clone() });
        }
        list.entries[own].part = part;
        Ok(())
    }

    /// Plans and takes the part, when no other request has any of it or came earlier; else returns what it
    /// waits for.
    fn take(
        &self,
        named: &Part,
        plan: impl FnOnce() -> Result<(Arc<SystemGraph>, Planned), Refusal>,
    ) -> Result<Result<(Arc<SystemGraph>, Plan), Refusal>, String> {
        let mut list = self.claims.list.lock();
        if let Some(doing) = list.before(self.number, named) {
            return Err(doing);
        }
        let (graph, Planned { plan, is_whole }) = match plan() {
            Ok(planned) => planned,
            Err(refusal) => return Ok(Err(refusal)),
        };
        let part = named.clone().planned(&plan, is_whole);
        let doing = list.before(self.number, &part);
        if let Some(entry) = list.entries.iter_mut().find(|e| e.number == self.number) {
            entry.under_way = doing.is_none();
            entry.part = part;
        }
        doing.map_or(Ok(Ok((graph, plan))), Err)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn stop(path: &str) -> Vec<Target> {
        vec![Target::parse(path).unwrap()]
    }

    #[test]
    fn a_stop_counts_against_what_came_before_it_also_when_it_was_forgotten() {
        let (claims, arm) = (Claims::default(), ComponentId::parse("host/arm").unwrap());
        let before = claims.arrive();
        assert!(!claims.is_stopped_since(&arm, before));
        claims.decide_stop(&stop("host/other"));
        assert!(!claims.is_stopped_since(&arm, before));
        claims.decide_stop(&stop("host/*"));
        let after = claims.arrive();
        assert!(claims.is_stopped_since(&arm, before) && !claims.is_stopped_since(&arm, after));
        for _ in 0..=MOST_STOPS {
            claims.decide_stop(&stop("host/other"));
        }
        assert!(claims.is_stopped_since(&arm, before), "to the safe side");
        assert!(!claims.is_stopped_since(&arm, claims.arrive()));
    }

    #[tokio::test]
    async fn who_waits_in_vain_is_told_for_what_from_the_first_moment_and_as_it_is_at_last() {
        let claims = Claims::default();
        let part = || Part { ids: [ComponentId::parse("host/arm").unwrap()].into(), ..Part::default() };
        let plan = || Ok((Arc::new(SystemGraph::default()), Plan::default().into()));
        let claim = async |asked: &str| {
            let until = Instant::now() + std::time::Duration::from_millis(20);
            claims.claim((part(), asked.to_owned()), (Decision::NONE, until), plan).await
        };
        let (first, ..) = claim("Start host/arm and 2 more").await.unwrap();
        let waited = claim("Reset host/arm").await.map(|_| ()).unwrap_err();
        assert_eq!(waited, Refusal::Busy { doing: "Start host/arm and 2 more".into() });
        let (waited, ()) = tokio::join!(claim("Reset host/arm"), async {
            tokio::task::yield_now().await;
            first.doing("Start host/eye".into());
        });
        assert_eq!(waited.map(|_| ()).unwrap_err(), Refusal::Busy { doing: "Start host/eye".into() });
    }

    #[test]
    fn a_count_that_nobody_has_come_to_is_not_gone_on_with() {
        let claims = Claims::default();
        claims.count_on(Decision(500));
        assert_eq!(claims.arrive(), Decision(501));
        claims.count_on(Decision(7));
        claims.count_on(Decision::MOST);
        claims.count_on(Decision(u64::MAX));
        assert_eq!(claims.arrive(), Decision(502), "numbers do not come back");
    }
}
