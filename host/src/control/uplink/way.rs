//! The way of a process to its GCM: what carries the messages of both.
//!
//! Invariant: a line ends when either side lets go of it, and carries the messages of each side in their
//! order.

use std::error::Error;
use std::pin::Pin;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use trocar_model::Refusal;
use trocar_proto::v1;
use trocar_proto::v1::attach_service_client::AttachServiceClient;

use crate::control::attach::MAX_MESSAGE;
use crate::control::caller::Tokened;
use crate::control::dial::dial;

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
}

/// The way over gRPC.
pub(super) struct Grpc {
    /// `HOST:PORT`, with or without `http://`.
    pub(super) addr: String,
    /// Time for the GCM to answer.
    pub(super) within: Duration,
}

impl Way for Grpc {
    type Line = AttachServiceClient<Tokened>;

    /// A GCM that hung must not find the Hello of every abandoned attempt when it goes on: it is asked first.
    async fn dial(&self) -> Result<Self::Line, Refused> {
        let uri = format!("http://{}", self.addr.trim_start_matches("http://"));
        let channel = dial(&uri, None, self.within).await.map_err(|e| Refused::Unheard(because(&e)))?;
        let mut client = AttachServiceClient::new(channel)
            .max_decoding_message_size(MAX_MESSAGE)
            .max_encoding_message_size(MAX_MESSAGE);
        let nothing = v1::TellRequest::default();
        client.tell(nothing).await.map_err(|e| Refused::Unheard(e.message().to_owned()))?;
        Ok(client)
    }
}

impl Line for AttachServiceClient<Tokened> {
    async fn attach(mut self, outgoing: mpsc::Receiver<v1::AttachRequest>) -> Result<Inbound, Refused> {
        let stream = AttachServiceClient::attach(&mut self, ReceiverStream::new(outgoing)).await;
        let inbound = stream.map_err(|e| Refused::Unheard(e.message().to_owned()))?;
        Ok(Box::pin(inbound.into_inner()))
    }
}

/// The innermost cause: the outer ones say "transport error".
fn because(e: &(dyn Error + 'static)) -> String {
    let mut inner = e;
    while let Some(source) = inner.source() {
        inner = source;
    }
    inner.to_string()
}
