//! The tables of a journal: its identity and head, records by number, the newest snapshot.
//!
//! Invariant: identity, head, records and snapshot change together or not at all; a record is only ever added
//! behind the head, and only whole records go, the oldest first.

use prost::Message;
use redb::{ReadTransaction, ReadableTable, ReadableTableMetadata, TableDefinition, WriteTransaction};
use trocar_proto::journal::v1 as wire;

use super::SCHEMA;
use super::chain::{self, Hash};
use super::codec::{self, Folded};
use super::fault::{Bad, Res};
use crate::gcm::{Loaded, Record, Snapshot};

const JOURNAL: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("journal");
const RECORDS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("records");
const SNAPSHOTS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("snapshots");
/// Rows of the table `journal`.
const IDENTITY: &str = "identity";
const HEAD: &str = "head";

/// The journal itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Random.
    pub id: u128,
    /// Time of day at which it was made, ns since 1970 (UTC).
    pub created_ns: u64,
}

/// A record that is kept.
#[derive(Clone, Debug)]
pub struct Kept {
    /// The first is 1.
    pub number: u64,
    /// Hash of the record as it is encoded.
    pub hash: Hash,
    pub record: Record,
}

/// The newest record, and all that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    /// 0: no record.
    pub(super) number: u64,
    pub(super) hash: Hash,
    /// All records, bytes.
    pub(super) bytes: u64,
}

/// Records that the audit keeps of those a snapshot folds, and how many there may be before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) records: u64,
    pub(super) bytes: u64,
    /// Bytes of all records up to which more are added.
    pub(super) unfolded: u64,
}

/// Identity and head.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) identity: Identity,
    pub(super) head: Head,
    /// Stands in the first record for the hash of the one before it.
    origin: Hash,
}

/// Makes the tables of a new journal, and returns their head.
pub(super) fn lay(txn: &WriteTransaction, identity: &Identity) -> Res<Head> {
    let message = wire::Identity {
        schema: SCHEMA,
        id: identity.id.to_be_bytes().to_vec(),
        created_ns: identity.created_ns,
    };
    let bytes = message.encode_to_vec();
    txn.open_table(RECORDS)?;
    txn.open_table(SNAPSHOTS)?;
    txn.open_table(JOURNAL)?.insert(IDENTITY, bytes.as_slice())?;
    let head = Head { number: 0, hash: Hash::of(&bytes), bytes: 0 };
    put_head(txn, &head)?;
    Ok(head)
}

/// Reads identity and head.
pub(super) fn frame(txn: &ReadTransaction) -> Res<Frame> {
    let table = txn.open_table(JOURNAL)?;
    let row = |name: &str| {
        let row = table.get(name)?.ok_or_else(|| Bad::damaged(format!("it has no {name}")))?;
        Ok::<_, Bad>(row.value().to_vec())
    };
    let identity = row(IDENTITY)?;
    codec::check_schema(&identity, "the journal")?;
    let origin = Hash::of(&identity);
    let identity: wire::Identity = codec::decoded(&identity)?;
    let id = identity.id.as_slice().try_into().map_err(|_| Bad::damaged("its id has not 16 bytes"))?;
    let identity = Identity { id: u128::from_be_bytes(id), created_ns: identity.created_ns };
    let head: wire::Head = codec::decoded(&row(HEAD)?)?;
    let hash = chain::read(&head.hash, "the hash of the newest record")?;
    let head = Head { number: head.number, hash, bytes: head.bytes };
    Ok(Frame { identity, head, origin })
}

/// Reads the newest snapshot.
pub(super) fn folded(txn: &ReadTransaction) -> Res<Option<Folded>> {
    let table = txn.open_table(SNAPSHOTS)?;
    let Some((number, bytes)) = table.last()? else { return Ok(None) };
    let number = number.value();
    let named = |bad: Bad| Bad { why: format!("the snapshot of record {number}: {}", bad.why), ..bad };
    let folded = codec::snapshot_in(bytes.value()).map_err(named)?;
    if folded.number != number {
        return Err(named(Bad::damaged(format!("it says that it is of record {}", folded.number))));
    }
    Ok(Some(folded))
}

/// Reads what a GCM begins with, and checks each record on the way.
pub(super) fn load(txn: &ReadTransaction, frame: &Frame) -> Res<Loaded> {
    let folded = folded(txn)?;
    let (number, hash) = folded.as_ref().map_or((0, frame.origin), |f| (f.number, f.hash));
    let snapshot = folded.map_or_else(Snapshot::default, |f| f.snapshot);
    let mut records = Vec::new();
    walk(txn, frame, Some((number, hash)), number + 1, &mut |kept| {
        records.push(kept.record);
        true
    })?;
    Ok(Loaded { snapshot, records })
}

/// Returns the number of the oldest record, and how many there are; (0, 0) without any.
pub(super) fn kept(txn: &ReadTransaction) -> Res<(u64, u64)> {
    let table = txn.open_table(RECORDS)?;
    let first = table.first()?.map_or(0, |(number, _)| number.value());
    Ok((first, table.len()?))
}

/// Visits records from that number on, in order, until `each` says false, and checks that each is whole and
/// follows the one before it. `after`: the record that the first one follows, where it is known.
pub(super) fn walk(
    txn: &ReadTransaction,
    frame: &Frame,
    after: Option<(u64, Hash)>,
    from: u64,
    each: &mut dyn FnMut(Kept) -> bool,
) -> Res<()> {
    let table = txn.open_table(RECORDS)?;
    let mut last = after;
    for row in table.range(from..)? {
        let (number, bytes) = row?;
        let (number, bytes) = (number.value(), bytes.value());
        let wrong = |why: String| Bad::damaged(why).in_record(number);
        let follows = last.map(|(last, _)| last + 1);
        if let Some(missing) = follows.filter(|follows| *follows != number) {
            return Err(Bad::damaged("it is missing").in_record(missing));
        }
        let linked = codec::record_in(bytes).map_err(|bad| bad.in_record(number))?;
        if linked.number != number {
            return Err(wrong(format!("it says that it is record {}", linked.number)));
        }
        let before = if number == 1 { Some(frame.origin) } else { last.map(|(_, hash)| hash) };
        if before.is_some_and(|before| before != linked.before) {
            return Err(wrong("it does not follow the record before it: one of the two was changed".into()));
        }
        let hash = Hash::of(bytes);
        if number == frame.head.number && hash != frame.head.hash {
            return Err(wrong("it was changed: it has another hash than the journal's head says".into()));
        }
        if number > frame.head.number {
            return Err(wrong(format!("the journal's head is record {}", frame.head.number)));
        }
        last = Some((number, hash));
        if !each(Kept { number, hash, record: linked.record }) {
            return Ok(());
        }
    }
    let (number, hash) = last.unwrap_or((0, frame.origin));
    if number != frame.head.number {
        return Err(Bad::damaged("it is missing").in_record(number + 1));
    }
    if hash != frame.head.hash {
        let why = format!("the snapshot of record {number} and the journal's head name different hashes");
        return Err(Bad::damaged(why));
    }
    Ok(())
}

/// Adds encoded records behind the head, and returns the new one, if all then have no more than `most` bytes.
/// `made` gives the bytes of a record by its number and the hash before it.
pub(super) fn add(
    txn: &WriteTransaction,
    head: &Head,
    count: usize,
    most: u64,
    made: impl Fn(usize, u64, &Hash) -> Vec<u8>,
) -> Res<Head> {
    let mut head = *head;
    let mut table = txn.open_table(RECORDS)?;
    for at in 0..count {
        let bytes = made(at, head.number + 1, &head.hash);
        if head.bytes + bytes.len() as u64 > most {
            let why =
                format!("its records would have more than {most} bytes: a snapshot has to be kept first");
            return Err(Bad::now(why));
        }
        table.insert(head.number + 1, bytes.as_slice())?;
        head =
            Head { number: head.number + 1, hash: Hash::of(&bytes), bytes: head.bytes + bytes.len() as u64 };
    }
    drop(table);
    put_head(txn, &head)?;
    Ok(head)
}

/// Puts a snapshot of all records in the place of the one before, and lets the oldest records go.
pub(super) fn fold(txn: &WriteTransaction, head: &Head, snapshot: &Snapshot, bounds: Bounds) -> Res<Head> {
    fold_encoded(txn, head, &codec::snapshot(snapshot, head.number, &head.hash), bounds)
}

/// The same with a snapshot as it is to lie in the file.
pub(super) fn fold_encoded(
    txn: &WriteTransaction,
    head: &Head,
    snapshot: &[u8],
    bounds: Bounds,
) -> Res<Head> {
    let mut snapshots = txn.open_table(SNAPSHOTS)?;
    while snapshots.pop_first()?.is_some() {}
    snapshots.insert(head.number, snapshot)?;
    drop(snapshots);
    let mut head = *head;
    let mut records = txn.open_table(RECORDS)?;
    let mut count = records.len()?;
    // The newest stays: it is what the next one follows.
    while count > 1 && (count > bounds.records || head.bytes > bounds.bytes) {
        let Some((_, gone)) = records.pop_first()? else { break };
        head.bytes = head.bytes.saturating_sub(gone.value().len() as u64);
        count -= 1;
    }
    drop(records);
    put_head(txn, &head)?;
    Ok(head)
}

/// Takes away what lies behind the head: it was committed by a call that said it had failed.
pub(super) fn cut_behind(txn: &WriteTransaction, head: &Head) -> Res<()> {
    for table in [RECORDS, SNAPSHOTS] {
        let mut table = txn.open_table(table)?;
        while table.last()?.is_some_and(|(number, _)| number.value() > head.number) {
            table.pop_last()?;
        }
    }
    Ok(())
}

/// Returns the hash of a record.
pub(super) fn hash_of(txn: &ReadTransaction, number: u64, frame: &Frame) -> Res<Option<Hash>> {
    if number == 0 {
        return Ok(Some(frame.origin));
    }
    let table = txn.open_table(RECORDS)?;
    Ok(table.get(number)?.map(|bytes| Hash::of(bytes.value())))
}

fn put_head(txn: &WriteTransaction, head: &Head) -> Res<()> {
    let message = wire::Head { number: head.number, hash: head.hash.bytes().to_vec(), bytes: head.bytes };
    txn.open_table(JOURNAL)?.insert(HEAD, message.encode_to_vec().as_slice())?;
    Ok(())
}
