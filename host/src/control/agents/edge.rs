//! AgentService: what `trocar up` of another machine orders of this one.
//!
//! Invariant: a caller is heard exactly as long as its stream lasts; what it orders is done in its order.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use trocar_loader::Hash;
use trocar_model::{Name, Refusal};
use trocar_proto::v1::agent_service_server::AgentService;
use trocar_proto::v1::{self, keep_request::Message};

use super::wire::{hash_in, listed_out, statuses_out, wanted_in};
use crate::agent::{Agent, Seat};
use crate::control::caller::Peer;
use crate::control::status::status;

/// Time for the first message.
const HELLO: Duration = Duration::from_secs(2);
/// The caller is told how things stand at least so often: it knows by that that the agent is heard.
const BEAT: Duration = Duration::from_secs(1);
/// Longest name of a run.
const LONGEST: usize = 64;
/// Hashes that are asked about at once.
const MOST: usize = 65_536;

/// The service of an agent.
pub(crate) struct AgentEdge {
    agent: Agent,
    /// Ends when the port closes.
    open: watch::Receiver<()>,
}

impl AgentEdge {
    pub(crate) fn new(agent: Agent, open: watch::Receiver<()>) -> AgentEdge {
        AgentEdge { agent, open }
    }
}

fn refuse(refusal: Refusal) -> Status {
    status(&refusal)
}

fn invalid(what: &str, why: &str, field: &str) -> Status {
    refuse(Refusal::ArgumentInvalid { what: what.into(), why: why.into(), field: field.into() })
}

#[tonic::async_trait]
impl AgentService for AgentEdge {
    type KeepStream = ReceiverStream<Result<v1::KeepResponse, Status>>;

    async fn keep(
        &self,
        request: Request<Streaming<v1::KeepRequest>>,
    ) -> Result<Response<Self::KeepStream>, Status> {
        let peer = request.extensions().get::<Peer>().cloned();
        let caller = peer.as_ref().map_or_else(|| "somebody".into(), Peer::to_string);
        let mut inbound = request.into_inner();
        let first = tokio::time::timeout(HELLO, inbound.next()).await;
        let Ok(Some(Ok(v1::KeepRequest { message: Some(Message::Hello(hello)) }))) = first else {
            return Err(invalid("Keep", "the first message must be hello, within 2 s", "hello"));
        };
        let system = Name::parse(&hello.system).map_err(refuse)?;
        if hello.run.is_empty() || hello.run.len() > LONGEST {
            return Err(invalid("Keep", "a run has a name of 1 to 64 bytes, drawn by lot", "run"));
        }
        log::info!(target: "audit", "{caller} has processes of the system {system} kept");
        let seat = self.agent.take_in(system, &hello.run, caller).await.map_err(refuse)?;
        let (out, answers) = mpsc::channel(1);
        tokio::spawn(keep(seat, peer, inbound, out, self.open.clone()));
        Ok(Response::new(ReceiverStream::new(answers)))
    }

    async fn missing(
        &self,
        request: Request<v1::MissingRequest>,
    ) -> Result<Response<v1::MissingResponse>, Status> {
        let asked = request.into_inner().sha256;
        if asked.len() > MOST {
            return Err(invalid("Missing", "it asks about more than 65536 files", "sha256"));
        }
        let hashes = asked.iter().map(|text| hash_in(text)).collect::<Result<Vec<Hash>, Refusal>>();
        let missing = self.agent.missing(&hashes.map_err(refuse)?);
        Ok(Response::new(v1::MissingResponse { sha256: missing.iter().map(Hash::to_string).collect() }))
    }

    async fn bring(
        &self,
        request: Request<Streaming<v1::BringRequest>>,
    ) -> Result<Response<v1::BringResponse>, Status> {
        let mut parts = request.into_inner();
        let Some(first) = parts.message().await? else {
            return Err(invalid("Bring", "nothing was brought", "sha256"));
        };
        let mut coming = self.agent.bring(hash_in(&first.sha256).map_err(refuse)?).map_err(refuse)?;
        coming.take(&first.bytes).map_err(refuse)?;
        while let Some(part) = parts.message().await? {
            coming.take(&part.bytes).map_err(refuse)?;
        }
        // It waits for the disk.
        let kept = tokio::task::spawn_blocking(move || coming.finish()).await;
        kept.map_err(|e| Status::internal(e.to_string()))?.map_err(refuse)?;
        Ok(Response::new(v1::BringResponse {}))
    }

    async fn list_systems(
        &self,
        _: Request<v1::ListSystemsRequest>,
    ) -> Result<Response<v1::ListSystemsResponse>, Status> {
        let systems = self.agent.systems().await.into_iter().map(listed_out).collect();
        Ok(Response::new(v1::ListSystemsResponse { systems }))
    }
}

/// Does what the caller orders, and tells it what becomes of its processes.
async fn keep(
    seat: Seat,
    peer: Option<Peer>,
    mut inbound: Streaming<v1::KeepRequest>,
    out: mpsc::Sender<Result<v1::KeepResponse, Status>>,
    mut open: watch::Receiver<()>,
) {
    let mut following = seat.following();
    let mut beats = tokio::time::interval(BEAT);
    let mut is_news = true;
    loop {
        tokio::select! {
            // One that asks and hangs up is told all the same.
            biased;
            place = out.reserve(), if is_news => {
                let Ok(place) = place else { return left(seat, peer.as_ref()) };
                let folder = seat.folder().to_string_lossy().into_owned();
                place.send(Ok(v1::KeepResponse { folder, statuses: statuses_out(&following.now()) }));
                is_news = false;
            }
            said = inbound.next() => {
                let Some(Ok(v1::KeepRequest { message: Some(message) })) = said else {
                    return left(seat, peer.as_ref());
                };
                if !seat.beat() {
                    return;
                }
                if let Err(refusal) = act(&seat, message) {
                    // Whoever has gone hears no refusal.
                    let _ = out.send(Err(refuse(refusal))).await;
                    return;
                }
            }
            () = following.changed() => is_news = true,
            _ = beats.tick() => is_news = true,
            // Its sender carries no value: it only goes.
            _ = open.changed() => return,
        }
    }
}

/// Leaves a seat whose connection has ended: a network that gave up has not hung up for the caller.
fn left(seat: Seat, peer: Option<&Peer>) {
    if peer.is_some_and(Peer::is_cut) {
        seat.stays();
    }
}

fn act(seat: &Seat, message: Message) -> Result<(), Refusal> {
    match message {
        Message::Hello(_) | Message::Beat(_) => {}
        Message::Start(wanted) => seat.start(&wanted_in(wanted)?),
        Message::PutDown(useless) => seat.put_down(&useless.process, useless.pid, useless.why),
        Message::Again(process) => seat.again(&process),
        Message::End(process) => seat.ask_to_end(&process),
        Message::Forget(process) => seat.forget(&process),
    }
    Ok(())
}
