//! Stores that go on where they cannot be written, begin another journal, or survive what the database does.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::super::copy::MOST;
use super::super::frame::Bounds;
use super::super::opening::Opener;
use super::super::{FILE, RedbStore, View};
use super::{fold, kinds, loaded, said};
use crate::gcm::{Asked, Record, Store, Unusable};

const ALL: Bounds = Bounds { records: 1000, bytes: 1 << 30, unfolded: 1 << 30 };
const EIO: i32 = 5;
const EACCES: i32 = 13;
const ENOSPC: i32 = 28;
const EROFS: i32 = 30;

fn store(dir: &Path) -> (RedbStore, Opener) {
    let opener = Opener::default();
    (RedbStore::new(dir).with(opener.clone(), ALL), opener)
}

/// A directory with a journal of all records.
fn written() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mut store = RedbStore::new(dir.path());
    store.load().unwrap();
    store.append(&kinds::records()).unwrap();
    dir
}

fn names(dir: &Path) -> Vec<String> {
    let names = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

#[test]
fn a_snapshot_begins_another_journal_where_the_file_or_its_directory_was_removed() {
    let (outer, records) = (tempfile::tempdir().unwrap(), kinds::records());
    let dir = outer.path().join("state");
    fs::create_dir(&dir).unwrap();
    let (mut store, _) = store(&dir);
    store.load().unwrap();
    store.append(&records[..6]).unwrap();
    let removals: [&dyn Fn(); 2] =
        [&|| fs::remove_file(dir.join(FILE)).unwrap(), &|| fs::remove_dir_all(&dir).unwrap()];
    for (at, remove) in removals.iter().enumerate() {
        let before = store.identity().unwrap();
        remove();
        let refused = store.append(&records[6..7]).unwrap_err();
        assert_eq!(refused.unusable, Unusable::Now, "{refused}");
        assert!(!dir.join(FILE).exists(), "nothing is begun without a snapshot");
        store.keep(&kinds::snapshot(&records[..6])).unwrap();
        assert_ne!(store.identity().unwrap(), before);
        store.append(&records[6..]).unwrap();
        let verified = View::open(&dir).unwrap().verify().unwrap();
        assert_eq!((verified.identity, verified.last), (store.identity().unwrap(), 5), "{at}");
    }
    assert_eq!(fs::metadata(&dir).unwrap().permissions().mode() & 0o777, 0o700);
    drop(store);
    let read = loaded(&dir);
    assert_eq!(said(&read.snapshot), said(&kinds::snapshot(&records[..6])));
    assert_eq!(said(&read.records), said(&records[6..].to_vec()));
    assert_eq!(fold(&read), kinds::snapshot(&records).wanted);
    assert_eq!(names(&dir), [FILE]);
}

#[test]
fn a_journal_that_could_not_be_loaded_is_put_aside_by_a_snapshot() {
    for still in [false, true] {
        let (dir, records) = (written(), kinds::records());
        let before = fs::read(dir.path().join(FILE)).unwrap();
        fs::write(dir.path().join("journal.redb.old-3"), "an older one").unwrap();
        let (mut store, opener) = store(dir.path());
        *opener.faults.unwritable.lock() = Some(EIO);
        assert_eq!(store.load().unwrap_err().unusable, Unusable::Now);
        assert_eq!(store.append(&records).unwrap_err().unusable, Unusable::Now);
        if !still {
            *opener.faults.unwritable.lock() = None;
            let refused = store.append(&records).unwrap_err();
            assert_eq!(refused.unusable, Unusable::Now, "it was not loaded: {refused}");
        }
        assert_eq!(names(dir.path()), [FILE, "journal.redb.old-3"]);
        let kept = store.keep(&kinds::snapshot(&records[..2]));
        assert_eq!(kept.is_err(), still, "it is begun, and cannot be opened yet: {kept:?}");
        *opener.faults.unwritable.lock() = None;
        store.keep(&kinds::snapshot(&records[..2])).unwrap();
        store.append(&records[2..]).unwrap();
        drop(store);
        assert_eq!(names(dir.path()), [FILE, "journal.redb.old-3", "journal.redb.old-4"]);
        assert!(fs::read(dir.path().join("journal.redb.old-4")).unwrap() == before);
        assert_eq!(said(&loaded(dir.path()).records), said(&records[2..].to_vec()));
    }
}

#[test]
fn a_journal_without_anything_in_it_is_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    drop(store(dir.path()).0.load().unwrap());
    let (mut store, _) = store(dir.path());
    store.keep(&kinds::snapshot(&kinds::records())).unwrap();
    drop(store);
    assert_eq!(names(dir.path()), [FILE]);
    let (mut store, _) = self::store(dir.path());
    store.keep(&kinds::snapshot(&kinds::records())).unwrap();
    assert_eq!(names(dir.path()), [FILE, "journal.redb.old-1"], "a snapshot is something, too");
}

#[test]
fn a_journal_that_is_damaged_or_in_use_is_never_put_aside_by_a_snapshot() {
    let dir = written();
    let (mut first, _) = store(dir.path());
    first.load().unwrap();
    let refused = store(dir.path()).0.keep(&kinds::snapshot(&[])).unwrap_err();
    assert_eq!(refused.unusable, Unusable::InUse, "{refused}");
    let (mut second, opener) = store(dir.path());
    *opener.faults.unwritable.lock() = Some(EIO);
    let refused = second.keep(&kinds::snapshot(&[])).unwrap_err();
    assert_eq!(refused.unusable, Unusable::InUse, "{refused}");
    drop(first);
    let mut bytes = fs::read(dir.path().join(FILE)).unwrap();
    bytes.truncate(5000);
    fs::write(dir.path().join(FILE), &bytes).unwrap();
    let refused = store(dir.path()).0.keep(&kinds::snapshot(&[])).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
    assert_eq!(names(dir.path()), [FILE]);
}

#[test]
fn a_journal_keeps_its_name_until_the_next_one_is_whole() {
    let (dir, records) = (written(), kinds::records());
    let before = fs::read(dir.path().join(FILE)).unwrap();
    let (mut store, opener) = store(dir.path());
    *opener.faults.unwritable.lock() = Some(EIO);
    assert!(store.load().is_err());
    for writes in 0.. {
        assert!(writes < 200, "a new journal needs no {writes} writes");
        *opener.faults.write.lock() = Some((writes, ENOSPC));
        let refused = store.keep(&kinds::snapshot(&records)).unwrap_err();
        assert_eq!(refused.unusable, Unusable::Now, "{refused}");
        if opener.faults.write.lock().take().is_some() {
            break;
        }
        assert!(fs::read(dir.path().join(FILE)).unwrap() == before, "after {writes} writes");
        assert!(!names(dir.path()).contains(&"journal.redb.old-1".to_owned()));
    }
    assert!(fs::read(dir.path().join("journal.redb.old-1")).unwrap() == before);
    assert_eq!(fold(&loaded(dir.path())), kinds::snapshot(&records).wanted);
}

#[test]
fn a_journal_that_can_only_be_read_is_loaded_and_written_when_it_can_be() {
    for error in [EROFS, EACCES] {
        let (dir, records) = (written(), kinds::records());
        let before = fs::read(dir.path().join(FILE)).unwrap();
        let (mut store, opener) = store(dir.path());
        *opener.faults.unwritable.lock() = Some(error);
        assert_eq!(said(&store.load().unwrap().records), said(&records));
        for _ in 0..2 {
            let refused = store.append(&records[..1]).unwrap_err();
            assert_eq!(refused.unusable, Unusable::Now, "{refused}");
            assert_eq!(store.keep(&kinds::snapshot(&records)).unwrap_err().unusable, Unusable::Now);
        }
        assert!(fs::read(dir.path().join(FILE)).unwrap() == before);
        assert_eq!(names(dir.path()), [FILE]);
        *opener.faults.unwritable.lock() = None;
        store.append(&records[..1]).unwrap();
        drop(store);
        assert_eq!(loaded(dir.path()).records.len(), records.len() + 1);
    }
}

#[test]
fn a_journal_that_another_process_wrote_meanwhile_is_not_gone_on_with() {
    let (dir, records) = (written(), kinds::records());
    let (mut store, opener) = store(dir.path());
    *opener.faults.unwritable.lock() = Some(EROFS);
    store.load().unwrap();
    let (mut other, _) = self::store(dir.path());
    other.load().unwrap();
    other.append(&records[..1]).unwrap();
    *opener.faults.unwritable.lock() = None;
    assert_eq!(store.append(&records[..1]).unwrap_err().unusable, Unusable::InUse);
    drop(other);
    let refused = store.append(&records[..1]).unwrap_err();
    assert_eq!(refused.unusable, Unusable::Damaged, "{refused}");
    assert_eq!(loaded(dir.path()).records.len(), records.len() + 1, "nothing of the other is cut");
}

#[test]
fn a_journal_that_cannot_be_opened_for_lack_of_room_is_loaded_all_the_same() {
    let (dir, records) = (written(), kinds::records());
    let (mut store, opener) = store(dir.path());
    *opener.faults.write.lock() = Some((0, ENOSPC));
    let read = store.load().unwrap();
    assert!(opener.faults.write.lock().is_none(), "opening writes");
    assert_eq!(said(&read.records), said(&records));
    store.append(&records[..1]).unwrap();
    drop(store);
    assert_eq!(loaded(dir.path()).records.len(), records.len() + 1);
}

#[test]
fn a_file_that_is_too_long_is_not_called_damaged() {
    let dir = tempfile::tempdir().unwrap();
    let file = fs::File::create(dir.path().join(FILE)).unwrap();
    file.set_len(MOST + 1).unwrap();
    let (mut store, _) = store(dir.path());
    let refused = store.load().unwrap_err();
    assert_eq!(refused.unusable, Unusable::Now, "{refused}");
    let sizes = [MOST, MOST + 1].map(|size| size.to_string());
    assert!(sizes.iter().all(|size| refused.why.contains(size)), "{refused}");
    assert_eq!(View::open(dir.path()).err().unwrap().error, refused);
    store.keep(&kinds::snapshot(&kinds::records())).unwrap();
    drop(store);
    assert_eq!(names(dir.path()), [FILE, "journal.redb.old-1"]);
    assert_eq!(fold(&loaded(dir.path())), kinds::snapshot(&kinds::records()).wanted);
}

/// The database panics at each write of a commit in turn, until the commit needs no more writes.
#[test]
fn a_database_that_panics_is_opened_again_and_nothing_is_there_twice() {
    for kept in [false, true] {
        let (dir, records) = (tempfile::tempdir().unwrap(), kinds::records());
        let (mut store, opener) = store(dir.path());
        store.load().unwrap();
        let add = |store: &mut RedbStore| match kept {
            true => store.keep(&kinds::snapshot(&records)),
            false => store.append(&records[..2]),
        };
        let mut count = 0;
        for writes in 0.. {
            assert!(writes < 200, "a commit needs no {writes} writes");
            *opener.faults.panic.lock() = Some(writes);
            let added = add(&mut store);
            let panicked = opener.faults.panic.lock().take().is_none();
            if let Err(e) = &added {
                assert_eq!(e.unusable, Unusable::Now, "{e}");
                assert!(e.why.contains("panicked"), "{e}");
                add(&mut store).unwrap();
            }
            count += 2;
            if !panicked {
                break;
            }
        }
        assert!(count > 4, "no write panicked");
        drop(store);
        assert_eq!(loaded(dir.path()).records.len(), if kept { 0 } else { count });
        View::open(dir.path()).unwrap().verify().unwrap();
    }
}

#[test]
fn a_file_over_which_the_database_panicked_is_looked_at_before_it_is_gone_on_with() {
    let (dir, records) = (written(), kinds::records());
    let (mut store, opener) = store(dir.path());
    *opener.faults.panic.lock() = Some(0);
    assert_eq!(said(&store.load().unwrap().records), said(&records), "a panic while it is opened");
    store.append(&records[..1]).unwrap();
    *opener.faults.panic.lock() = Some(0);
    assert_eq!(store.append(&records[..1]).unwrap_err().unusable, Unusable::Now);
    fs::File::options().write(true).open(dir.path().join(FILE)).unwrap().set_len(5000).unwrap();
    assert_eq!(store.append(&records[..1]).unwrap_err().unusable, Unusable::Damaged);
}

fn long(bytes: usize) -> Record {
    let asked = Asked { text: "x".repeat(bytes), ..Asked::default() };
    Record { asked: Some(asked), ..kinds::records().remove(0) }
}

#[test]
fn no_more_records_are_added_than_are_read_again_until_a_snapshot_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let bounds = Bounds { records: 10, bytes: 20_000, unfolded: 100_000 };
    let mut store = RedbStore::new(dir.path()).with(Opener::default(), bounds);
    store.load().unwrap();
    let records = vec![long(10_000); 4];
    store.append(&records).unwrap();
    store.append(&records).unwrap();
    for _ in 0..2 {
        let refused = store.append(&records).unwrap_err();
        assert_eq!(refused.unusable, Unusable::Now, "{refused}");
        assert!(refused.why.contains("100000"), "{refused}");
    }
    store.keep(&kinds::snapshot(&records)).unwrap();
    store.append(&records).unwrap();
    drop(store);
    assert_eq!(loaded(dir.path()).records.len(), 4);
    assert_eq!(View::open(dir.path()).unwrap().verify().unwrap().last, 12);
}
