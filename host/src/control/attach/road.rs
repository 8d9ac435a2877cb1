//! The two streams of an attached process: orders and news go over Attach, what may be large or much over the
//! Feed beside it.
//!
//! Invariant: a heartbeat or an order never waits behind a picture. What was asked over a Feed that ends is
//! answered at its end.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tonic::Status;
use trocar_proto::v1::{self, attach_response};

use super::remote::{Outgoing, message};

/// Time for a process to open its Feed after it was registered. One that does not gets its questions over
/// Attach.
const OPENS: Duration = Duration::from_secs(1);

/// Orders to a process over its Feed.
pub(super) type FeedOutgoing = mpsc::Sender<Result<v1::FeedResponse, Status>>;

/// The stream by which an order goes, and its answer comes.
#[derive(Clone)]
pub(super) enum Road {
    Attach(Outgoing),
    /// The Feed of this number.
    Feed(u64, FeedOutgoing),
}

impl Road {
    /// Sends an order; false: the stream is gone.
    pub(super) async fn send(&self, order: v1::Order) -> bool {
        match self {
            Road::Attach(out) => {
                let order = attach_response::Message::Order(order);
                out.send(Ok(message(order))).await.is_ok()
            }
            Road::Feed(_, out) => out.send(Ok(v1::FeedResponse { order: Some(order) })).await.is_ok(),
        }
    }

    pub(super) fn is_feed(&self, number: u64) -> bool {
        matches!(self, Road::Feed(mine, _) if *mine == number)
    }
}

/// The Feed of a process.
#[derive(Debug)]
pub(super) struct Beside {
    /// The process has said that it opens one.
    is_expected: bool,
    now: watch::Sender<Option<(u64, FeedOutgoing)>>,
}

impl Beside {
    pub(super) fn new(is_expected: bool) -> Beside {
        Beside { is_expected, now: watch::Sender::new(None) }
    }

    /// Takes a Feed in, in place of an earlier one, which ends; returns its number.
    pub(super) fn open(&self, out: FeedOutgoing) -> u64 {
        let mut number = 0;
        self.now.send_modify(|now| {
            number = now.as_ref().map_or(0, |(number, _)| *number) + 1;
            *now = Some((number, out));
        });
        number
    }

    /// Forgets the Feed of this number.
    pub(super) fn close(&self, number: u64) {
        self.now.send_if_modified(|now| {
            let is_it = now.as_ref().is_some_and(|(mine, _)| *mine == number);
            if is_it {
                *now = None;
            }
            is_it
        });
    }

    /// Returns the Feed, which may be about to be opened; `None`: the process has none.
    pub(super) async fn road(&self) -> Option<Road> {
        if !self.is_expected {
            return None;
        }
        let mut now = self.now.subscribe();
        let opened = tokio::time::timeout(OPENS, now.wait_for(Option::is_some)).await.ok()?.ok()?;
        opened.clone().map(|(number, out)| Road::Feed(number, out))
    }
}
