//! The ground of an order of the GCM: its deadline, its place among all decisions, its session.
//!
//! Invariant: a Stop wins over every Start that was decided before it, wherever either is when they meet.

use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::clock;

/// Place of a decision among those of all GCMs that a process has had: a later one is greater.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Decision(pub u64);

impl Decision {
    /// Nobody's: every Stop is later.
    pub const NONE: Decision = Decision(0);
    /// That of a Stop at the process itself. It is later than all that the GCM has decided without knowing of
    /// it.
    pub const HERE: Decision = Decision(u64::MAX);
    /// The greatest that a GCM gives.
    pub const MOST: Decision = Decision(1 << 62);

    /// Returns the one before the first of a GCM of that term. It is later than all of the GCMs before, also
    /// than those that were never on record.
    pub fn before(term: u64) -> Decision {
        Decision(term.saturating_mul(1 << 30)).min(Decision::MOST)
    }
}

/// The ground of an order.
#[derive(Clone, Debug)]
pub struct Order {
    /// End of the orderer's patience: a change that is not done by then is not done at all.
    pub deadline: Instant,
    pub decision: Decision,
    pub lease: Lease,
}

/// An order that sets nothing in motion, or that no Stop can meet.
impl From<Instant> for Order {
    fn from(deadline: Instant) -> Order {
        Order { deadline, decision: Decision::NONE, lease: Lease::default() }
    }
}

/// Tells whether the orderer is still there. When it is gone, orders that are not done yet are taken back, as
/// at the end of its patience.
#[derive(Clone, Debug, Default)]
pub struct Lease {
    /// When it was heard last, and after which time it is gone; `None`: it is in this process.
    heard: Option<(watch::Receiver<Instant>, Duration)>,
}

impl Lease {
    /// A lease that ends when the sender is dropped, or `silence` after the last time it has sent.
    pub fn new(heard: watch::Receiver<Instant>, silence: Duration) -> Lease {
        Lease { heard: Some((heard, silence)) }
    }

    /// Tells whether the orderer is gone now. A process that stood still finds this out by the clock before
    /// anything else can tell it.
    pub fn has_ended(&self) -> bool {
        self.heard.as_ref().is_some_and(|(heard, silence)| {
            heard.has_changed().is_err() || clock::since(*heard.borrow()) > *silence
        })
    }

    /// Tells whether its end was told, whatever the clock says.
    pub fn is_over(&self) -> bool {
        self.heard.as_ref().is_some_and(|(heard, _)| heard.has_changed().is_err())
    }

    /// Waits until its end is told.
    pub async fn ended(&self) {
        match self.heard.clone() {
            None => std::future::pending().await,
            Some((mut heard, _)) => while heard.changed().await.is_ok() {},
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_lease_ends_with_its_sender_or_with_its_silence() {
        let (heard, lease) = watch::channel(Instant::now());
        let lease = Lease::new(lease, Duration::from_secs(3600));
        assert!(!lease.has_ended());
        drop(heard);
        assert!(lease.has_ended(), "its session is over");
        let long_ago = Instant::now() - Duration::from_secs(2);
        let (_heard, lease) = watch::channel(long_ago);
        assert!(Lease::new(lease, Duration::from_secs(1)).has_ended(), "the process stood still");
        assert!(!Lease::default().has_ended(), "the orderer is in this process");
    }
}
