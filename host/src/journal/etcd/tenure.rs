//! The time for which a GCM leads: it says again and again that it is there, by a beat in the leader's key.
//!
//! Invariant: the lead is confirmed for less than the lease, counted from before the beat was sent, by this
//! machine's own clock; others count the whole lease from after they saw that beat. A lead that is gone is
//! never taken for a silence.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;
use trocar_lcm_api::clock;

use super::campaign::{Candidate, Won};
use super::client::Client;
use super::place::EtcdPlace;
use crate::gcm::Lead;

/// Beats for each lease.
const BEATS: u32 = 3;
/// The lead ends this part of the lease before the lease.
const MARGIN: u32 = 5;
/// Pause after etcd was asked in vain.
const AGAIN: Duration = Duration::from_millis(100);
/// Time for which etcd keeps the revisions that beats leave behind.
const KEPT: Duration = Duration::from_secs(3600);
/// Time for etcd to forget older ones.
const FORGETTING: Duration = Duration::from_secs(10);

/// A lead that is kept.
pub struct Tenure {
    lead: Lead,
    won: Won,
    candidate: Arc<Candidate>,
    beats: JoinHandle<()>,
}

impl Tenure {
    /// Keeps the lead that was won, in the background.
    pub fn begin(candidate: &Arc<Candidate>, won: &Won) -> Tenure {
        let lead = Lead::new(won.term, won.sent + led(won.ttl));
        let beats = tokio::spawn(keep(candidate.clone(), won.clone(), lead.clone()));
        Tenure { lead, won: won.clone(), candidate: candidate.clone(), beats }
    }

    /// Returns a client of its own for the journal at that place.
    pub(super) fn client(&self, place: &EtcdPlace) -> Client {
        self.candidate.client.beside(place)
    }

    /// Returns the right to decide.
    pub fn lead(&self) -> &Lead {
        &self.lead
    }

    /// Lets go of the lead, so that another GCM need not wait for its lease.
    pub async fn resign(self) {
        self.lead.lose("this GCM ends");
        self.beats.abort();
        if let Err(bad) = self.candidate.resign(&self.won).await {
            log::warn!("the lead ends by itself, since etcd was not told: {}", bad.why);
        }
    }
}

impl Drop for Tenure {
    fn drop(&mut self) {
        self.beats.abort();
    }
}

fn led(ttl: Duration) -> Duration {
    ttl - ttl / MARGIN
}

async fn keep(candidate: Arc<Candidate>, won: Won, lead: Lead) {
    let (beat, mut history) = (won.ttl / BEATS, History { since: clock::now(), revision: won.at });
    loop {
        let sent = clock::now();
        match candidate.beat(&won, beat).await {
            Ok(Ok(revision)) => {
                lead.confirm(sent + led(won.ttl));
                history.beat(&candidate, revision);
                tokio::time::sleep(beat.saturating_sub(clock::since(sent))).await;
            }
            Ok(Err(why)) => return lead.lose(why),
            Err(bad) => {
                lead.doubt(&bad.why);
                tokio::time::sleep(AGAIN).await;
            }
        }
    }
}

/// Revisions that beats have left behind. Each beat is one, and etcd keeps all until it is told otherwise, so
/// that its database would be full after some weeks.
struct History {
    since: Instant,
    revision: i64,
}

impl History {
    fn beat(&mut self, candidate: &Arc<Candidate>, revision: i64) {
        if clock::since(self.since) < KEPT {
            return;
        }
        let (candidate, old) = (candidate.clone(), self.revision);
        *self = History { since: clock::now(), revision };
        // No beat waits for it.
        tokio::spawn(async move {
            if let Err(bad) = candidate.client.compact(old, FORGETTING).await {
                log::warn!("etcd does not forget what is an hour old: {}", bad.why);
            }
        });
    }
}
