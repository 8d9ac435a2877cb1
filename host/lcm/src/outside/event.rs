//! An event for all listeners outside: one queue, emptied for everybody.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::Value;
use tokio::sync::broadcast;
use trocar_model::{MemberId, Refusal, Type, decode};
use trocar_rt::mailbox::{EntryHead, Mailbox};

use super::super::boundary::{EventCell, EventSink, Tap};
use super::super::instance::Instance;
use super::{Shows, misfit, wrong_kind};

/// Events that may wait between two looks.
const DEPTH: usize = 256;
/// Events that may wait for a slow listener.
const WAITING: usize = 1024;
/// Time between two looks at the queue.
const LOOK: Duration = Duration::from_millis(5);

/// A listener to an event.
pub(super) struct Event {
    told: broadcast::Receiver<Option<Arc<Heard>>>,
    /// Numbers of the event before the listener's first one, and before its next one.
    first: u64,
    last: u64,
    /// True when the event had ended before this listener came.
    is_over: bool,
    /// Keeps the shared event open.
    _shared: Arc<SharedEvent>,
}

/// An event that was sent.
pub(super) struct Heard {
    /// Counts events that were lost in the queue, too.
    number: u64,
    pub(super) value: Value,
    pub(super) stamp_ns: u64,
}

/// The event, queued once for all listeners; the queue ends with the last of them.
pub(super) struct SharedEvent {
    instance: Arc<Instance>,
    member: MemberId,
    cell: Arc<EventCell>,
    ty: Option<Type>,
    tap: Arc<Tap>,
    sink: Arc<EventSink>,
    drained: Mutex<Drained>,
    /// `None`: no more events come.
    tell: broadcast::Sender<Option<Arc<Heard>>>,
    over: AtomicBool,
}

#[derive(Default)]
struct Drained {
    number: u64,
    dropped: u64,
    /// True once a payload that does not fit was reported.
    warned: bool,
}

impl Event {
    pub(super) fn open(lcm: &impl Shows, member: &MemberId) -> Result<Event, Refusal> {
        let instance = lcm.component(&member.port.component)?;
        let key = (instance.number, member.clone());
        let holds = |shared: &SharedEvent| !shared.is_over();
        let shared = lcm.outside().events.join(key, holds, || SharedEvent::open(instance.clone(), member))?;
        let (first, told) = shared.listen();
        let is_over = shared.over.load(Ordering::Acquire);
        Ok(Event { told, first, last: first, is_over, _shared: shared })
    }

    /// The next event, its number since this listener came, and how many were left out before it; `None` when
    /// no more can come. Cancelling the future loses no event.
    pub(super) async fn next(&mut self) -> Option<(Arc<Heard>, u64, u64)> {
        while !self.is_over {
            match self.told.recv().await {
                Ok(Some(heard)) => {
                    let before = std::mem::replace(&mut self.last, heard.number);
                    let (seq, skipped) = (heard.number - self.first, heard.number - before - 1);
                    return Some((heard, seq, skipped));
                }
                Ok(None) | Err(broadcast::error::RecvError::Closed) => self.is_over = true,
                // The next number shows how many were lost.
                Err(broadcast::error::RecvError::Lagged(_)) => {}
            }
        }
        None
    }
}

impl SharedEvent {
    fn open(instance: Arc<Instance>, member: &MemberId) -> Result<Arc<SharedEvent>, Refusal> {
        let (cell, ty) = event_of(&instance, member)?;
        let tap = Arc::new(Tap { mailbox: Mailbox::new(DEPTH, ty.as_ref().map_or(0, Type::size), 0) });
        let sink = Arc::new(EventSink::Tap(tap.clone()));
        cell.edit(|sinks| sinks.push(sink.clone()));
        let shared = Arc::new(SharedEvent {
            instance,
            member: member.clone(),
            cell,
            ty,
            tap,
            sink,
            drained: Mutex::default(),
            tell: broadcast::channel(WAITING).0,
            over: AtomicBool::new(false),
        });
        tokio::spawn(keep_draining(Arc::downgrade(&shared)));
        Ok(shared)
    }

    /// Returns the number of the last event so far, and a receiver of all later ones.
    fn listen(&self) -> (u64, broadcast::Receiver<Option<Arc<Heard>>>) {
        let mut drained = self.drained.lock();
        self.empty(&mut drained);
        (drained.number, self.tell.subscribe())
    }

    /// Tells whether no more events can come: the component is gone or made anew, or described itself without
    /// this event.
    fn is_over(&self) -> bool {
        self.over.load(Ordering::Acquire)
            || self.instance.is_closed()
            || !event_of(&self.instance, &self.member).is_ok_and(|(cell, _)| Arc::ptr_eq(&cell, &self.cell))
    }

    fn drain(&self) {
        self.empty(&mut self.drained.lock());
    }

    fn empty(&self, drained: &mut Drained) {
        let dropped = self.tap.mailbox.stats().dropped;
        drained.number += dropped - std::mem::replace(&mut drained.dropped, dropped);
        let tell = |head: EntryHead, payload: &[u8]| {
            drained.number += 1;
            let value = match &self.ty {
                Some(ty) => decode(ty, &payload[..ty.size()]).unwrap_or_else(|e| {
                    if !std::mem::replace(&mut drained.warned, true) {
                        let said = misfit(&self.instance, &e);
                        self.instance.warn(&format!("event {}: {said}; null is shown for it", self.member));
                    }
                    Value::Null
                }),
                None => Value::Null,
            };
            let heard = Heard { number: drained.number, value, stamp_ns: head.stamp_ns };
            // A failure is fine without listeners.
            let _ = self.tell.send(Some(Arc::new(heard)));
        };
        self.tap.mailbox.drain(tell, |_| ());
    }
}

impl Drop for SharedEvent {
    fn drop(&mut self) {
        self.cell.edit(|sinks| sinks.retain(|s| !Arc::ptr_eq(s, &self.sink)));
        self.instance.reclaim();
    }
}

/// Empties the queue of an event as long as there are listeners.
async fn keep_draining(shared: Weak<SharedEvent>) {
    loop {
        tokio::time::sleep(LOOK).await;
        let Some(shared) = shared.upgrade() else { return };
        // Read before the drain: events from before the end are still given.
        let is_over = shared.is_over();
        shared.drain();
        if is_over {
            shared.over.store(true, Ordering::Release);
            let _ = shared.tell.send(None);
            return;
        }
    }
}

/// The cell from which the event is sent now, and the type of its payload.
fn event_of(instance: &Instance, member: &MemberId) -> Result<(Arc<EventCell>, Option<Type>), Refusal> {
    let set = instance.described.now();
    let ports = &set.ports;
    let port = member.port.port.as_str();
    let Some(interface) = ports.provided.iter().position(|p| p.name == port) else {
        return Err(Refusal::InterfaceNotFound {
            port: member.port.clone(),
            known: ports.provided.iter().map(|p| p.name.clone()).collect(),
        });
    };
    // An event and a command may share a name: the read `operating_state` of an arm returns the payload of
    // the last event of that name.
    let events = &ports.provided[interface].events;
    let Some(i) = events.iter().position(|e| e.name == member.member.as_str()) else {
        let commands = &ports.provided[interface].commands;
        if let Some(command) = commands.iter().find(|c| c.name == member.member.as_str()) {
            return Err(wrong_kind(member, format!("a {} command", command.kind.name()), "an event"));
        }
        return Err(Refusal::MemberNotFound {
            member: member.clone(),
            known: events.iter().map(|e| e.name.clone()).collect(),
        });
    };
    Ok((set.slots.event(ports.first_event(interface) + i).clone(), events[i].payload.clone()))
}
