//! Waiting for an event: until a component sends it, or until it cannot send it any more.
//!
//! Invariant: the event is listened for before anything else is done, so nothing sent after that is missed;
//! the waiting ends by its deadline, and at once when the event cannot come.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc::Receiver;
use tokio::sync::watch;
use trocar_lcm_api::{Item, Selection, clock};
use trocar_model::{ComponentId, MemberId, Refusal, State, SystemGraph};

use super::{Gcm, given_ns};

/// Time for an event that is on its way here when its component is already known to have failed.
const UNDER_WAY: Duration = Duration::from_millis(100);
/// Pause before a component that was made anew is listened to again.
const AGAIN: Duration = Duration::from_millis(5);

/// An event that is listened for.
pub struct Listening {
    gcm: Gcm,
    member: MemberId,
    began: Instant,
    until: Instant,
    graphs: watch::Receiver<Arc<SystemGraph>>,
    feed: Receiver<Item>,
}

impl Gcm {
    /// Listens for an event; nothing that is sent after this returns is missed.
    ///
    /// # Errors
    /// An absent member is named, with those that exist; ComponentFault of a component that cannot send.
    pub async fn listen(&self, member: &MemberId, until: Instant) -> Result<Listening, Refusal> {
        let (began, graphs) = (clock::now(), self.watch());
        let feed = self.feed(member, until).await?;
        Ok(Listening { gcm: self.clone(), member: member.clone(), began, until, graphs, feed })
    }

    /// Listens as soon as the LCM has the component: it may just be making it anew.
    async fn feed(&self, member: &MemberId, until: Instant) -> Result<Receiver<Item>, Refusal> {
        let id = &member.port.component;
        loop {
            able(&self.graph(), id)?;
            let lcm = self.lcm_of(&id.process)?;
            let selection = Selection { path: member.to_string(), ..Selection::default() };
            match lcm.subscribe(vec![selection]).await {
                Err(Refusal::ComponentNotFound { .. }) if clock::now() < until => {
                    tokio::time::sleep(AGAIN).await;
                }
                listening => return listening,
            }
        }
    }
}

impl Listening {
    /// Waits for the next event.
    ///
    /// # Errors
    /// EventNotSeen at the deadline; ComponentFault, ComponentNotFound, PeerLost when it cannot come any
    /// more.
    pub async fn event(mut self) -> Result<Item, Refusal> {
        let (until, id) = (self.until, self.member.port.component.clone());
        loop {
            let graph = tokio::select! {
                // An event that is already here counts before everything else.
                biased;
                item = self.feed.recv() => match item {
                    Some(item) => return Ok(item),
                    // The component was made anew, is being removed, or does not have this event any more.
                    None => {
                        tokio::time::sleep_until((clock::now() + AGAIN).min(until).into()).await;
                        self.feed = self.gcm.feed(&self.member, until).await?;
                        continue;
                    }
                },
                () = tokio::time::sleep_until(until.into()) => {
                    let state = self.gcm.graph().components.get(&id).map_or(State::Created, |c| c.state);
                    let after_ns = given_ns(self.began, until);
                    return Err(Refusal::EventNotSeen { member: self.member, state, after_ns });
                }
                changed = self.graphs.changed() => match changed {
                    Ok(()) => self.graphs.borrow_and_update().clone(),
                    Err(_) => return Err(Refusal::PeerLost { member: self.member }),
                },
            };
            if let Err(refusal) = able(&graph, &id) {
                let until = (clock::now() + UNDER_WAY).min(until);
                let last = tokio::time::timeout_at(until.into(), self.feed.recv());
                return last.await.ok().flatten().ok_or(refusal);
            }
        }
    }
}

/// Tells whether a component can ever send something.
fn able(graph: &SystemGraph, id: &ComponentId) -> Result<(), Refusal> {
    match graph.components.get(id) {
        None if !graph.processes.contains_key(&id.process) => Err(Refusal::ProcessNotFound {
            process: id.process.clone(),
            known: graph.processes.keys().cloned().collect(),
        }),
        None => Err(Refusal::ComponentNotFound {
            id: id.clone(),
            known: graph.components.keys().cloned().collect(),
        }),
        Some(c) if c.state == State::Fault => {
            Err(Refusal::ComponentFault { id: id.clone(), text: c.fault.clone() })
        }
        Some(_) => Ok(()),
    }
}
