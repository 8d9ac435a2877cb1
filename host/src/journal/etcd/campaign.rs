//! The campaign of one GCM among several for the lead of their system.
//!
//! Invariant: the leader's key is made only where there is none, together with a term that no GCM had before;
//! it goes with the lease of its GCM.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use trocar_lcm_api::clock;
use trocar_proto::etcd::KeyValue;

use super::client::{Client, changed_at, get, made_at, put, txn};
use super::keys::Keys;
use super::place::EtcdPlace;
use crate::gcm::{StoreError, Unusable};
use crate::journal::fault::{Bad, Res};

/// Time for a call of the campaign.
const WITHIN: Duration = Duration::from_secs(1);

/// A GCM that leads when nobody else does.
pub struct Candidate {
    place: EtcdPlace,
    pub(super) client: Client,
    keys: Keys,
    /// Address at which others reach it.
    address: String,
    /// Time for which it leads when it is not heard.
    ttl: Duration,
}

/// The GCM that leads, as its key says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leader {
    /// Address at which it is reached.
    pub address: String,
    pub term: u64,
}

/// Outcome of a campaign.
#[derive(Debug)]
pub enum Campaign {
    Won(Won),
    /// Another leads.
    Follows(Leader),
}

/// A lead that was won.
#[derive(Clone, Debug)]
pub struct Won {
    /// No other GCM of this system has it.
    pub term: u64,
    /// Revision at which the leader's key was made.
    pub(super) key: i64,
    pub(super) lease: i64,
    /// Time for which the lease lasts, from `sent` on.
    pub(super) ttl: Duration,
    pub(super) sent: Instant,
}

impl Candidate {
    /// A candidate that others reach at `address`. It leads for `ttl` after it was heard last: whole seconds;
    /// etcd has a least one, 2 s by default.
    pub fn new(place: &EtcdPlace, address: String, ttl: Duration) -> Candidate {
        let (client, keys) = (Client::new(place), Keys::new(place.prefix()));
        Candidate { place: place.clone(), client, keys, address, ttl }
    }

    /// Returns the place of the journal that it campaigns for.
    pub fn place(&self) -> &EtcdPlace {
        &self.place
    }

    /// Returns where others reach it.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Takes the lead if nobody has it.
    ///
    /// # Errors
    /// etcd does not answer, or what lies there is not of a journal.
    pub async fn campaign(&self) -> Result<Campaign, StoreError> {
        self.campaigned().await.map_err(|bad| bad.of(self.place.to_string().as_ref()).error)
    }

    async fn campaigned(&self) -> Res<Campaign> {
        let asked = vec![get(self.keys.leader()), get(self.keys.term())];
        let mut found = self.client.txn(txn(Vec::new(), asked, Vec::new()), WITHIN).await?.ranges.into_iter();
        let mut next = || found.next().and_then(|kvs| kvs.into_iter().next());
        let (leader, last) = (next(), next());
        if let Some(leader) = leader {
            return Ok(Campaign::Follows(read(&leader)?));
        }
        let (last, at) = match &last {
            Some(last) => (term_in(last)?, last.mod_revision),
            None => (0, 0),
        };
        let term = last + 1;
        let sent = clock::now();
        let (lease, ttl) = self.client.grant(self.ttl, WITHIN).await?;
        let leader = Leader { address: self.address.clone(), term };
        let leader = serde_json::to_vec(&leader).map_err(|e| Bad::now(e.to_string()))?;
        let compare = vec![made_at(self.keys.leader(), 0), changed_at(self.keys.term(), at)];
        let puts = vec![
            put(self.keys.leader(), leader, lease),
            put(self.keys.term(), term.to_string().into_bytes(), 0),
        ];
        let done = self.client.txn(txn(compare, puts, vec![get(self.keys.leader())]), WITHIN).await?;
        let won = |key| Ok(Campaign::Won(Won { term, key, lease, ttl, sent }));
        if done.succeeded {
            return won(done.revision);
        }
        let leader = done.ranges.into_iter().flatten().next();
        match leader {
            // The answer to the first attempt was lost.
            Some(leader) if leader.lease == lease => won(leader.create_revision),
            leader => {
                // It ends by itself, too.
                let _ = self.client.revoke(lease, WITHIN).await;
                let other = leader.ok_or_else(|| Bad::now("another GCM led for a moment"))?;
                Ok(Campaign::Follows(read(&other)?))
            }
        }
    }

    /// Lets go of the lead, so that another may have it at once.
    pub(super) async fn resign(&self, lease: i64) -> Result<(), Bad> {
        self.client.revoke(lease, WITHIN).await
    }
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
