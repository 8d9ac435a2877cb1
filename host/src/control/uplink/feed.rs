//! The Feed of a session: questions whose answers may be large or many, beside orders and heartbeats.
//!
//! Invariant: nothing here is an order that changes something, and a Feed that is lost is opened again as
//! long as its session lasts; what was followed over it ends.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt};
use tonic::Status;
use trocar_lcm_api::clock;
use trocar_proto::v1::{self, feed_request};

use super::questions::{MOST, Questions};
use super::session::QUEUE;
use super::way::Refused;
use crate::lcm::Lcm;

/// Pause before a Feed is opened again.
const PAUSE: Duration = Duration::from_millis(200);

/// Messages of a process, in the order in which it sends them.
pub type FeedOutgoing = mpsc::Receiver<v1::FeedRequest>;
/// Messages of a GCM, in the order in which it sent them.
pub type FeedInbound = Pin<Box<dyn Stream<Item = Result<v1::FeedResponse, Status>> + Send>>;
type Opening = Pin<Box<dyn Future<Output = Result<FeedInbound, Refused>> + Send>>;
/// Opens a Feed to the GCM of a line, over a connection of its own.
pub type Feeder = Box<dyn Fn(FeedOutgoing) -> Opening + Send + Sync>;

/// Answers what the GCM asks over a Feed, for ever.
pub(super) async fn feed(feeder: Feeder, hello: v1::FeedHello, lcm: Arc<dyn Lcm>) {
    loop {
        if let Err(refused) = once(&feeder, &hello, &lcm).await {
            log::debug!("no Feed beside the stream to the GCM: {refused:?}");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

async fn once(feeder: &Feeder, hello: &v1::FeedHello, lcm: &Arc<dyn Lcm>) -> Result<(), Refused> {
    let (out, outgoing) = mpsc::channel(QUEUE);
    let first = message(feed_request::Message::Hello(hello.clone()));
    out.send(first).await.map_err(|_| Refused::Unheard("the stream closed at once".into()))?;
    let mut inbound = feeder(outgoing).await?;
    let (answer, mut answers) = mpsc::channel(QUEUE);
    tokio::spawn(async move {
        // Ends with the questions, or with the stream.
        while let Some(answer) = answers.recv().await {
            if out.send(message(feed_request::Message::Answer(answer))).await.is_err() {
                return;
            }
        }
    });
    let mut questions = Questions::new(lcm.clone(), answer);
    while let Some(said) = inbound.next().await {
        let said = said.map_err(|e| Refused::Unheard(e.message().to_owned()))?;
        let Some(v1::Order { id, deadline_ns, order, .. }) = said.order else { continue };
        let deadline = clock::now() + Duration::from_nanos(deadline_ns).min(MOST);
        questions.answer(id, order, deadline).await;
    }
    Ok(())
}

fn message(message: feed_request::Message) -> v1::FeedRequest {
    v1::FeedRequest { message: Some(message) }
}
