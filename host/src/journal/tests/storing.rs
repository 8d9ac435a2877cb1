//! The store: groups, snapshots, disks that fail, and other stores beside it.

use std::fs;
use std::path::Path;

use prost::Message;
use trocar_proto::journal::v1 as wire;

use super::super::contents;
use super::super::frame::{Bounds, Head};
use super::super::opening::Opener;
use super::super::{FILE, RedbStore, SCHEMA, View, codec};
use super::{kinds, loaded, said};
use crate::gcm::{Loaded, Record, Snapshot, Store, Unusable};

const ALL: Bounds = Bounds { records: 1000, bytes: 1 << 30, unfolded: 1 << 30 };
const ENOSPC: i32 = 28;
const EIO: i32 = 5;

/// Opens a journal of which nothing has to be known.
fn opened(dir: &Path) -> RedbStore {
    let mut store = RedbStore::new(dir);
    store.load().unwrap();
    store
}

fn assert_has(loaded: &Loaded, records: &[Record]) {
    assert_eq!(said(&loaded.records), said(&records));
}

#[test]
fn a_journal_keeps_its_identity() {
    let dir = tempfile::tempdir().unwrap();
    let refused = RedbStore::new(dir.path()).append(&kinds::records()).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Now, "{refused}");
    assert!(!dir.path().join(FILE).exists(), "what was not loaded is not begun");
    let identity = opened(dir.path()).identity().unwrap();
    let mut store = RedbStore::new(dir.path());
    store.load().unwrap();
    assert_eq!(store.identity().unwrap(), identity, "the journal is the same one");
}

#[test]
fn what_a_snapshot_folds_stays_in_the_audit() {
    let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let mut store = opened(dir.path());
    store.append(&records[..5]).unwrap();
    store.keep(&kinds::snapshot(&records[..5])).unwrap();
    store.append(&records[5..7]).unwrap();
    drop(store);
    let verified = View::open(dir.path()).unwrap().verify().unwrap();
    assert_eq!((verified.records, verified.first, verified.last), (7, 1, 7));
    assert_eq!(
        (verified.snapshot, verified.first_revision, verified.last_revision),
        (Some(5), Some(1), Some(4))
    );
}

#[test]
fn the_oldest_records_go_when_a_snapshot_is_kept_and_the_audit_has_enough() {
    let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let mut store = RedbStore::new(dir.path()).with(Opener::default(), Bounds { records: 4, ..ALL });
    store.load().unwrap();
    store.append(&records).unwrap();
    store.keep(&kinds::snapshot(&records)).unwrap();
    let verified = View::open(dir.path()).unwrap().verify().unwrap();
    assert_eq!((verified.records, verified.first, verified.last), (4, 8, 11));
    let mut store = store.with(Opener::default(), Bounds { records: 4, bytes: 1, ..ALL });
    store.keep(&kinds::snapshot(&records)).unwrap();
    let verified = View::open(dir.path()).unwrap().verify().unwrap();
    assert_eq!((verified.records, verified.first, verified.last), (1, 11, 11));
    store.append(&records[..2]).unwrap();
    drop(store);
    let read = loaded(dir.path());
    assert_has(&read, &records[..2]);
    assert_eq!(read.snapshot.wanted, kinds::snapshot(&records).wanted);
}

#[test]
fn a_second_store_is_told_that_another_has_the_journal() {
    let dir = tempfile::tempdir().unwrap();
    let mut first = opened(dir.path());
    let refused = RedbStore::new(dir.path()).load().unwrap_err();
    assert_eq!(refused.unusable, Unusable::InUse, "{refused}");
    first.append(&kinds::records()).unwrap();
    drop(first);
    assert_has(&loaded(dir.path()), &kinds::records());
}

/// The disk is full at each write of a commit in turn, until the commit needs no more writes.
#[test]
fn a_disk_that_was_full_takes_the_same_records_when_it_has_room() {
    for kept in [false, true] {
        let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
        let opener = Opener::default();
        let mut store = RedbStore::new(dir.path()).with(opener.clone(), ALL);
        store.load().unwrap();
        store.append(&records[..1]).unwrap();
        let mut count = 1;
        for writes in 0.. {
            assert!(writes < 200, "a commit needs no {writes} writes");
            *opener.faults.write.lock() = Some((writes, ENOSPC));
            let add = |store: &mut RedbStore| match kept {
                true => store.keep(&Snapshot::default()),
                false => store.append(&records[1..2]),
            };
            let full = add(&mut store);
            let failed = opener.faults.write.lock().take().is_none();
            if let Err(e) = &full {
                assert_eq!(e.unusable, Unusable::Now, "{e}");
                add(&mut store).unwrap();
            }
            count += 1;
            if full.is_ok() && !failed {
                break;
            }
        }
        drop(store);
        let read = loaded(dir.path());
        assert_eq!(read.records.len(), if kept { 0 } else { count }, "each record is there once");
    }
}

#[test]
fn a_sync_that_failed_is_never_tried_again() {
    let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let opener = Opener::default();
    let mut store = RedbStore::new(dir.path()).with(opener.clone(), ALL);
    store.load().unwrap();
    store.append(&records[..2]).unwrap();
    *opener.faults.sync.lock() = Some(EIO);
    let lost = store.append(&records[2..3]).unwrap_err();
    assert_eq!(lost.unusable, Unusable::NotSynced, "{lost}");
    assert_eq!(store.append(&records[2..3]).unwrap_err().unusable, Unusable::NotSynced);
    assert_eq!(store.load().unwrap_err().unusable, Unusable::NotSynced);
    drop(store);
    let count = loaded(dir.path()).records.len();
    assert!((2..=3).contains(&count), "{count} records");
}

#[test]
fn a_directory_that_is_gone_or_closed_can_be_tried_again() {
    let dir = tempfile::tempdir().unwrap();
    let inner = dir.path().join("state");
    let mut store = RedbStore::new(&inner);
    let gone = store.load().unwrap_err();
    assert_eq!(gone.unusable, Unusable::Now, "{gone}");
    fs::create_dir(&inner).unwrap();
    store.load().unwrap();
    store.append(&kinds::records()).unwrap();
    let away = dir.path().join("away");
    fs::rename(&inner, &away).unwrap();
    for _ in 0..2 {
        let gone = store.append(&kinds::records()).unwrap_err();
        assert_eq!(gone.unusable, Unusable::Now, "{gone}");
    }
    assert!(!inner.exists(), "no second journal is begun in its place");
    fs::rename(&away, &inner).unwrap();
    store.append(&kinds::records()).unwrap();
    drop(store);
    assert_eq!(loaded(&inner).records.len(), 22);
}

#[test]
fn another_journal_in_its_place_is_refused() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut store = opened(dir.path());
    store.append(&kinds::records()).unwrap();
    opened(other.path()).append(&kinds::records()).unwrap();
    fs::rename(other.path().join(FILE), dir.path().join(FILE)).unwrap();
    let replaced = store.append(&kinds::records()).unwrap_err();
    assert_eq!(replaced.unusable, Unusable::Now, "{replaced}");
    let other = store.append(&kinds::records()).unwrap_err();
    assert_eq!(other.unusable, Unusable::Damaged, "{other}");
}

/// Writes into a journal as a later release might.
fn as_later(dir: &Path, write: impl FnOnce(&redb::WriteTransaction, &Head)) {
    let opener = Opener::default();
    let (open, head) = opener.open(&dir.join(FILE), |_, frame| Ok(frame.head)).unwrap();
    open.write(|txn| {
        write(txn, &head);
        Ok(())
    })
    .unwrap();
}

#[test]
fn what_a_later_release_wrote_is_refused_and_unharmed() {
    let records = kinds::records();
    type Write<'a> = &'a dyn Fn(&redb::WriteTransaction, &Head);
    let later: [Write<'_>; 2] = [
        &|txn, head| {
            let made = |_, number, before: &_| {
                let bytes = codec::record(&records[0], number, before);
                let record = wire::Record::decode(bytes.as_slice()).unwrap();
                wire::Record { schema: SCHEMA + 6, ..record }.encode_to_vec()
            };
            contents::add(txn, head, 1, u64::MAX, made).unwrap();
        },
        &|txn, head| {
            let bytes = codec::snapshot(&Snapshot::default(), head.number, &head.hash);
            let snapshot = wire::Snapshot::decode(bytes.as_slice()).unwrap();
            let bytes = wire::Snapshot { schema: SCHEMA + 6, ..snapshot }.encode_to_vec();
            contents::fold_encoded(txn, head, &bytes, ALL).unwrap();
        },
    ];
    for write in later {
        let dir = tempfile::tempdir().unwrap();
        opened(dir.path()).append(&records).unwrap();
        as_later(dir.path(), write);
        let before = fs::read(dir.path().join(FILE)).unwrap();
        let refused = RedbStore::new(dir.path()).load().unwrap_err();
        assert_eq!(refused.unusable, Unusable::Newer, "{refused}");
        assert!(refused.why.contains("schema 7") && refused.why.contains("schema 1"), "{refused}");
        let view = View::open(dir.path()).unwrap();
        assert_eq!(view.verify().unwrap_err().error.unusable, Unusable::Newer);
        assert!(fs::read(dir.path().join(FILE)).unwrap() == before, "the file was changed");
    }
}

#[test]
fn a_journal_is_looked_at_while_it_is_written() {
    let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let mut store = opened(dir.path());
    for (at, record) in records.iter().enumerate() {
        store.append(std::slice::from_ref(record)).unwrap();
        let view = View::open(dir.path()).unwrap();
        assert_eq!(view.verify().unwrap().last, at as u64 + 1);
        let mut seen = Vec::new();
        view.records(0, &mut |kept| {
            seen.push(kept.record);
            true
        })
        .unwrap();
        assert_eq!(said(&seen), said(&records[..=at].to_vec()));
    }
}
