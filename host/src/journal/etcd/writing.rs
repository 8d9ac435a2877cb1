//! Writes a journal to etcd: one transaction, or a sequence of which the last makes it count.
//!
//! Invariant: each transaction compares the revisions of the term and of the head. What lies behind
//! the head does not count, and goes with the next change.

use std::time::Duration;

use trocar_proto::etcd;
pub(super) use trocar_proto::etcd::request_op::Request as Operation;

use super::client::{Client, changed_at, delete, get, put, txn};
use super::keys::{Keys, Span};
use crate::gcm::Unusable;
use crate::journal::fault::{Bad, Res};

/// Time for a call of etcd: its own election of a leader takes up to 2 s by default.
pub(super) const WITHIN: Duration = Duration::from_secs(2);
/// Longest value, bytes.
pub(super) const PIECE: usize = 512 << 10;
/// Bytes and operations of one transaction: etcd takes 1.5 MiB and 128 by default.
const TXN: (usize, usize) = (1 << 20, 100);

/// Conditions of a transaction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    /// Revision at which the term of this leader was counted.
    pub(super) term: i64,
    /// Revision at which the head was written.
    pub(super) head: i64,
}

/// Puts, cut into as many transactions as they need.
#[derive(Default)]
pub(super) struct Puts {
    full: Vec<Vec<Operation>>,
    /// The last of them.
    open: Vec<Operation>,
    bytes: usize,
}

impl Puts {
    pub(super) fn put(&mut self, key: Vec<u8>, value: &[u8]) {
        let bytes = key.len() + value.len();
        let (most_bytes, most) = TXN;
        if self.bytes + bytes > most_bytes || self.open.len() >= most {
            self.full.push(std::mem::take(&mut self.open));
            self.bytes = 0;
        }
        self.bytes += bytes;
        self.open.push(put(key, value.to_vec()));
    }

    /// Puts a value in pieces; returns their number.
    pub(super) fn pieces(&mut self, bytes: &[u8], key: impl Fn(usize) -> Vec<u8>) -> usize {
        let pieces = bytes.chunks(PIECE);
        let count = pieces.len();
        for (at, piece) in pieces.enumerate() {
            self.put(key(at), piece);
        }
        count
    }
}

/// Does all puts, the last of them together with `then` and the new head. Returns the revision at which the
/// head was written.
pub(super) async fn commit(
    client: &Client,
    keys: &Keys,
    held: Held,
    Puts { full, open, .. }: Puts,
    then: Vec<Operation>,
    head: Vec<u8>,
) -> Res<i64> {
    for puts in full {
        let done = client.txn(held.txn(keys, puts), WITHIN).await?;
        if !done.succeeded {
            return Err(held.refused(&done.ranges));
        }
    }
    let mut last = open;
    last.extend(then);
    last.push(put(keys.head(), head.clone()));
    let done = client.txn(held.txn(keys, last), WITHIN).await?;
    if done.succeeded {
        return Ok(done.revision);
    }
    // The answer to an earlier attempt was lost, which had done it.
    let there = done.ranges.get(1).and_then(|kvs| kvs.first());
    match there.filter(|there| there.value == head && held.leads(&done.ranges)) {
        Some(there) => Ok(there.mod_revision),
        None => Err(held.refused(&done.ranges)),
    }
}

impl Held {
    fn txn(&self, keys: &Keys, success: Vec<Operation>) -> etcd::TxnRequest {
        let compare = vec![changed_at(keys.term(), self.term), changed_at(keys.head(), self.head)];
        txn(compare, success, vec![get(keys.term()), get(keys.head())])
    }

    /// Tells whether the term is still this leader's, by what a refused transaction has read.
    fn leads(&self, ranges: &[Vec<etcd::KeyValue>]) -> bool {
        let term = ranges.first().and_then(|kvs| kvs.first());
        term.is_some_and(|term| term.mod_revision == self.term)
    }

    fn refused(&self, ranges: &[Vec<etcd::KeyValue>]) -> Bad {
        match self.leads(ranges) {
            true => Bad::damaged("another process wrote it: its head is not as this GCM has left it"),
            false => Bad::new(Unusable::NotLeading, "this GCM leads no more, so nothing was written"),
        }
    }
}

/// Takes away all records before the first that is kept, and all parts of snapshots but those of the newest,
/// which has so many.
pub(super) fn outdated(keys: &Keys, first: u64, (generation, parts): (u64, usize)) -> Vec<Operation> {
    let left_over = Span(keys.part(generation, parts), keys.parts(generation).1);
    [keys.records_before(first), keys.snapshots_before(generation), left_over].map(delete).into()
}
