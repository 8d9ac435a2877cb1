//! The way of a process to its GCM: what carries the messages of both.
//!
//! Invariant: a line ends when either side lets go of it, and carries the messages of each side in their
//! order.

use std::pin::Pin;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use trocar_model::Refusal;
use trocar_proto::v1;
use trocar_proto::v1::attach_service_client::AttachServiceClient;

use super::feed::{FeedInbound, FeedOutgoing, Feeder};
use crate::control::attach::MAX_MESSAGE;
use crate::control::caller::Tokened;
use crate::control::dial::Dialler;
use crate::control::leader::{Leader, addresses, find_leader, innermost};

/// Messages of a GCM, in the order in which it sent them.
pub type Inbound = Pin<Box<dyn Stream<Item = Result<v1::AttachResponse, Status>> + Send>>;

/// Why there is no session.
#[derive(Debug)]
pub enum Refused {
    /// A GCM was asked, and refused.
    ByGcm(Refusal),
    /// No GCM was asked, or the answer is not a GCM's.
    Unheard(String),
}

/// The way to a GCM.
pub trait Way: Send + Sync + 'static {
    type Line: Line;

    /// Returns a line to a GCM that answers.
    ///
    /// # Errors
    /// Nobody answers. A GCM that hangs may take for ever.
    fn dial(&self) -> impl Future<Output = Result<Self::Line, Refused>> + Send;
}

/// A line to a GCM that has answered.
pub trait Line: Send {
    /// Sends the GCM what comes from `outgoing`, and returns what comes back.
    ///
    /// # Errors
    /// The GCM is gone, or does not take messages.
    fn attach(
        self,
        outgoing: mpsc::Receiver<v1::AttachRequest>,
    ) -> impl Future<Output = Result<Inbound, Refused>> + Send;

    /// Returns what opens a Feed beside it; `None`: the GCM asks everything over this line.
    fn feeder(&self) -> Option<Feeder> {
        None
    }
}

/// A line over gRPC.
pub(super) struct GrpcLine {
    dialler: Dialler,
    addr: String,
    client: AttachServiceClient<Tokened>,
    each: Duration,
}

fn client(channel: Tokened) -> AttachServiceClient<Tokened> {
    AttachServiceClient::new(channel)
        .max_decoding_message_size(MAX_MESSAGE)
        .max_encoding_message_size(MAX_MESSAGE)
}

/// The way over gRPC.
pub(super) struct Grpc {
    dialler: Dialler,
    /// Each `HOST:PORT`; of several GCMs, the one that leads is looked for.
    addrs: Vec<String>,
    /// Time for each of them to answer.
    each: Duration,
    found: Mutex<Found>,
}

#[derive(Default)]
struct Found {
    /// Address to ask first.
    at: usize,
    /// Greatest term of a GCM that was heard.
    term: u64,
}

impl Grpc {
    /// The way to the GCM at that address, or to the one that leads among several, with commas between them.
    /// `within`: time for all of them to answer.
    pub(super) fn new(addr: &str, dialler: Dialler, within: Duration) -> Grpc {
        let addrs = addresses(addr);
        let each = within / u32::try_from(addrs.len().clamp(1, 3)).unwrap_or(1);
        Grpc { dialler, addrs, each, found: Mutex::default() }
    }
}

impl Way for Grpc {
    type Line = GrpcLine;

    /// A GCM that hung must not find the Hello of every abandoned attempt when it goes on: it is asked first.
    async fn dial(&self) -> Result<Self::Line, Refused> {
        let first = {
            let mut found = self.found.lock();
            // The next attempt begins elsewhere, unless this one ends well.
            let at = found.at % self.addrs.len().max(1);
            found.at = at + 1;
            at
        };
        let order: Vec<String> =
            self.addrs.iter().cycle().skip(first).take(self.addrs.len()).cloned().collect();
        let leader =
            find_leader(&self.dialler, &order, None, self.each).await.map_err(|said| unheard(&said))?;
        let mut found = self.found.lock();
        if self.addrs.len() > 1 && leader.term < found.term {
            let Leader { addr, term, .. } = leader;
            let why = format!("{addr} leads in term {term}, and this process has heard term {}", found.term);
            return Err(Refused::Unheard(why));
        }
        found.term = leader.term;
        found.at = self.addrs.iter().position(|addr| *addr == leader.addr).unwrap_or(first);
        let (dialler, each) = (self.dialler.clone(), self.each);
        Ok(GrpcLine { dialler, addr: leader.addr, client: client(leader.channel), each })
    }
}

fn unheard(said: &[(String, String)]) -> Refused {
    Refused::Unheard(match said {
        [(_, why)] => why.clone(),
        all => {
            let all: Vec<String> = all.iter().map(|(addr, why)| format!("{addr}: {why}")).collect();
            all.join("; ")
        }
    })
}

impl Line for GrpcLine {
    async fn attach(mut self, outgoing: mpsc::Receiver<v1::AttachRequest>) -> Result<Inbound, Refused> {
        let stream = self.client.attach(ReceiverStream::new(outgoing)).await;
        let inbound = stream.map_err(|e| Refused::Unheard(e.message().to_owned()))?;
        Ok(Box::pin(inbound.into_inner()))
    }

    fn feeder(&self) -> Option<Feeder> {
        let (dialler, addr, each) = (self.dialler.clone(), self.addr.clone(), self.each);
        Some(Box::new(move |outgoing| Box::pin(opened(dialler.clone(), addr.clone(), each, outgoing))))
    }
}

async fn opened(
    dialler: Dialler,
    addr: String,
    within: Duration,
    outgoing: FeedOutgoing,
) -> Result<FeedInbound, Refused> {
    let channel = match dialler.dial_pinged(&addr, within).await {
        Ok(channel) => channel,
        Err(e) => return Err(Refused::Unheard(innermost(&*e))),
    };
    match client(channel).feed(ReceiverStream::new(outgoing)).await {
        Ok(stream) => Ok(Box::pin(stream.into_inner())),
        Err(e) => Err(Refused::Unheard(e.message().to_owned())),
    }
}
