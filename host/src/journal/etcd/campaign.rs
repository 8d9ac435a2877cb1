//! The campaign of one GCM among several for the lead of their system.
//!
//! Invariant: each lead has a term that no GCM had before. It begins only where the leader's key is gone, or
//! has not changed for its whole lease by this machine's own clock; a beat in between keeps that leader.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use trocar_lcm_api::clock;
use trocar_proto::etcd::KeyValue;

use super::client::{Client, changed_at, delete, get, put, txn};
use super::keys::{Keys, Span};
use super::place::EtcdPlace;
use crate::gcm::{StoreError, Unusable};
use crate::journal::fault::{Bad, Res};
use crate::journal::frame::random;

/// Time for a call of the campaign.
const WITHIN: Duration = Duration::from_secs(1);
/// Shortest and longest lease.
const LEASES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(60));

/// A GCM that leads when nobody else does.
pub struct Candidate {
    place: EtcdPlace,
    pub(super) client: Client,
    keys: Keys,
    /// Tells it from every other GCM, also from one at the same address.
    id: String,
    /// Address at which others reach it.
    address: String,
    /// Time for which it leads when it is not heard.
    ttl: Duration,
    seen: Mutex<Option<Seen>>,
    /// The last term that it has read there.
    term: AtomicU64,
}

/// A leader's key, as this GCM saw it last.
struct Seen {
    candidate: String,
    /// Revision of its last change.
    at: i64,
    /// Time at which that was seen first.
    since: Instant,
    /// True: it has changed meanwhile.
    beats: bool,
}

/// The GCM that leads, as its key says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leader {
    /// Tells it from every other GCM.
    candidate: String,
    /// Address at which it is reached.
    pub address: String,
    pub term: u64,
    /// Time for which it leads when it is not heard, ms.
    lease_ms: u64,
}

/// Outcome of a campaign.
#[derive(Debug)]
pub enum Campaign {
    Won(Won),
    /// Another leads. `beats`: its key has changed while this one looked.
    Follows {
        leader: Leader,
        beats: bool,
    },
}

/// A lead that was won.
#[derive(Clone, Debug)]
pub struct Won {
    /// No other GCM of this system has it.
    pub term: u64,
    /// Revision at which the term was counted: it stays as long as this GCM leads.
    pub(super) at: i64,
    /// Time for which it leads from `sent` on.
    pub(super) ttl: Duration,
    pub(super) sent: Instant,
}

impl Candidate {
    /// A candidate that others reach at `address`. It leads for `ttl` after it was heard last, 0.5 to 60 s.
    ///
    /// # Errors
    /// The machine gives no random numbers.
    pub fn new(place: &EtcdPlace, address: String, ttl: Duration) -> Result<Candidate, StoreError> {
        let (client, keys) = (Client::new(place), Keys::new(place.prefix()));
        let id = random().map_err(|bad| bad.of(place.to_string().as_ref()).error)?;
        let (id, seen, term) = (format!("{id:032x}"), Mutex::default(), AtomicU64::new(0));
        let ttl = ttl.clamp(LEASES.0, LEASES.1);
        Ok(Candidate { place: place.clone(), client, keys, id, address, ttl, seen, term })
    }

    /// Returns the place of the journal that it campaigns for.
    pub fn place(&self) -> &EtcdPlace {
        &self.place
    }

    /// Returns where others reach it.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Takes the lead if nobody has it, or if whoever has it was not heard for its lease.
    ///
    /// # Errors
    /// etcd does not answer, or what lies there is not of a journal.
    pub async fn campaign(&self) -> Result<Campaign, StoreError> {
        self.campaigned().await.map_err(|bad| bad.of(self.place.to_string().as_ref()).error)
    }

    async fn campaigned(&self) -> Res<Campaign> {
        // Before all: an attempt of before may be done after this read, and begin the lead.
        let sent = clock::now();
        let both = || vec![get(self.keys.leader()), get(self.keys.term())];
        let (leader, last) = pair(self.client.txn(txn(Vec::new(), both(), Vec::new()), WITHIN).await?.ranges);
        let (last, counted) = match &last {
            Some(last) => (term_in(last)?, last.mod_revision),
            None => (0, 0),
        };
        let seen = self.term.fetch_max(last, Ordering::Relaxed);
        if last < seen {
            return Err(Bad::damaged(format!(
                "it was emptied, or put back from a copy: its term is {last}, and this GCM has seen {seen} there; \
                 give it back what it had, or start this GCM again to lead what is there now"
            )));
        }
        if let Some(found) = &leader {
            let leader = read(found)?;
            if let Some(beats) = self.hears(&leader, found.mod_revision) {
                return Ok(Campaign::Follows { leader, beats });
            }
        }
        let term = last + 1;
        let found = leader.map_or(0, |leader| leader.mod_revision);
        let compare = vec![changed_at(self.keys.leader(), found), changed_at(self.keys.term(), counted)];
        let puts = vec![self.mark(term)?, put(self.keys.term(), term.to_string().into_bytes())];
        let done = self.client.txn(txn(compare, puts, both()), WITHIN).await?;
        let won = |at| Ok(Campaign::Won(Won { term, at, ttl: self.ttl, sent }));
        if done.succeeded {
            if let Some(silent) = self.seen.lock().take().filter(|silent| silent.at == found) {
                log::info!("the GCM that led before was not heard since revision {} of etcd", silent.at);
            }
            return won(done.revision);
        }
        let (leader, last) = pair(done.ranges);
        let leader = leader.ok_or_else(|| Bad::now("another GCM led for a moment"))?;
        let (other, at) = (read(&leader)?, last.map_or(0, |last| last.mod_revision));
        // The answer to the first attempt was lost.
        if other.candidate == self.id && other.term == term {
            return won(at);
        }
        let beats = self.hears(&other, leader.mod_revision).unwrap_or_default();
        Ok(Campaign::Follows { leader: other, beats })
    }

    /// Tells whether a leader still leads whose key was changed last at that revision; if so, whether it has
    /// changed since it was seen first.
    fn hears(&self, leader: &Leader, at: i64) -> Option<bool> {
        // An attempt of its own was done after it was given up: it does not reign while it campaigns.
        if leader.candidate == self.id {
            return None;
        }
        let mut seen = self.seen.lock();
        let (now, before) = (clock::now(), seen.as_ref());
        let lease = Duration::from_millis(leader.lease_ms).min(LEASES.1);
        match before.filter(|seen| seen.candidate == leader.candidate) {
            Some(seen) if seen.at == at => {
                (now.saturating_duration_since(seen.since) < lease).then_some(seen.beats)
            }
            before => {
                let beats = before.is_some();
                let candidate = leader.candidate.clone();
                *seen = Some(Seen { candidate, at, since: now, beats });
                Some(beats)
            }
        }
    }

    /// Says that it leads in that term.
    fn mark(&self, term: u64) -> Res<super::writing::Operation> {
        let lease_ms = u64::try_from(self.ttl.as_millis()).unwrap_or(u64::MAX);
        let leader = Leader { candidate: self.id.clone(), address: self.address.clone(), term, lease_ms };
        let leader = serde_json::to_vec(&leader).map_err(|e| Bad::now(e.to_string()))?;
        Ok(put(self.keys.leader(), leader))
    }

    /// Says that it is there. Returns the revision of that, or why it leads no more.
    pub(super) async fn beat(&self, won: &Won, within: Duration) -> Res<Result<i64, &'static str>> {
        let compare = vec![changed_at(self.keys.term(), won.at)];
        let found = vec![get(self.keys.term())];
        let done = self.client.txn(txn(compare, vec![self.mark(won.term)?], found), within).await?;
        self.term.fetch_max(won.term, Ordering::Relaxed);
        let is_there = done.ranges.iter().any(|found| !found.is_empty());
        Ok(match (done.succeeded, is_there) {
            (true, _) => Ok(done.revision),
            (false, true) => Err("another GCM has taken it, since this one was not heard for its lease"),
            (false, false) => Err("its keys in etcd are gone"),
        })
    }

    /// Lets go of the lead, so that another may have it at once. A beat that is still on its way comes too
    /// late, since the term is written anew.
    pub(super) async fn resign(&self, won: &Won) -> Res<()> {
        let compare = vec![changed_at(self.keys.term(), won.at)];
        let gone = delete(Span(self.keys.leader(), Vec::new()));
        let same = put(self.keys.term(), won.term.to_string().into_bytes());
        self.client.txn(txn(compare, vec![gone, same], Vec::new()), WITHIN).await.map(|_| ())
    }
}

/// The first key of the first two findings.
fn pair(found: Vec<Vec<KeyValue>>) -> (Option<KeyValue>, Option<KeyValue>) {
    let mut found = found.into_iter().map(|kvs| kvs.into_iter().next());
    let mut next = || found.next().flatten();
    (next(), next())
}

fn read(leader: &KeyValue) -> Res<Leader> {
    serde_json::from_slice(&leader.value)
        .map_err(|e| Bad::new(Unusable::Damaged, format!("the key of the leader is not one of a GCM: {e}")))
}

fn term_in(kv: &KeyValue) -> Res<u64> {
    let text = std::str::from_utf8(&kv.value).ok();
    let term = text.and_then(|text| text.parse().ok()).filter(|term| *term < u64::MAX);
    term.ok_or_else(|| Bad::damaged("the key of the term is not a number"))
}
