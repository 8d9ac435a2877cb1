//! Files that were cut, changed, or are no journal: a prefix of the records, or a refusal.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use redb::ReadableTable;
use trocar_model::Wanted;

use super::super::copy::Copy;
use super::super::fault::Res;
use super::super::{FILE, RedbStore, View, contents};
use super::{fold, kinds, said};
use crate::gcm::{Loaded, Record, Store, Unusable};

/// Reads bytes as a store reads its file, before that is opened.
fn read(bytes: &[u8]) -> Res<Loaded> {
    Copy::checked(bytes)?.look(|txn| {
        let frame = contents::frame(txn)?;
        contents::load(txn, &frame)
    })
}

/// A journal with a snapshot in its middle: its file after a crash and after an end, and its records.
fn written() -> (Vec<u8>, Vec<u8>, Vec<Record>) {
    let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let file = dir.path().join(FILE);
    let mut store = RedbStore::new(dir.path());
    store.load().unwrap();
    store.append(&records[..2]).unwrap();
    store.append(&records[2..5]).unwrap();
    store.keep(&kinds::snapshot(&records[..5])).unwrap();
    for record in &records[5..] {
        store.append(std::slice::from_ref(record)).unwrap();
    }
    let crashed = fs::read(&file).unwrap();
    drop(store);
    (crashed, fs::read(&file).unwrap(), records)
}

/// The folds that a damaged file may give: that of all records, and that without the last commit.
fn folds(records: &[Record]) -> [Wanted; 2] {
    let upto = |count: usize| kinds::snapshot(&records[..count]).wanted;
    [upto(records.len()), upto(records.len() - 1)]
}

/// Offsets over a file: each byte of the header, and others all over the rest.
fn offsets(length: usize, count: usize) -> BTreeSet<usize> {
    let mut random = fastrand::Rng::with_seed(7);
    (0..320).step_by(3).chain((0..count).map(|_| random.usize(0..length))).collect()
}

fn assert_harmless(damaged: &[u8], folds: &[Wanted], how: &str) -> bool {
    match read(damaged) {
        Ok(loaded) => {
            assert!(folds.contains(&fold(&loaded)), "{how}: another fold: {}", said(&fold(&loaded)));
            false
        }
        Err(bad) => {
            assert_eq!(bad.unusable, Unusable::Damaged, "{how}: {}", bad.why);
            true
        }
    }
}

#[test]
fn a_file_that_was_cut_gives_a_prefix_or_is_refused() {
    let (crashed, ended, records) = written();
    for bytes in [&crashed, &ended] {
        assert_eq!(fold(&read(bytes).unwrap()), folds(&records)[0]);
        let mut refused = 0;
        for length in offsets(bytes.len(), 150) {
            let cut = assert_harmless(&bytes[..length], &folds(&records), &format!("cut at {length}"));
            refused += usize::from(cut);
        }
        assert!(refused > 100, "{refused} refused");
    }
}

#[test]
fn a_byte_that_was_changed_never_gives_another_fold() {
    let (crashed, ended, records) = written();
    for (bytes, folds) in [(&crashed, &folds(&records)[..]), (&ended, &folds(&records)[..1])] {
        let mut refused = 0;
        for at in offsets(bytes.len(), 250) {
            for bits in [0x01, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= bits;
                let damage = assert_harmless(&damaged, folds, &format!("byte {at} ^ {bits:#x}"));
                refused += usize::from(damage);
            }
        }
        // Free pages do not matter, and after a crash damage of the last commit is one that was not finished.
        assert!(refused > 20, "{refused} refused");
    }
}

#[test]
fn a_damaged_file_is_refused_unharmed_and_names_the_record() {
    let (_, ended, records) = written();
    // The text of the last request, which is the newest record.
    let text = br#"{"forget":"#;
    let at = ended.windows(text.len()).rposition(|window| window == text).unwrap();
    let mut damaged = ended;
    damaged[at] ^= 0x20;
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(FILE);
    fs::write(&file, &damaged).unwrap();
    let refused = RedbStore::new(dir.path()).load().unwrap_err();
    assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
    assert!(refused.why.starts_with(&format!("record {}: ", records.len())), "{refused}");
    let fault = View::open(dir.path()).err().unwrap();
    assert_eq!((fault.record, fault.error), (Some(records.len() as u64), refused));
    assert!(fs::read(&file).unwrap() == damaged, "the file was changed");
}

/// A record that was written anew, with all checksums of the file right.
#[test]
fn a_record_that_was_put_in_place_of_another_breaks_the_chain() {
    let (_, ended, _) = written();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(FILE);
    for (number, found) in [(7_u64, 7), (11, 11), (2, 3)] {
        fs::write(&file, &ended).unwrap();
        let database = redb::Database::open(&file).unwrap();
        let txn = database.begin_write().unwrap();
        let table = redb::TableDefinition::<u64, &[u8]>::new("records");
        let mut table = txn.open_table(table).unwrap();
        let bytes = table.get(number).unwrap().unwrap().value().to_vec();
        let mut linked = super::super::codec::record_in(&bytes).unwrap();
        linked.record.term += 1;
        let bytes = super::super::codec::record(&linked.record, number, &linked.before);
        table.insert(number, bytes.as_slice()).unwrap();
        drop(table);
        txn.commit().unwrap();
        drop(database);
        let fault = View::open(dir.path()).unwrap().verify().unwrap_err();
        let after = if number == 11 { 11 } else { number + 1 };
        assert!([found, after].contains(&fault.record.unwrap()), "record {number}: {fault:?}");
        let load = RedbStore::new(dir.path()).load();
        // Records that the snapshot folds are for the audit alone.
        assert_eq!(load.is_err(), number > 5, "record {number}");
    }
}

#[test]
fn a_file_that_is_no_journal_is_refused_and_stays() {
    let other = |dir: &Path| {
        let table = redb::TableDefinition::<u64, u64>::new("records");
        let database = redb::Database::create(dir.join("other")).unwrap();
        let txn = database.begin_write().unwrap();
        txn.open_table(table).unwrap().insert(1, 2).unwrap();
        txn.commit().unwrap();
        drop(database);
        fs::read(dir.join("other")).unwrap()
    };
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(FILE);
    for bytes in [Vec::new(), b"not a journal".to_vec(), vec![0; 100_000], other(dir.path())] {
        fs::write(&file, &bytes).unwrap();
        let refused = RedbStore::new(dir.path()).load().unwrap_err();
        assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
        assert!(View::open(dir.path()).is_err());
        assert!(fs::read(&file).unwrap() == bytes, "the file was changed");
    }
}
