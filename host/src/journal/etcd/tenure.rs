//! The time for which a GCM leads: its lease is kept alive, and its lead ends before the lease does.
//!
//! Invariant: the lead is confirmed for a moment that lies before the end of the lease, counted from before
//! etcd was asked, by this machine's own clock. A lease that is gone is never taken for a silence.

use std::sync::Arc;
use std::time::Duration;

use tokio::task::JoinHandle;
use trocar_lcm_api::clock;

use super::campaign::{Candidate, Won};
use crate::gcm::Lead;

/// A lease is kept alive so many times while it lasts.
const BEATS: u32 = 3;
/// The lead ends this part of the lease before the lease.
const MARGIN: u32 = 5;
/// Pause after etcd was asked in vain.
const AGAIN: Duration = Duration::from_millis(100);

/// A lead and its lease.
pub struct Tenure {
    lead: Lead,
    lease: i64,
    candidate: Arc<Candidate>,
    beats: JoinHandle<()>,
}

impl Tenure {
    /// Keeps the lead that was won, in the background.
    pub fn begin(candidate: &Arc<Candidate>, won: &Won) -> Tenure {
        let lead = Lead::new(won.term, won.sent + led(won.ttl));
        let beats = tokio::spawn(keep(candidate.clone(), won.clone(), lead.clone()));
        Tenure { lead, lease: won.lease, candidate: candidate.clone(), beats }
    }

    /// Returns the right to decide.
    pub fn lead(&self) -> &Lead {
        &self.lead
    }

    /// Lets go of the lead, so that another GCM need not wait for the end of the lease.
    pub async fn resign(self) {
        self.lead.lose("this GCM ends");
        self.beats.abort();
        if let Err(bad) = self.candidate.resign(self.lease).await {
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
    let beat = won.ttl / BEATS;
    loop {
        let sent = clock::now();
        match candidate.client.keep_alive(won.lease, beat).await {
            Ok(Duration::ZERO) => return lead.lose("etcd has ended its lease"),
            Ok(ttl) => {
                lead.confirm(sent + led(ttl));
                tokio::time::sleep(beat.saturating_sub(clock::since(sent))).await;
            }
            Err(bad) => {
                lead.doubt(&bad.why);
                tokio::time::sleep(AGAIN).await;
            }
        }
    }
}
