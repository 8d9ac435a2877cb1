//! The Feeds of attached processes: each belongs to the session whose number its process names.
//!
//! Invariant: a Feed is taken in only for a process that is attached as that very incarnation, and ends with
//! its session at the latest.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::Status;
use trocar_model::{Name, Refusal};
use trocar_proto::v1::{self, feed_request};

use super::remote::RemoteLcm;
use super::{HELLO, QUEUE};
use crate::control::caller::{Peer, is_process};

/// Orders to a process over its Feed.
pub type FeedOutbound = ReceiverStream<Result<v1::FeedResponse, Status>>;

/// The sessions that may have a Feed.
#[derive(Default)]
pub(super) struct Feeds(Mutex<BTreeMap<Name, Attached>>);

struct Attached {
    instance: u128,
    epoch: u64,
    lcm: Weak<RemoteLcm>,
}

impl Feeds {
    /// Expects the Feed of a process from now on, as long as its session lasts.
    pub(super) fn expect(&self, process: &Name, (instance, epoch): (u128, u64), lcm: &Arc<RemoteLcm>) {
        let mut all = self.0.lock();
        all.retain(|_, expected| expected.lcm.strong_count() > 0);
        all.insert(process.clone(), Attached { instance, epoch, lcm: Arc::downgrade(lcm) });
    }

    fn session(&self, hello: &v1::FeedHello) -> Result<Arc<RemoteLcm>, Refusal> {
        let process = Name::parse(&hello.process)?;
        let all = self.0.lock();
        let expected = all.get(&process).filter(|expected| {
            expected.instance.to_be_bytes() == *hello.instance && expected.epoch == hello.epoch
        });
        expected.and_then(|expected| expected.lcm.upgrade()).ok_or_else(|| Refusal::lost(process))
    }

    /// Takes a Feed in over the messages that its process sends; returns those to it.
    ///
    /// # Errors
    /// Its first message is no hello, is late, or is not of a process that is attached.
    pub(super) async fn hear<I>(
        &self,
        peer: Option<&Peer>,
        mut inbound: I,
        mut open: watch::Receiver<()>,
    ) -> Result<FeedOutbound, Refusal>
    where
        I: Stream<Item = Result<v1::FeedRequest, Status>> + Send + Unpin + 'static,
    {
        let first = tokio::time::timeout(HELLO, inbound.next()).await;
        let Ok(Some(Ok(v1::FeedRequest { message: Some(feed_request::Message::Hello(hello)) }))) = first
        else {
            return Err(Refusal::ArgumentInvalid {
                what: "Feed".into(),
                why: "the first message must be hello, within 2 s".into(),
                field: "hello".into(),
            });
        };
        is_process(peer, "Feed", &hello.process)?;
        let lcm = self.session(&hello)?;
        let (out, orders) = mpsc::channel(QUEUE);
        let number = lcm.feeds_over(out);
        // The session holds the LCM; its Feed does not keep it.
        let (of, over) = (Arc::downgrade(&lcm), lcm.feed_over(number));
        drop(lcm);
        tokio::spawn(async move {
            let mut over = std::pin::pin!(over);
            loop {
                let said = tokio::select! {
                    said = inbound.next() => said,
                    () = &mut over => None,
                    _ = open.changed() => None,
                };
                let (Some(Ok(said)), Some(lcm)) = (said, of.upgrade()) else { break };
                match said.message {
                    Some(feed_request::Message::Answer(answer)) => lcm.answered(answer),
                    Some(feed_request::Message::Hello(_)) | None => {
                        log::warn!(
                            "process {} said over its Feed what this version does not know",
                            hello.process
                        );
                    }
                }
            }
            if let Some(lcm) = of.upgrade() {
                lcm.feed_ended(number);
            }
        });
        Ok(ReceiverStream::new(orders))
    }
}
