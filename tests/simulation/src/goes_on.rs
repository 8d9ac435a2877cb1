//! Everything that was accepted and has to go on: components that run, and connections.
//!
//! Invariant: what was accepted ends by a request that was not answered before, by a failure, or with its
//! process; nothing else is a reason.

use std::collections::BTreeMap;

use trocar_model::{ComponentId, Connection, Request, Safety, Target, Which};

/// Way in which a component came to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// Somebody ordered it.
    Ordered,
    /// It failed.
    Failed,
    /// Its process ended.
    Ended,
}

#[derive(Default)]
pub(super) struct GoesOn {
    /// Components that run since an accepted request, by the event at which that was asked.
    runs: BTreeMap<ComponentId, u64>,
    /// The same, of components that went with their process, which is to start them again.
    again: BTreeMap<ComponentId, u64>,
    /// Accepted connections, by number.
    connections: BTreeMap<u64, (u64, Connection)>,
    /// Requests that end something, by the event at which they were asked.
    ends: BTreeMap<u64, Ends>,
    /// Events at which components failed, or ended with their process.
    own: BTreeMap<ComponentId, u64>,
    /// Events at which components refused something.
    refused: BTreeMap<ComponentId, u64>,
    /// Event of the last rest: of what was asked before that is known no more than how it stood then.
    rested: u64,
}

struct Ends {
    requests: Vec<Request>,
    /// Event at which it was answered, and nothing of it is done later.
    closed: Option<u64>,
}

impl GoesOn {
    /// Somebody asks for something by which other things may end.
    pub(super) fn asked(&mut self, event: u64, requests: &[Request]) {
        let ends: Vec<Request> = requests.iter().filter(|request| ends(request)).cloned().collect();
        if !ends.is_empty() {
            self.ends.insert(event, Ends { requests: ends, closed: None });
        }
    }

    /// It was answered, and nothing of it is done any more.
    pub(super) fn closed(&mut self, asked: u64, now: u64) {
        if let Some(ends) = self.ends.get_mut(&asked) {
            ends.closed = Some(now);
        }
    }

    /// An accepted request, asked at that event, has set a component in motion. Returns what is wrong.
    /// `is_first`: this is no answer that was given before.
    pub(super) fn started(
        &mut self,
        id: &ComponentId,
        (asked, is_first): (u64, bool),
        moves: bool,
    ) -> Option<String> {
        if asked < self.rested {
            return None;
        }
        let may_rest = self.own.get(id).is_some_and(|at| *at > asked) || self.may_rest(id, asked);
        // It may move by another request since an answer that was given before.
        if may_rest && !(moves && is_first) {
            return None;
        }
        if moves {
            let since = self.runs.entry(id.clone()).or_default();
            *since = asked.max(*since);
            return None;
        }
        Some(format!("{id} was started by the request of event {asked}, and nobody has stopped it"))
    }

    /// A component that goes on by itself in a new incarnation.
    pub(super) fn moves(&mut self, id: &ComponentId) {
        // One that refused to be started again is set in motion by another request.
        if let Some(since) = self.again.remove(id).filter(|since| !self.has_refused(id, *since)) {
            self.runs.insert(id.clone(), since);
        }
    }

    /// A component that moved has come to rest. Returns what is wrong.
    pub(super) fn stands(&mut self, id: &ComponentId, how: Rest, safety: Safety, now: u64) -> Option<String> {
        if how != Rest::Ordered {
            self.own.insert(id.clone(), now);
        }
        let since = self.runs.remove(id)?;
        match how {
            Rest::Ordered if !self.may_rest(id, since) => {
                Some(format!("{id} is stopped, which nobody has asked for since event {since}"))
            }
            Rest::Ended if safety != Safety::Actuator => {
                self.again.insert(id.clone(), since);
                None
            }
            _ => None,
        }
    }

    /// A component has failed that did not move.
    pub(super) fn failed(&mut self, id: &ComponentId, now: u64) {
        self.own.insert(id.clone(), now);
        self.again.remove(id);
    }

    /// A component has refused something.
    pub(super) fn refused(&mut self, id: &ComponentId, now: u64) {
        self.refused.insert(id.clone(), now);
    }

    /// Tells whether a component has refused something since.
    pub(super) fn has_refused(&self, id: &ComponentId, since: u64) -> bool {
        self.refused.get(id).is_some_and(|at| *at > since)
    }

    /// A connection was accepted.
    pub(super) fn connected(&mut self, connection: &Connection, asked: u64) {
        if asked < self.rested {
            return;
        }
        self.connections.insert(connection.id.0, (asked, connection.clone()));
    }

    /// Returns what is wrong at rest. `moving`: components that move; `connections`: those on record.
    pub(super) fn at_rest<'c>(
        &self,
        moving: impl Fn(&ComponentId) -> bool,
        connections: impl Fn(u64) -> Option<&'c Connection>,
    ) -> Vec<String> {
        let has_refused = |id, since| self.has_refused(id, since);
        let rests = self
            .again
            .iter()
            .filter(|(id, since)| !moving(id) && !has_refused(id, **since) && !self.may_rest(id, **since));
        let rests =
            rests.map(|(id, since)| format!("{id} runs since event {since}, and is not started again"));
        let gone = self.connections.values().filter(|(since, c)| {
            let ends = [&c.client.component, &c.server.component];
            let is_same = |other: &Connection| (&other.client, &other.server) == (&c.client, &c.server);
            !connections(c.id.0).is_some_and(is_same)
                && !ends.iter().any(|end| has_refused(end, *since))
                && !self.may_be_cut(c, *since)
        });
        let gone =
            gone.map(|(since, c)| format!("{c:?} was accepted by event {since}, and is not on record"));
        rests.chain(gone).collect()
    }

    /// Everything is at rest: what moves and is connected now goes on.
    pub(super) fn rests<'c>(
        &mut self,
        moving: impl Iterator<Item = ComponentId>,
        connections: impl Iterator<Item = &'c Connection>,
        now: u64,
    ) {
        self.forgets();
        self.ends.clear();
        self.rested = now;
        self.runs = moving.map(|id| (id, now)).collect();
        self.connections = connections.map(|c| (c.id.0, (now, c.clone()))).collect();
    }

    /// Nobody knows any more what was accepted.
    pub(super) fn forgets(&mut self) {
        self.runs.clear();
        self.again.clear();
        self.connections.clear();
    }

    fn since(&self, since: u64) -> impl Iterator<Item = &Request> {
        let open = self.ends.values().rev().filter(move |ends| ends.closed.is_none_or(|at| at > since));
        open.flat_map(|ends| &ends.requests)
    }

    /// Tells whether a component may rest that was started by a request of that event.
    fn may_rest(&self, id: &ComponentId, since: u64) -> bool {
        let names = |targets: &[Target]| targets.iter().any(|target| target.names(id));
        self.since(since).any(|request| match request {
            Request::Stop { targets } | Request::Reset { targets } => names(targets),
            Request::Remove { id: gone, .. } => gone == id,
            _ => false,
        })
    }

    /// Tells whether a connection may be gone that was made by a request of that event.
    fn may_be_cut(&self, c: &Connection, since: u64) -> bool {
        self.since(since).any(|request| match request {
            Request::Disconnect { which: Which::Id(id) } => *id == c.id,
            Request::Disconnect { which: Which::Pair { client, server } } => {
                (client, server) == (&c.client, &c.server)
            }
            Request::Remove { id, .. } => [&c.client.component, &c.server.component].contains(&id),
            Request::Connect { client, options, .. } => options.replace && *client == c.client,
            _ => false,
        })
    }
}

/// Tells whether something may end by a request.
fn ends(request: &Request) -> bool {
    match request {
        Request::Stop { .. }
        | Request::Reset { .. }
        | Request::Remove { .. }
        | Request::Disconnect { .. } => true,
        Request::Connect { options, .. } => options.replace,
        _ => false,
    }
}
