//! Reads a journal from etcd: its roots, then the newest snapshot and the records after it.
//!
//! Invariant: all of it is read at one revision, and what the head does not name is not read.

use prost::Message;
use trocar_proto::etcd::KeyValue;
use trocar_proto::journal::v1 as wire;

use super::client::{Client, get, read, txn};
use super::keys::{Keys, Span};
use super::writing::{Operation, WITHIN};
use crate::gcm::{Loaded, Snapshot};
use crate::journal::SCHEMA;
use crate::journal::chain::{self, Hash};
use crate::journal::codec::{self, Folded};
use crate::journal::fault::{Bad, Res};
use crate::journal::frame::{Frame, Walk};

/// Keys that are read at a time: each has no more than [`super::writing::PIECE`] bytes.
const PAGE: i64 = 100;

/// The keys from which all others of a journal are found, as they were at one revision.
#[derive(Clone, Debug)]
pub(super) struct Roots {
    pub(super) frame: Frame,
    /// Revision at which the head was written.
    pub(super) head_at: i64,
    /// The newest snapshot; `None`: there is none.
    pub(super) snapshot: Option<Parts>,
    /// Revision of all of it.
    revision: i64,
}

/// A snapshot in parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parts {
    pub(super) generation: u64,
    pub(super) parts: u32,
    pub(super) hash: Hash,
}

impl Parts {
    pub(super) fn encoded(&self) -> Vec<u8> {
        let Parts { generation, parts, hash } = *self;
        let hash = hash.bytes().to_vec();
        wire::SnapshotParts { schema: SCHEMA, generation, parts, hash }.encode_to_vec()
    }

    fn read(bytes: &[u8]) -> Res<Parts> {
        codec::check_schema(bytes, "the snapshot")?;
        let wire::SnapshotParts { generation, parts, hash, .. } = codec::decoded(bytes)?;
        Ok(Parts { generation, parts, hash: chain::read(&hash, "the hash of the snapshot")? })
    }
}

/// Reads the roots; `None`: there is no journal.
pub(super) async fn roots(client: &Client, keys: &Keys) -> Res<Option<Roots>> {
    let first = read(keys.records_from(0), 1, 0);
    let all = [keys.identity(), keys.head(), keys.snapshot()].map(get);
    let ops = all.into_iter().chain([Operation::RequestRange(first)]);
    let done = client.txn(txn(Vec::new(), ops.collect(), Vec::new()), WITHIN).await?;
    let mut found = done.ranges.into_iter().map(|kvs| kvs.into_iter().next());
    let mut next = || found.next().flatten();
    let (identity, head, snapshot, record) = (next(), next(), next(), next());
    let (identity, head) = match (identity, head) {
        (None, None) if snapshot.is_none() && record.is_none() => return Ok(None),
        (None, _) => {
            return Err(Bad::damaged("it has no identity: what lies under this prefix is not a journal"));
        }
        (_, None) => return Err(Bad::damaged("it has no head")),
        (Some(identity), Some(head)) => (identity, head),
    };
    let frame = Frame::read(&identity.value, &head.value)?;
    let snapshot = snapshot.map(|snapshot| Parts::read(&snapshot.value)).transpose()?;
    Ok(Some(Roots { frame, head_at: head.mod_revision, snapshot, revision: done.revision }))
}

/// Reads what a GCM begins with, and checks each record on the way.
pub(super) async fn load(client: &Client, keys: &Keys, roots: &Roots) -> Res<Loaded> {
    let frame = &roots.frame;
    let folded = match &roots.snapshot {
        Some(parts) => Some(folded(client, keys, roots, parts).await?),
        None => None,
    };
    let (number, hash) = folded.as_ref().map_or((0, frame.origin), |f| (f.number, f.hash));
    let snapshot = folded.map_or_else(Snapshot::default, |f| f.snapshot);
    let span = Span(keys.records_from(number + 1).0, keys.records_from(frame.head.number + 1).0);
    let (mut records, mut walk) = (Vec::new(), Walk::new(frame, Some((number, hash))));
    let mut joined = Joined::default();
    let mut one = |number, bytes: &[u8]| {
        records.push(walk.next(number, bytes)?.record);
        Ok(())
    };
    pages(client, span, roots.revision, |kv| joined.part(keys, &kv, &mut one)).await?;
    joined.end(&mut one)?;
    walk.end()?;
    Ok(Loaded { snapshot, records })
}

async fn folded(client: &Client, keys: &Keys, roots: &Roots, parts: &Parts) -> Res<Folded> {
    let named = |bad: Bad| Bad { why: format!("snapshot {}: {}", parts.generation, bad.why), ..bad };
    let (mut bytes, mut count) = (Vec::new(), 0);
    let one = |kv: KeyValue| {
        bytes.extend_from_slice(&kv.value);
        count += 1;
        Ok(())
    };
    pages(client, keys.parts(parts.generation), roots.revision, one).await?;
    if count != parts.parts {
        return Err(named(Bad::damaged(format!("it has {count} parts, not {}", parts.parts))));
    }
    if Hash::of(&bytes) != parts.hash {
        return Err(named(Bad::damaged("it was changed: it has another hash than the journal says")));
    }
    codec::snapshot_in(&bytes).map_err(named)
}

/// Reads the oldest records until `enough` says so of the number of one and its bytes.
pub(super) async fn oldest(
    client: &Client,
    keys: &Keys,
    mut enough: impl FnMut(u64, u64) -> bool,
) -> Res<()> {
    let Span(mut from, end) = keys.records_from(0);
    loop {
        let (kvs, more) = client.range(read(Span(from, end.clone()), PAGE, 0), WITHIN).await?;
        for kv in &kvs {
            let (number, _) = keys.record_of(&kv.key).ok_or_else(|| no_record(kv))?;
            if enough(number, kv.value.len() as u64) {
                return Ok(());
            }
        }
        match kvs.last() {
            Some(last) if more => from = behind(&last.key),
            _ => return Ok(()),
        }
    }
}

/// Visits keys in their order, all at one revision.
async fn pages(
    client: &Client,
    Span(mut from, end): Span,
    revision: i64,
    mut each: impl FnMut(KeyValue) -> Res<()>,
) -> Res<()> {
    if from >= end {
        return Ok(());
    }
    loop {
        let (kvs, more) = client.range(read(Span(from, end.clone()), PAGE, revision), WITHIN).await?;
        let last = kvs.last().map(|last| behind(&last.key));
        for kv in kvs {
            each(kv)?;
        }
        match last {
            Some(last) if more => from = last,
            _ => return Ok(()),
        }
    }
}

/// The first key behind that one.
fn behind(key: &[u8]) -> Vec<u8> {
    [key, &[0]].concat()
}

fn no_record(kv: &KeyValue) -> Bad {
    Bad::damaged(format!("the key {} is not one of a record", String::from_utf8_lossy(&kv.key)))
}

/// Records of which parts come one by one.
#[derive(Default)]
struct Joined {
    number: u64,
    parts: usize,
    bytes: Vec<u8>,
}

type Whole<'w> = dyn FnMut(u64, &[u8]) -> Res<()> + Send + 'w;

impl Joined {
    /// Takes a part; a record is whole when the first part of another comes.
    fn part(&mut self, keys: &Keys, kv: &KeyValue, whole: &mut Whole<'_>) -> Res<()> {
        let (number, part) = keys.record_of(&kv.key).ok_or_else(|| no_record(kv))?;
        if number != self.number {
            self.end(whole)?;
            self.number = number;
        }
        if part != self.parts {
            return Err(Bad::damaged(format!("part {} is missing", self.parts)).in_record(number));
        }
        self.parts += 1;
        self.bytes.extend_from_slice(&kv.value);
        Ok(())
    }

    fn end(&mut self, whole: &mut Whole<'_>) -> Res<()> {
        if self.parts == 0 {
            return Ok(());
        }
        whole(self.number, &self.bytes)?;
        (self.parts, self.bytes) = (0, Vec::new());
        Ok(())
    }
}
