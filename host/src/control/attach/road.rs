//! The two streams of an attached process: orders and news go over Attach, what may be large or much over the
//! Feed beside it.
//!
//! Invariant: a heartbeat or an order never waits behind what is followed, or read. What was asked over a
//! Feed that ends is answered at its end.

use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};
use tonic::Status;
use trocar_lcm_api::clock;
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
    now: watch::Sender<Stands>,
}

#[derive(Debug)]
struct Stands {
    /// Until when one is waited for, if it is to come; `None`: the process opens none, or is gone.
    awaited: Option<Instant>,
    feed: Option<(u64, FeedOutgoing)>,
    /// Number of the last one.
    last: u64,
}

impl Beside {
    /// `is_expected`: the process has said that it opens one.
    pub(super) fn new(is_expected: bool) -> Beside {
        let awaited = is_expected.then(|| clock::now() + OPENS);
        Beside { now: watch::Sender::new(Stands { awaited, feed: None, last: 0 }) }
    }

    /// Takes a Feed in; returns its number, and that of the one in whose place it is.
    pub(super) fn open(&self, out: FeedOutgoing) -> (u64, Option<u64>) {
        let mut numbers = (0, None);
        self.now.send_modify(|now| {
            now.last += 1;
            numbers = (now.last, now.feed.take().map(|(before, _)| before));
            now.feed = Some((now.last, out));
        });
        numbers
    }

    /// Forgets the Feed of this number: another one is to come.
    pub(super) fn close(&self, number: u64) {
        self.now.send_if_modified(|now| {
            let is_it = now.feed.as_ref().is_some_and(|(mine, _)| *mine == number);
            if is_it {
                now.feed = None;
                now.awaited = now.awaited.map(|_| clock::now() + OPENS);
            }
            is_it
        });
    }

    /// None comes any more.
    pub(super) fn end(&self) {
        self.now.send_modify(|now| (now.awaited, now.feed) = (None, None));
    }

    /// Until the Feed of this number is not the one any more.
    pub(super) fn over(&self, number: u64) -> impl Future<Output = ()> + Send + use<> {
        let mut now = self.now.subscribe();
        async move {
            let is_other = |now: &Stands| now.feed.as_ref().is_none_or(|(mine, _)| *mine != number);
            // A sender that is gone says the same.
            let _ = now.wait_for(is_other).await;
        }
    }

    /// Returns the Feed, which may be about to be opened; `None`: the process has none in time, and is asked
    /// over Attach.
    pub(super) async fn road(&self, deadline: Instant) -> Option<Road> {
        let mut now = self.now.subscribe();
        let awaited = {
            let now = now.borrow();
            if let Some((number, out)) = &now.feed {
                return Some(Road::Feed(*number, out.clone()));
            }
            // Half of the time is left for the question itself.
            let half = clock::now() + deadline.saturating_duration_since(clock::now()) / 2;
            now.awaited?.min(half)
        };
        let comes = now.wait_for(|now| now.feed.is_some() || now.awaited.is_none());
        let opened = tokio::time::timeout_at(awaited.into(), comes).await.ok()?.ok()?;
        opened.feed.as_ref().map(|(number, out)| Road::Feed(*number, out.clone()))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn number(road: Option<Road>) -> Option<u64> {
        match road {
            Some(Road::Feed(number, _)) => Some(number),
            _ => None,
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_feed_that_does_not_come_is_waited_for_once_and_never_past_half_of_the_question() {
        let beside = Beside::new(true);
        let began = tokio::time::Instant::now();
        let soon = |ms| clock::now() + Duration::from_millis(ms);
        assert_eq!(number(beside.road(soon(200)).await), None);
        assert_eq!(began.elapsed().as_millis(), 100);
        assert_eq!(number(beside.road(soon(60_000)).await), None);
        assert_eq!(began.elapsed(), OPENS, "until the one second after its registration");
        assert_eq!(number(beside.road(soon(60_000)).await), None);
        assert_eq!(began.elapsed(), OPENS, "and not again");
        assert_eq!(number(Beside::new(false).road(soon(60_000)).await), None);
        assert_eq!(began.elapsed(), OPENS, "of one that opens none");
    }

    #[tokio::test(start_paused = true)]
    async fn numbers_are_not_given_again_and_a_feed_that_is_replaced_is_over() {
        let beside = Beside::new(true);
        let feed = || mpsc::channel(1).0;
        assert_eq!(beside.open(feed()), (1, None));
        assert_eq!(beside.open(feed()), (2, Some(1)));
        beside.over(1).await;
        beside.close(1);
        assert_eq!(
            number(beside.road(clock::now() + OPENS).await),
            Some(2),
            "the end of the one before is no end of it"
        );
        beside.close(2);
        beside.over(2).await;
        assert_eq!(beside.open(feed()), (3, None));
        beside.end();
        beside.over(3).await;
        assert_eq!(number(beside.road(clock::now() + OPENS).await), None);
    }
}
