//! Promises of every store: the same tests, over a file and over etcd.
//!
//! Invariant: a test here knows a store by the trait alone, and where one lies by [`Place`].

use super::super::RedbStore;
use super::super::etcd::tests::Lab;
use super::super::frame::Bounds;
use super::super::opening::Opener;
use super::{fold, kinds, said};
use crate::gcm::{Loaded, Record, Snapshot, Store, Unusable};

pub(in crate::journal) const ALL: Bounds = Bounds { records: 1000, bytes: 1 << 30, unfolded: 1 << 30 };

/// A place where a journal outlives those who use it.
trait Place {
    /// A store as the next GCM has it; the one before is not used any more.
    fn store(&mut self, bounds: Bounds) -> Box<dyn Store>;
}

struct Directory(tempfile::TempDir);

impl Directory {
    fn new() -> Directory {
        Directory(tempfile::tempdir().unwrap())
    }
}

impl Place for Directory {
    fn store(&mut self, bounds: Bounds) -> Box<dyn Store> {
        Box::new(RedbStore::new(self.0.path()).with(Opener::default(), bounds))
    }
}

impl Place for Lab {
    fn store(&mut self, bounds: Bounds) -> Box<dyn Store> {
        Box::new(self.leads().with(bounds))
    }
}

/// Each test over each place.
macro_rules! conformance {
    ($($test:ident)*) => {
        mod file {
            use super::Directory;
            $(#[test] fn $test() { super::$test(&mut Directory::new()) })*
        }
        mod etcd {
            use super::Lab;
            $(#[test] #[ignore = "needs etcd: ./tests/run etcd"] fn $test() { super::$test(&mut Lab::new(1)) })*
        }
    };
}

conformance! {
    what_was_added_is_there_again_in_its_order
    a_snapshot_takes_the_place_of_the_records_before_it
    records_go_on_where_the_audit_let_the_oldest_go
    a_journal_that_is_full_takes_more_after_a_snapshot
    records_and_snapshots_of_any_size_come_back
    many_records_are_added_at_once
    nothing_is_added_to_what_was_not_loaded
    a_snapshot_may_be_kept_again_and_again
}

fn loaded(place: &mut dyn Place) -> Loaded {
    place.store(ALL).load().unwrap()
}

fn assert_has(loaded: &Loaded, records: &[Record]) {
    assert_eq!(said(&loaded.records), said(&records));
}

fn what_was_added_is_there_again_in_its_order(place: &mut dyn Place) {
    let records = kinds::records();
    let mut store = place.store(ALL);
    assert!(store.load().unwrap().records.is_empty());
    store.append(&records[..3]).unwrap();
    store.append(&[]).unwrap();
    store.append(&records[3..4]).unwrap();
    drop(store);
    let mut store = place.store(ALL);
    assert_has(&store.load().unwrap(), &records[..4]);
    store.append(&records[4..]).unwrap();
    assert_has(&store.load().unwrap(), &records);
    drop(store);
    assert_has(&loaded(place), &records);
}

fn a_snapshot_takes_the_place_of_the_records_before_it(place: &mut dyn Place) {
    let records = kinds::records();
    let mut store = place.store(ALL);
    store.load().unwrap();
    store.keep(&Snapshot::default()).unwrap();
    store.append(&records[..5]).unwrap();
    store.keep(&kinds::snapshot(&records[..5])).unwrap();
    store.append(&records[5..7]).unwrap();
    drop(store);
    let read = loaded(place);
    assert_has(&read, &records[5..7]);
    assert_eq!(fold(&read), kinds::snapshot(&records[..7]).wanted);
    assert_eq!(said(&read.snapshot), said(&kinds::snapshot(&records[..5])));
}

fn records_go_on_where_the_audit_let_the_oldest_go(place: &mut dyn Place) {
    let records = kinds::records();
    for bounds in [Bounds { records: 4, ..ALL }, Bounds { bytes: 1, ..ALL }] {
        let mut store = place.store(bounds);
        store.load().unwrap();
        store.append(&records).unwrap();
        store.keep(&kinds::snapshot(&records)).unwrap();
        store.append(&records[..2]).unwrap();
        drop(store);
        let read = loaded(place);
        assert_has(&read, &records[..2]);
        assert_eq!(read.snapshot.wanted, kinds::snapshot(&records).wanted);
    }
}

fn a_journal_that_is_full_takes_more_after_a_snapshot(place: &mut dyn Place) {
    let records = kinds::records();
    let mut store = place.store(Bounds { records: 1, bytes: 1, unfolded: 40_000 });
    store.load().unwrap();
    let mut count = 0;
    let full = loop {
        match store.append(&records) {
            Ok(()) => count += 1,
            Err(full) => break full,
        }
    };
    assert!(count > 0 && full.unusable == Unusable::Now, "{count}: {full}");
    assert!(full.why.contains("snapshot has to be kept first"), "{full}");
    store.keep(&kinds::snapshot(&records)).unwrap();
    store.append(&records).unwrap();
    drop(store);
    assert_has(&loaded(place), &records);
}

/// Larger than any one value or request that a store may be bounded by.
fn records_and_snapshots_of_any_size_come_back(place: &mut dyn Place) {
    let mut records = kinds::records();
    let asked = records.iter_mut().rev().find_map(|record| record.asked.as_mut()).unwrap();
    asked.text = "µ".repeat(2 << 20);
    let mut store = place.store(ALL);
    store.load().unwrap();
    store.append(&records).unwrap();
    drop(store);
    let mut store = place.store(ALL);
    assert_has(&store.load().unwrap(), &records);
    let mut large = kinds::snapshot(&records);
    assert!(!large.answers.is_empty());
    large.answers[0].asked.text = "x".repeat(5 << 20);
    store.keep(&large).unwrap();
    // A smaller one in its place leaves nothing of it.
    drop(store);
    let mut store = place.store(ALL);
    assert_eq!(said(&store.load().unwrap().snapshot), said(&large));
    store.keep(&kinds::snapshot(&records)).unwrap();
    drop(store);
    assert_eq!(said(&loaded(place).snapshot), said(&kinds::snapshot(&records)));
}

fn many_records_are_added_at_once(place: &mut dyn Place) {
    let records: Vec<Record> = std::iter::repeat_with(kinds::records).take(30).flatten().collect();
    let mut store = place.store(ALL);
    store.load().unwrap();
    store.append(&records).unwrap();
    drop(store);
    assert_has(&loaded(place), &records);
}

fn nothing_is_added_to_what_was_not_loaded(place: &mut dyn Place) {
    let refused = place.store(ALL).append(&kinds::records()).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Now, "{refused}");
    let mut store = place.store(ALL);
    store.load().unwrap();
    store.append(&kinds::records()).unwrap();
    drop(store);
    let refused = place.store(ALL).append(&kinds::records()).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Now, "{refused}");
    assert_has(&loaded(place), &kinds::records());
}

fn a_snapshot_may_be_kept_again_and_again(place: &mut dyn Place) {
    let records = kinds::records();
    let mut store = place.store(Bounds { records: 3, ..ALL });
    store.load().unwrap();
    for count in 1..=records.len() {
        store.append(&records[count - 1..count]).unwrap();
        store.keep(&kinds::snapshot(&records[..count])).unwrap();
    }
    drop(store);
    let read = loaded(place);
    assert_has(&read, &[]);
    assert_eq!(said(&read.snapshot), said(&kinds::snapshot(&records)));
}
