//! The tables of a journal: its identity and head, records by number, the newest snapshot.
//!
//! Invariant: identity, head, records and snapshot change together or not at all; a record is only ever added
//! behind the head, and only whole records go, the oldest first.

use redb::{ReadTransaction, ReadableTable, ReadableTableMetadata, TableDefinition, WriteTransaction};

use super::chain::Hash;
use super::codec::{self, Folded};
use super::fault::{Bad, Res};
use super::frame::{Bounds, Frame, Head, Identity, Kept, Walk};
use crate::gcm::{Loaded, Snapshot};

const JOURNAL: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("journal");
const RECORDS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("records");
const SNAPSHOTS: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("snapshots");
/// Rows of the table `journal`.
const IDENTITY: &str = "identity";
const HEAD: &str = "head";

/// Makes the tables of a new journal, and returns their head.
pub(super) fn lay(txn: &WriteTransaction, identity: &Identity) -> Res<Head> {
    let bytes = identity.encoded();
    txn.open_table(RECORDS)?;
    txn.open_table(SNAPSHOTS)?;
    txn.open_table(JOURNAL)?.insert(IDENTITY, bytes.as_slice())?;
    let head = Head::of_none(&bytes);
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
    Frame::read(&row(IDENTITY)?, &row(HEAD)?)
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
    let mut walk = Walk::new(frame, after);
    for row in table.range(from..)? {
        let (number, bytes) = row?;
        if !each(walk.next(number.value(), bytes.value())?) {
            return Ok(());
        }
    }
    walk.end()
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
        let next = head.with(&bytes, most)?;
        table.insert(next.number, bytes.as_slice())?;
        head = next;
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
    txn.open_table(JOURNAL)?.insert(HEAD, head.encoded().as_slice())?;
    Ok(())
}
