//! Calls of etcd: each with a deadline, at the next member where one does not answer.
//!
//! Invariant: a call that got no answer may have been done, or may yet be: whoever writes compares what was
//! found, so that a call that is done late, or twice, changes nothing.

use std::time::Duration;

use parking_lot::Mutex;
use tokio::time::Instant;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Request, Response, Status};
use trocar_proto::etcd;
use trocar_proto::etcd::compare::{CompareResult, CompareTarget, TargetUnion};
use trocar_proto::etcd::kv_client::KvClient;
use trocar_proto::etcd::request_op::Request as Op;
use trocar_proto::etcd::response_op::Response as Answer;

use super::keys::Span;
use super::place::EtcdPlace;
use crate::journal::fault::{Bad, Res};

/// Time for one member to answer, before another is asked.
const ATTEMPT: Duration = Duration::from_millis(500);
/// Pause before the same members are asked once more.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest answer that is read, bytes.
const MAX_ANSWER: usize = 64 << 20;

/// A client of one cluster.
pub(super) struct Client {
    members: Vec<String>,
    ways: Mutex<Ways>,
}

struct Ways {
    /// Member that answered last.
    at: usize,
    /// One for each member that was asked.
    channels: Vec<Option<Channel>>,
}

impl Client {
    pub(super) fn new(place: &EtcdPlace) -> Client {
        let members = place.endpoints().to_vec();
        let ways = Mutex::new(Ways { at: 0, channels: vec![None; members.len()] });
        Client { members, ways }
    }

    /// A client for another runtime: in the same cluster it begins with the member that answered last.
    pub(super) fn beside(&self, place: &EtcdPlace) -> Client {
        let client = Client::new(place);
        if client.members == self.members {
            client.ways.lock().at = self.ways.lock().at;
        }
        client
    }

    /// Returns the member to ask, and the way to it.
    fn way(&self) -> Res<(usize, Channel)> {
        let mut ways = self.ways.lock();
        let at = ways.at;
        if let Some(channel) = &ways.channels[at] {
            return Ok((at, channel.clone()));
        }
        let endpoint = Endpoint::from_shared(format!("http://{}", self.members[at]))
            .map_err(|e| Bad::now(format!("{} is not an address: {e}", self.members[at])))?;
        let channel = endpoint.connect_timeout(ATTEMPT).tcp_nodelay(true).connect_lazy();
        ways.channels[at] = Some(channel.clone());
        Ok((at, channel))
    }

    /// The next member is asked from now on, unless another caller has gone on already.
    fn go_on_from(&self, at: usize) {
        let mut ways = self.ways.lock();
        if ways.at == at {
            ways.at = (at + 1) % self.members.len();
        }
    }

    /// Calls, until `within` has passed. A member is asked at least once.
    async fn call<T, F>(&self, within: Duration, call: impl Fn(Channel) -> F) -> Res<T>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let until = Instant::now() + within;
        let mut asked = 0;
        loop {
            let (at, channel) = self.way()?;
            let left = until.saturating_duration_since(Instant::now());
            let refused = match tokio::time::timeout(ATTEMPT.min(left), call(channel)).await {
                Ok(Ok(answer)) => return Ok(answer.into_inner()),
                Ok(Err(refused)) if !may_pass(&refused) => return Err(said(&refused)),
                Ok(Err(refused)) => refused.message().to_owned(),
                Err(_) => "no answer".to_owned(),
            };
            self.go_on_from(at);
            asked += 1;
            let pause = if asked % self.members.len() == 0 { PAUSE } else { Duration::ZERO };
            if Instant::now() + pause >= until {
                return Err(self.silent(within, &self.members[at], &refused));
            }
            tokio::time::sleep(pause).await;
        }
    }

    fn silent(&self, within: Duration, member: &str, why: &str) -> Bad {
        Bad::now(format!(
            "etcd gave no answer within {} ms (members {}; last asked {member}: {why}): see that more than half \
             of its members run and reach each other (`etcdctl endpoint health`)",
            within.as_millis(),
            self.members.join(", ")
        ))
    }

    /// Does a transaction.
    pub(super) async fn txn(&self, txn: etcd::TxnRequest, within: Duration) -> Res<Done> {
        let done = self
            .call(within, |channel| {
                let (mut kv, txn) =
                    (KvClient::new(channel).max_decoding_message_size(MAX_ANSWER), txn.clone());
                async move { kv.txn(Request::new(txn)).await }
            })
            .await?;
        let revision = done.header.map_or(0, |header| header.revision);
        let ranges = done.responses.into_iter().filter_map(|one| match one.response {
            Some(Answer::ResponseRange(range)) => Some(range.kvs),
            _ => None,
        });
        Ok(Done { succeeded: done.succeeded, revision, ranges: ranges.collect() })
    }

    /// Reads keys at a revision; 0: the newest. Returns them, and whether there are more.
    pub(super) async fn range(
        &self,
        range: etcd::RangeRequest,
        within: Duration,
    ) -> Res<(Vec<etcd::KeyValue>, bool)> {
        let read = self
            .call(within, |channel| {
                let mut kv = KvClient::new(channel).max_decoding_message_size(MAX_ANSWER);
                let range = range.clone();
                async move { kv.range(Request::new(range)).await }
            })
            .await?;
        Ok((read.kvs, read.more))
    }

    /// Has revisions before that one forgotten; one of them may be already.
    pub(super) async fn compact(&self, revision: i64, within: Duration) -> Res<()> {
        self.call(within, |channel| {
            let mut kv = KvClient::new(channel);
            async move {
                match kv.compact(etcd::CompactionRequest { revision }).await {
                    Err(done) if done.code() == Code::OutOfRange => Ok(Response::new(Default::default())),
                    other => other,
                }
            }
        })
        .await
        .map(|_| ())
    }
}

/// A transaction that was done.
pub(super) struct Done {
    pub(super) succeeded: bool,
    /// Revision that it led to.
    pub(super) revision: i64,
    /// Findings of its reads, in their order.
    pub(super) ranges: Vec<Vec<etcd::KeyValue>>,
}

/// Tells whether another member, or the same one later, may answer otherwise.
fn may_pass(refused: &Status) -> bool {
    matches!(refused.code(), Code::Unavailable | Code::DeadlineExceeded | Code::Cancelled | Code::Unknown)
}

/// Says what a refusal of etcd means here.
fn said(refused: &Status) -> Bad {
    let text = refused.message();
    let todo = match refused.code() {
        Code::ResourceExhausted if text.contains("space") => {
            "let it compact and defragment (`etcdctl compact`, `etcdctl defrag`, `etcdctl alarm disarm`)"
        }
        Code::Unauthenticated | Code::PermissionDenied => "a GCM has no password for etcd: serve it without",
        Code::InvalidArgument if text.contains("user name is empty") => {
            "a GCM has no password for etcd: serve it without"
        }
        Code::InvalidArgument if text.contains("too large") || text.contains("too many") => {
            "leave --max-request-bytes and --max-txn-ops of etcd at least at what they are by default"
        }
        Code::Unimplemented => "what answers there is not etcd 3",
        _ => "see the log of etcd",
    };
    Bad::now(format!("etcd refused it ({text}): {todo}"))
}

/// A read of the newest value of one key.
pub(super) fn get(key: Vec<u8>) -> Op {
    Op::RequestRange(etcd::RangeRequest { key, ..Default::default() })
}

/// A read of keys.
pub(super) fn read(Span(key, range_end): Span, limit: i64, revision: i64) -> etcd::RangeRequest {
    etcd::RangeRequest { key, range_end, limit, revision, keys_only: false }
}

pub(super) fn put(key: Vec<u8>, value: Vec<u8>) -> Op {
    Op::RequestPut(etcd::PutRequest { key, value })
}

pub(super) fn delete(Span(key, range_end): Span) -> Op {
    Op::RequestDeleteRange(etcd::DeleteRangeRequest { key, range_end })
}

/// The key was changed last at that revision; 0: it is not there.
pub(super) fn changed_at(key: Vec<u8>, revision: i64) -> etcd::Compare {
    let (result, target) = (CompareResult::Equal.into(), CompareTarget::Mod.into());
    etcd::Compare { result, target, key, target_union: Some(TargetUnion::ModRevision(revision)) }
}

/// Does `success` if all of `compare` holds; else reads those keys.
pub(super) fn txn(compare: Vec<etcd::Compare>, success: Vec<Op>, failure: Vec<Op>) -> etcd::TxnRequest {
    let ops = |all: Vec<Op>| all.into_iter().map(|op| etcd::RequestOp { request: Some(op) }).collect();
    etcd::TxnRequest { compare, success: ops(success), failure: ops(failure) }
}
