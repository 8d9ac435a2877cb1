//! InteractService: calls, reads, subscriptions, logs.

use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};
use trocar_model::{MemberId, Name, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::interact_service_server::InteractService;

use super::identity::identity;
use super::logs::{self, Wanted};
use super::{Edge, not_built, refuse};
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::gcm::Gcm;
use crate::lcm::Invoke;

type Items = Pin<Box<dyn Stream<Item = Result<v1::SubscribeResponse, Status>> + Send>>;
type Lines = Pin<Box<dyn Stream<Item = Result<v1::LogsResponse, Status>> + Send>>;

/// Most that one Subscribe follows: each is pushed to by the component's own thread.
const SELECTIONS: usize = 256;
/// Most that all callers of a port follow.
pub(crate) const FOLLOWED: usize = 16_384;
/// Items one caller may have waiting.
const WAITING: usize = 256;

/// The process a path begins with.
fn process_of(path: &str) -> Result<Name, Refusal> {
    Name::parse(path.split('/').next().unwrap_or_default())
        .map_err(|_| Refusal::BadPath { text: path.into(), why: "it begins with no process name".into() })
}

impl Edge {
    /// Calls a command and waits for its outcome, `until` at most.
    pub(super) async fn call(
        &self,
        r: v1::InvokeRequest,
        until: Instant,
    ) -> Result<v1::InvokeResponse, Refusal> {
        let member = MemberId::parse(&r.path)?;
        let room = room(until);
        let left = until.saturating_duration_since(Instant::now()).saturating_sub(room);
        let left = u64::try_from(left.as_nanos()).unwrap_or(u64::MAX);
        let asked = r.deadline.as_ref().map(|d| {
            convert::duration_ns(d).ok_or_else(|| Refusal::ArgumentInvalid {
                what: "deadline".into(),
                why: "it must not be negative".into(),
                field: "deadline".into(),
            })
        });
        let deadline_ns = asked.transpose()?.unwrap_or(1_000_000_000).clamp(1, left.max(1));
        let arg = convert::payload(r.json, r.encoded);
        let lcm = self.lcm(&member.port.component.process)?;
        let call = Invoke { member: member.clone(), arg, send: r.send, deadline_ns };
        // The LCM keeps the deadline itself; this time is for an LCM that does not answer at all.
        let patience = Duration::from_nanos(deadline_ns) + room * 3 / 4;
        let process = member.port.component.process.clone();
        let reply = tokio::time::timeout(patience, lcm.invoke(call))
            .await
            .unwrap_or(Err(Refusal::Deadline { member, after_ns: deadline_ns, may_still_run: true }));
        match reply {
            Ok(reply) => Ok(convert::reply(reply)),
            Err(refusal) => {
                // A caller that is told of a panicked command then finds the component in FAULT.
                if let Some(gcm) = &self.gcm {
                    gcm.hear_out(&process).await;
                }
                Err(refusal)
            }
        }
    }
}

#[tonic::async_trait]
impl InteractService for Edge {
    async fn invoke(
        &self,
        request: Request<v1::InvokeRequest>,
    ) -> Result<Response<v1::InvokeResponse>, Status> {
        let until = deadline(&request);
        self.may_call(request.extensions(), &request.get_ref().path).map_err(refuse)?;
        let who = identity(&request);
        Ok(Response::new(self.invoked(who, request.into_inner(), until).await.map_err(refuse)?))
    }

    async fn read(&self, request: Request<v1::ReadRequest>) -> Result<Response<v1::ReadResponse>, Status> {
        let until = deadline(&request).min(Instant::now() + Duration::from_secs(2));
        let v1::ReadRequest { path, row, frame } = request.into_inner();
        let lcm = self.lcm(&process_of(&path).map_err(refuse)?).map_err(refuse)?;
        let sample = lcm.read(path, convert::when(row), frame, until).await.map_err(refuse)?;
        Ok(Response::new(convert::sample(sample)))
    }

    async fn emit(&self, _: Request<v1::EmitRequest>) -> Result<Response<v1::EmitResponse>, Status> {
        Err(not_built("Emit", "invoke a command of the component that generates the event"))
    }

    type SubscribeStream = Items;

    async fn subscribe(&self, request: Request<v1::SubscribeRequest>) -> Result<Response<Items>, Status> {
        let selections = request.into_inner().selections;
        if selections.is_empty() {
            return Err(refuse(Refusal::ArgumentInvalid {
                what: "Subscribe".into(),
                why: "nothing is selected: give selections such as [{\"path\": \"host/robot/arm/operating_state\"}]"
                    .into(),
                field: "selections".into(),
            }));
        }
        if selections.len() > SELECTIONS {
            return Err(refuse(Refusal::ArgumentInvalid {
                what: "Subscribe".into(),
                why: format!(
                    "it selects {}, and one Subscribe follows {SELECTIONS} at most: follow the rest by another",
                    selections.len()
                ),
                field: "selections".into(),
            }));
        }
        let count = selections.len() as u32;
        let Ok(permits) = self.followed.clone().try_acquire_many_owned(count) else {
            let said = format!(
                "{FOLLOWED} outputs and events are followed at this port, which is the most: end some of those calls, or follow fewer"
            );
            return Err(Status::resource_exhausted(said));
        };
        // Given back when the last of its followers ends.
        let permits = Arc::new(permits);
        let (tell, told) = mpsc::channel(WAITING);
        let mut feeds = Vec::new();
        for s in selections {
            let lcm = self.lcm(&process_of(&s.path).map_err(refuse)?).map_err(refuse)?;
            let selection = convert::selection(s).map_err(refuse)?;
            feeds.push(lcm.subscribe(vec![selection]).await.map_err(refuse)?);
        }
        for mut feed in feeds {
            let (tell, permits) = (tell.clone(), permits.clone());
            tokio::spawn(async move {
                let _held = permits;
                loop {
                    let item = tokio::select! {
                        () = tell.closed() => return,
                        item = feed.recv() => item,
                    };
                    // A slow caller fills this channel; the LCM then drops and counts.
                    let Some(item) = item else { return };
                    if tell.send(Ok(convert::item(item))).await.is_err() {
                        return;
                    }
                }
            });
        }
        Ok(Response::new(Box::pin(ReceiverStream::new(told))))
    }

    type LogsStream = Lines;

    async fn logs(&self, request: Request<v1::LogsRequest>) -> Result<Response<Lines>, Status> {
        let r = request.into_inner();
        let wanted = Wanted::parse(&r.path, &r.level).map_err(refuse)?;
        let graph = self.gcm.as_ref().map(Gcm::graph);
        wanted.names_somebody(graph.as_deref(), &self.lines).map_err(refuse)?;
        let follows = if r.follow { Some(self.standing.logs.take()?) } else { None };
        Ok(Response::new(Box::pin(logs::stream(&self.lines, wanted, follows, r.last))))
    }
}
