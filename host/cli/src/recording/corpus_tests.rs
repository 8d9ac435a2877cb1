//! The fuzz target of reading: the corpus of `tests/data/recordings`, as it is and changed in any way.
//!
//! Invariant: each file is answered or refused in a sentence, never by a panic, and within the bounds of
//! cost. `TROCAR_SEEDS=n` plays n times as many changes, as `./tests/run --all` does.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Parser;
use indicatif::ProgressBar;
use proptest::prelude::*;

use super::export::{ExportArgs, export};
use super::info::{Counted, InfoView, look};
use super::sink::{Bounds, ExportView};
use crate::failure::Failure;

/// Returns the recordings by name, without their ending.
fn corpus() -> BTreeMap<String, Vec<u8>> {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/recordings");
    let files = std::fs::read_dir(place).expect("the corpus").map(|file| file.expect("a file").path());
    let recordings = files.filter(|path| path.extension().is_some_and(|end| end == "mcap"));
    let read = |path: PathBuf| {
        (path.file_stem().unwrap().to_str().unwrap().to_owned(), std::fs::read(&path).unwrap())
    };
    recordings.map(read).collect()
}

#[derive(Parser)]
struct Words {
    #[command(flatten)]
    args: ExportArgs,
}

/// All that the program does with a recording.
struct Seen {
    info: Result<InfoView, Failure>,
    exports: BTreeMap<&'static str, Result<ExportView, Failure>>,
    tables: Vec<String>,
}

fn see(bytes: &[u8]) -> Seen {
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("a.mcap");
    std::fs::write(&path, bytes).expect("a file");
    let file = path.to_str().expect("a name");
    let each = ["--csv", "--npz", "--png"].map(|how| {
        let args = Words::try_parse_from(["export", file, how]).expect("words").args;
        (how, export(&args, &dir.path().join(&how[2..]), &ProgressBar::hidden()))
    });
    let written = std::fs::read_dir(dir.path().join("csv")).into_iter().flatten();
    let tables = written.map(|table| std::fs::read_to_string(table.unwrap().path()).unwrap()).collect();
    Seen { info: look(&path, &ProgressBar::hidden()), exports: each.into(), tables }
}

/// Checks what holds for each recording, whatever is in it.
fn answered(name: &str, len: usize, seen: &Seen) {
    let failures =
        seen.exports.values().filter_map(|done| done.as_ref().err()).chain(seen.info.as_ref().err());
    for failure in failures {
        assert_ne!(failure.reason, "UNREADABLE", "{name}: a fault of ours: {}", failure.message);
        assert!((10..6000).contains(&failure.message.len()), "{name}: {}", failure.message);
    }
    for view in seen.exports.values().flatten() {
        assert!(Bounds::of(len as u64).steps(view.steps).is_ok(), "{name}: {} steps", view.steps);
    }
}

#[test]
fn each_recording_of_the_corpus_is_answered() {
    let all = corpus();
    assert!(all.len() >= 15, "{:?}", all.keys());
    for (name, bytes) in &all {
        answered(name, bytes.len(), &see(bytes));
    }
}

#[test]
fn a_type_that_holds_itself_has_the_columns_of_what_came() {
    let seen = see(&corpus()["recursive"]);
    assert_eq!(seen.tables.len(), 1);
    let table: Vec<&str> = seen.tables[0].lines().collect();
    assert_eq!(table, ["log_time_ns,publish_time_ns,sequence,x", "1,1,1,1", "2,2,2,2"]);
    let view = seen.exports["--csv"].as_ref().expect("it is written");
    assert_eq!((view.messages, view.unplaced, view.unreadable), (2, 1, 0), "the inner value is counted");
}

#[test]
fn a_type_of_many_inner_types_is_looked_at_no_longer_than_its_bytes_allow() {
    let all = corpus();
    for name in ["branching", "long-chain"] {
        let seen = see(&all[name]);
        let view = seen.exports["--csv"].as_ref().expect("it is written");
        assert!(view.messages > 0 && view.steps < 20_000 * view.messages, "{name}: {} steps", view.steps);
    }
}

#[test]
fn nothing_of_a_chunk_is_written_whose_checksum_is_another_one() {
    let seen = see(&corpus()["flipped"]);
    let view = seen.exports["--csv"].as_ref().expect("the rest is written");
    assert!(
        view.wrong.contains("1 chunk left out: near byte") && view.wrong.contains("checksum"),
        "{}",
        view.wrong
    );
    assert!(view.wrong.contains("1 message left out"), "its channel was in the chunk: {}", view.wrong);
    assert_eq!(seen.tables, ["log_time_ns,publish_time_ns,sequence,x\n12,12,12,12\n"]);
}

#[test]
fn messages_in_chunks_that_are_not_read_are_counted_as_the_file_says_or_not_at_all() {
    let all = corpus();
    let of = |name: &str| see(&all[name]).info.expect("it is read");
    let told = of("compressed");
    assert_eq!((told.messages, told.counted, told.topics[0].messages), (200, Counted::Told, 200));
    assert!(told.wrong.contains("zstd"), "{}", told.wrong);
    assert_eq!(of("compressed-uncounted").counted, Counted::Part);
    assert_eq!((of("good").counted, of("good").messages), (Counted::Read, 10));
}

#[test]
fn a_description_that_cannot_be_used_is_named_as_the_reason() {
    let all = corpus();
    for (name, wanted) in [("long-name", "a name of 5000 B"), ("unknown-syntax", "contradicts itself")] {
        let failure = see(&all[name]).exports.remove("--csv").unwrap().expect_err("nothing can be read");
        assert!(failure.message.contains(wanted), "{name}: {}", failure.message);
    }
}

#[test]
fn arrays_over_the_limit_for_the_size_of_the_file_are_refused() {
    let bounds = Bounds::of(3 << 20);
    assert!(bounds.memory(300 << 20).is_ok());
    let failure = bounds.memory(1 << 30).expect_err("a gigabyte of three megabytes");
    assert_eq!(failure.reason, "TOO_LARGE");
    assert!(
        Bounds::of(u64::MAX).memory(usize::MAX).is_err() && Bounds::of(u64::MAX).written(u64::MAX).is_ok()
    );
}

/// A place in a file as a part of it, and what is done there.
#[derive(Clone, Debug)]
enum Change {
    Byte(prop::sample::Index, u8),
    Huge(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    /// A part of another recording is put in.
    Splice(prop::sample::Index, prop::sample::Index, prop::sample::Index),
}

impl Change {
    fn make(&self, bytes: &mut Vec<u8>, all: &[Vec<u8>]) {
        match self {
            Change::Byte(at, byte) => {
                let at = at.index(bytes.len());
                bytes[at] = *byte;
            }
            Change::Huge(at, len) => {
                let at = at.index(bytes.len());
                let end = bytes.len().min(at + usize::from(*len % 9));
                bytes[at..end].fill(0xff);
            }
            Change::Cut(at) => bytes.truncate(at.index(bytes.len()).max(9)),
            Change::Splice(of, from, to) => {
                let other = &all[of.index(all.len())];
                let (from, to) = (from.index(other.len()), to.index(bytes.len()));
                let end = other.len().min(from + 400);
                bytes.splice(to..to, other[from..end].iter().copied());
            }
        }
    }
}

fn change() -> impl Strategy<Value = Change> {
    let place = any::<prop::sample::Index>;
    prop_oneof![
        6 => (place(), any::<u8>()).prop_map(|(at, byte)| Change::Byte(at, byte)),
        2 => (place(), any::<u8>()).prop_map(|(at, len)| Change::Huge(at, len)),
        1 => place().prop_map(Change::Cut),
        2 => (place(), place(), place()).prop_map(|(of, from, to)| Change::Splice(of, from, to)),
    ]
}

/// Returns the number of changed recordings.
fn cases() -> u32 {
    200 * std::env::var("TROCAR_SEEDS").ok().and_then(|n| n.parse::<u32>().ok()).unwrap_or(1)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_recording_with_anything_changed_is_answered(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec(change(), 1..12),
    ) {
        let all: Vec<Vec<u8>> = corpus().into_values().collect();
        let mut bytes = all[which.index(all.len())].clone();
        for change in &changes {
            change.make(&mut bytes, &all);
        }
        answered("changed", bytes.len(), &see(&bytes));
    }
}
