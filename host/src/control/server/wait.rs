//! WaitFor: until a component is in a state, or until it sends an event.
//!
//! Invariant: the call that is to cause the event is made after this request listens for the event.

use std::time::{Duration, Instant};

use tonic::{Request, Status};
use trocar_model::{ComponentId, MemberId, Refusal, State, StopReason};
use trocar_proto::v1::{self, ComponentState};

use super::{Edge, refuse};
use crate::control::convert;
use crate::control::deadline::{CAP, callers, deadline, room};
use crate::lcm::Item;

/// Condition and deadline of a WaitFor.
pub(super) struct Wait {
    pub(super) what: Awaited,
    pub(super) until: Instant,
}

pub(super) enum Awaited {
    States(ComponentId, Vec<State>),
    /// With the call that is made once this request listens for the event.
    Event(MemberId, Option<v1::InvokeRequest>),
}

impl Wait {
    /// # Errors
    /// BadPath; ArgumentInvalid for a negative deadline, and for fields that do not belong together.
    pub(super) fn read(request: Request<v1::WaitForRequest>) -> Result<Wait, Refusal> {
        let invalid = |field: &str, why: &str| Refusal::ArgumentInvalid {
            what: field.into(),
            why: why.into(),
            field: field.into(),
        };
        let asked = request.get_ref().deadline.as_ref().map(|d| {
            let ns = convert::duration_ns(d).ok_or_else(|| invalid("deadline", "it must not be negative"))?;
            Ok(Duration::from_nanos(ns).min(CAP))
        });
        let asked = asked.transpose()?.map(|d| Instant::now() + d);
        let until = match (callers(&request), asked) {
            (None, Some(asked)) => asked,
            _ => {
                let call = deadline(&request);
                let call = call - room(call);
                asked.map_or(call, |asked| asked.min(call))
            }
        };
        let r = request.into_inner();
        let states: Vec<State> = r.states().flat_map(states).collect();
        let what = match r.path.split('/').count() {
            4 if !states.is_empty() => {
                return Err(invalid("states", "an event is waited for, and events have no states"));
            }
            4 => Awaited::Event(MemberId::parse(&r.path)?, r.call),
            2 if r.call.is_some() => {
                return Err(invalid("call", "it goes with an event, process/component/interface/event"));
            }
            2 if states.is_empty() => Awaited::States(ComponentId::parse(&r.path)?, vec![State::Active]),
            2 => Awaited::States(ComponentId::parse(&r.path)?, states),
            _ => {
                return Err(Refusal::BadPath {
                    text: r.path,
                    why: "what can be waited for is process/component or process/component/interface/event"
                        .into(),
                });
            }
        };
        Ok(Wait { what, until })
    }
}

impl Edge {
    /// The event, or why it cannot be had. `call`: a command to be called first, and its caller.
    pub(super) async fn event(
        &self,
        member: &MemberId,
        call: Option<(String, v1::InvokeRequest)>,
        until: Instant,
    ) -> Result<Item, Status> {
        let listening = self.gcm()?.listen(member, until).await.map_err(refuse)?;
        if let Some((who, call)) = call {
            self.invoked(who, call, until).await.map_err(refuse)?;
        }
        listening.event().await.map_err(refuse)
    }
}

fn states(state: ComponentState) -> Vec<State> {
    match state {
        ComponentState::Unspecified => Vec::new(),
        ComponentState::Created => vec![State::Created],
        ComponentState::Ready => vec![State::Ready],
        ComponentState::Active => vec![State::Active],
        ComponentState::Fault => vec![State::Fault],
        ComponentState::Stopped => {
            let reasons =
                [StopReason::Requested, StopReason::Restarted, StopReason::Interlock, StopReason::PeerLost];
            reasons.into_iter().map(State::Stopped).collect()
        }
    }
}
