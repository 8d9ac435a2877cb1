//! AttachService, the GCM's half: takes a process in, keeps its lease, and is its LCM for all callers here.
//!
//! Invariant: a process is heard exactly as long as its stream lasts; when the stream ends, every waiting
//! caller is answered.

mod feeds;
mod own;
mod remote;
mod road;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use trocar_model::{Name, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::attach_service_server::AttachService;
use trocar_proto::v1::{attach_request, attach_response};

pub use self::feeds::FeedOutbound;
use self::feeds::Feeds;
use self::remote::{Outgoing, RemoteLcm, message};
use super::caller::{Peer, is_process};
use super::convert;
use super::status::status;
use crate::gcm::{Gcm, Registered, Registration, Told};

/// Interval at which both sides say that they are alive.
pub(super) const BEAT: Duration = Duration::from_millis(100);
/// After this many beats of silence the peer is lost. Beats are counted, not measured: a machine that stood
/// still must not take its own pause for the peer's silence.
pub(super) const LEASE: u32 = 5;
/// Looks for silence in one beat: a process is reported lost within half a beat after its lease.
const LOOKS: u32 = 2;
/// Largest message of an Attach stream, bytes: a Hello describes every class of a process.
pub(super) const MAX_MESSAGE: usize = 32 << 20;
/// Time for the Hello.
const HELLO: Duration = Duration::from_secs(2);
/// Messages that may wait to be sent.
const QUEUE: usize = 256;

/// Messages to a process.
pub type Outbound = ReceiverStream<Result<v1::AttachResponse, Status>>;

/// The GCM's half of Attach.
pub struct AttachEdge {
    gcm: Gcm,
    feeds: Feeds,
    /// Ends when the port closes.
    open: watch::Receiver<()>,
}

impl AttachEdge {
    /// Takes processes in for a GCM until the sender of `open` is dropped.
    pub fn new(gcm: Gcm, open: watch::Receiver<()>) -> Self {
        AttachEdge { gcm, feeds: Feeds::default(), open }
    }

    /// Hears a process over the messages that it sends; returns those to it.
    ///
    /// # Errors
    /// Its first message is no hello, or is late.
    pub async fn hear<I>(&self, inbound: I) -> Result<Outbound, Status>
    where
        I: Stream<Item = Result<v1::AttachRequest, Status>> + Send + Unpin + 'static,
    {
        self.hear_from(None, inbound).await
    }

    /// Does the same for a caller that may be the processes that its certificate names.
    async fn hear_from<I>(&self, peer: Option<&Peer>, mut inbound: I) -> Result<Outbound, Status>
    where
        I: Stream<Item = Result<v1::AttachRequest, Status>> + Send + Unpin + 'static,
    {
        let first = tokio::time::timeout(HELLO, inbound.next()).await;
        let Ok(Some(Ok(v1::AttachRequest { message: Some(attach_request::Message::Hello(hello)) }))) = first
        else {
            return Err(status(&Refusal::ArgumentInvalid {
                what: "Attach".into(),
                why: "the first message must be hello, within 2 s".into(),
                field: "hello".into(),
            }));
        };
        is_process(peer, "Attach", &hello.process).map_err(|refusal| status(&refusal))?;
        let (out, orders) = mpsc::channel(QUEUE);
        let first = match self.take_in(hello, &out).await {
            Ok(attached) => {
                let Registered { epoch, term, .. } = attached.registered;
                let revision = self.gcm.revision_on_record();
                tokio::spawn(attached.keep(inbound, out.clone(), self.open.clone()));
                attach_response::Message::Registered(v1::Registered { epoch, term, revision })
            }
            Err(refusal) => attach_response::Message::Refused(convert::refusal_info(&refusal)),
        };
        // The receiver may be gone: the stream's end says the same.
        let _ = out.send(Ok(message(first))).await;
        Ok(ReceiverStream::new(orders))
    }

    async fn take_in(&self, hello: v1::Hello, out: &Outgoing) -> Result<Attached, Refusal> {
        let process = Name::parse(&hello.process)?;
        let inventory = convert::inventory_in(hello.inventory.unwrap_or_default())?;
        let instance: [u8; 16] =
            hello.instance.as_slice().try_into().map_err(|_| convert::unreadable("instance (16 bytes)"))?;
        let who = Registration {
            process: process.clone(),
            endpoint: hello.endpoint,
            pid: hello.pid,
            instance: u128::from_be_bytes(instance),
            epoch: hello.epoch,
            slice: convert::slice_in(hello.slice.unwrap_or_default())?,
            revision: hello.revision,
            guest: String::new(),
            comes_again: true,
        };
        let (instance, feeds) = (who.instance, hello.feeds);
        let lcm = RemoteLcm::new(process.clone(), out.clone(), feeds);
        let inventory = lcm.own(inventory);
        let registered = self.gcm.register(who, lcm.clone(), inventory).await?;
        if feeds {
            self.feeds.expect(&process, (instance, registered.epoch), &lcm);
        }
        Ok(Attached { gcm: self.gcm.clone(), process, lcm, registered })
    }
}

#[tonic::async_trait]
impl AttachService for AttachEdge {
    type AttachStream = Outbound;

    async fn attach(
        &self,
        request: Request<Streaming<v1::AttachRequest>>,
    ) -> Result<Response<Self::AttachStream>, Status> {
        let (_, extensions, inbound) = request.into_parts();
        Ok(Response::new(self.hear_from(extensions.get(), inbound).await?))
    }

    type FeedStream = FeedOutbound;

    async fn feed(
        &self,
        request: Request<Streaming<v1::FeedRequest>>,
    ) -> Result<Response<Self::FeedStream>, Status> {
        let (_, extensions, inbound) = request.into_parts();
        let fed = self.feeds.hear(extensions.get(), inbound, self.open.clone()).await;
        Ok(Response::new(fed.map_err(|refusal| status(&refusal))?))
    }

    type SuperviseStream = ReceiverStream<Result<v1::SuperviseResponse, Status>>;

    async fn supervise(
        &self,
        request: Request<v1::SuperviseRequest>,
    ) -> Result<Response<Self::SuperviseStream>, Status> {
        let (_, extensions, asked) = request.into_parts();
        let apart = asked.apart.iter().map(|apart| &apart.process);
        for process in asked.processes.iter().chain(apart) {
            is_process(extensions.get(), "Supervise", process).map_err(|refusal| status(&refusal))?;
        }
        let who = convert::supervisor(asked).map_err(|refusal| status(&refusal))?;
        let (mut supervising, term) = (self.gcm.supervise(who), self.gcm.term());
        let (tell, told) = mpsc::channel(1);
        let mut open = self.open.clone();
        tokio::spawn(async move {
            loop {
                let wanted = tokio::select! {
                    wanted = supervising.next() => wanted,
                    () = tell.closed() => return,
                    _ = open.changed() => return,
                };
                if tell.send(Ok(convert::wanted(term, wanted))).await.is_err() {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(told)))
    }

    async fn tell(&self, request: Request<v1::TellRequest>) -> Result<Response<v1::TellResponse>, Status> {
        let (_, extensions, asked) = request.into_parts();
        for told in &asked.processes {
            is_process(extensions.get(), "Tell", &told.process).map_err(|refusal| status(&refusal))?;
        }
        let told: Result<Vec<Told>, Refusal> = asked.processes.into_iter().map(convert::told).collect();
        // A report is entered only if all of it is understood.
        for told in told.map_err(|refusal| status(&refusal))? {
            self.gcm.told(&told);
        }
        Ok(Response::new(v1::TellResponse { term: self.gcm.term() }))
    }
}

/// A process that was taken in.
struct Attached {
    gcm: Gcm,
    process: Name,
    lcm: Arc<RemoteLcm>,
    registered: Registered,
}

impl Attached {
    /// Hears the process until it is silent or gone.
    async fn keep<I>(self, mut inbound: I, out: Outgoing, mut open: watch::Receiver<()>)
    where
        I: Stream<Item = Result<v1::AttachRequest, Status>> + Send + Unpin,
    {
        let mut look = tokio::time::interval(BEAT / LOOKS);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut looks, mut silent, mut sequence) = (0, 0, 0);
        let why = loop {
            tokio::select! {
                // Messages that arrived count before the silence does.
                biased;
                arrived = inbound.next() => match arrived {
                    Some(Ok(said)) => {
                        silent = 0;
                        self.lcm.hear(said);
                    }
                    None => break "it closed the stream".to_owned(),
                    Some(Err(e)) => break e.message().to_owned(),
                },
                _ = open.changed() => break "this port is closing".to_owned(),
                _ = look.tick() => {
                    // The supervisor may have given the process up by mistake: then it comes back and says
                    // so.
                    if !self.gcm.hears(&self.process, self.registered.session) {
                        break "it was given up".to_owned();
                    }
                    if silent == LEASE * LOOKS {
                        break format!("silent for {} ms", (BEAT * LEASE).as_millis());
                    }
                    silent += 1;
                    looks = (looks + 1) % LOOKS;
                    if looks != 1 {
                        continue;
                    }
                    sequence += 1;
                    let beat = attach_response::Message::Heartbeat(v1::Heartbeat {
                        sequence,
                        revision: self.gcm.revision_on_record(),
                        doubted: self.gcm.is_doubted(),
                    });
                    // A full queue means it does not read: then its own lease ends.
                    let _ = out.try_send(Ok(message(beat)));
                }
            }
        };
        log::info!("the stream of process {} ended: {why}", self.process);
        self.lcm.close();
        self.gcm.lost(&self.process, self.registered.session);
    }
}
