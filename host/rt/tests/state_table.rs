//! The state table promises whole rows, honest misses, and an exact count of what a collector lost.
#![allow(clippy::unwrap_used)]

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::state::{Miss, RowInfo, StateWriter, state_table};

fn publish(writer: &mut StateWriter, n: u64) {
    writer.publish(1000 * n, 2 * n, |row| row.fill(n as u8));
}

fn filled(rows: usize, n: u64) -> (StateWriter, trocar_rt::StateReader) {
    let (mut writer, reader) = state_table(5, rows);
    (0..n).for_each(|n| publish(&mut writer, n));
    (writer, reader)
}

#[test]
fn an_empty_table_has_no_row() {
    let (_writer, reader) = state_table(8, 3);
    let mut out = [0; 8];
    assert_eq!(reader.latest(&mut out), None);
    assert_eq!(reader.delayed(0, &mut out), Err(Miss::Empty));
    assert_eq!(reader.at_tick(0, &mut out), Err(Miss::Empty));
    assert_eq!(reader.at_time(0, &mut out), Err(Miss::Empty));
    assert_eq!(reader.row(0, &mut out), Err(Miss::Empty));
}

#[test]
fn the_newest_row_is_read_with_its_stamp_tick_and_number() {
    let (_writer, reader) = filled(4, 6);
    let mut out = [0; 5];
    assert_eq!(reader.latest(&mut out), Some(RowInfo { stamp_ns: 5000, tick: 10, row: 5 }));
    assert_eq!(out, [5; 5]);
}

#[test]
fn rows_without_bytes_still_carry_stamp_and_tick() {
    let (mut writer, reader) = state_table(0, 3);
    writer.publish(7, 9, |row| assert!(row.is_empty()));
    assert_eq!(reader.latest(&mut []), Some(RowInfo { stamp_ns: 7, tick: 9, row: 0 }));
    let mut seen = 0;
    assert_eq!(reader.read_batch(&mut 0, &mut [], |_, row| seen += 1 + row.len()), 0);
    assert_eq!(seen, 1);
}

#[test]
fn a_short_buffer_takes_the_first_bytes_of_a_row() {
    let (mut writer, reader) = state_table(12, 3);
    writer.publish(0, 0, |row| row.copy_from_slice(b"abcdefghijkl"));
    let mut out = [0; 10];
    reader.latest(&mut out).unwrap();
    assert_eq!(&out, b"abcdefghij");
    let mut long = [b'.'; 14];
    reader.latest(&mut long).unwrap();
    assert_eq!(&long, b"abcdefghijkl..", "bytes after the row are left alone");
}

#[test]
fn a_tick_is_found_missing_lapped_or_not_yet() {
    let (_writer, reader) = filled(4, 10);
    let mut out = [0; 5];
    assert_eq!(reader.at_tick(14, &mut out).map(|i| i.row), Ok(7));
    assert_eq!(out, [7; 5]);
    assert_eq!(reader.at_tick(15, &mut out), Err(Miss::Missing), "only even ticks were published");
    assert_eq!(reader.at_tick(4, &mut out), Err(Miss::Lapped));
    assert_eq!(reader.at_tick(20, &mut out), Err(Miss::NotYet));
}

#[test]
fn the_row_nearest_in_time_is_found() {
    let (_writer, reader) = filled(4, 10);
    let mut out = [0; 5];
    assert_eq!(reader.at_time(7400, &mut out).map(|i| i.row), Ok(7));
    assert_eq!(reader.at_time(7600, &mut out).map(|i| i.row), Ok(8));
    assert_eq!(reader.at_time(99_000, &mut out).map(|i| i.row), Ok(9), "after the newest: the newest");
    assert_eq!(reader.at_time(3000, &mut out), Err(Miss::Lapped));
    let (_writer, young) = filled(4, 2);
    assert_eq!(young.at_time(0, &mut out).map(|i| i.row), Ok(0), "nothing was overwritten yet");
}

#[test]
fn the_rows_around_a_time_are_found_with_the_share_between_them() {
    let (_writer, reader) = filled(4, 10);
    let (mut before, mut after) = ([0; 5], [0; 5]);
    let found = reader.around(7250, &mut before, &mut after).unwrap();
    assert_eq!((found.before.row, found.after.row, found.fraction), (7, 8, 0.25));
    assert_eq!((before, after), ([7; 5], [8; 5]));
    let exact = reader.around(8000, &mut before, &mut after).unwrap();
    assert_eq!((exact.before, exact.after, exact.fraction), (exact.after, exact.before, 0.0));
    assert_eq!((before, after), ([8; 5], [8; 5]));
    assert_eq!(reader.around(6000, &mut before, &mut after).map(|a| a.before.row), Ok(6), "the oldest kept");
    assert_eq!(reader.around(5999, &mut before, &mut after), Err(Miss::Lapped));
    assert_eq!(reader.around(9001, &mut before, &mut after), Err(Miss::NotYet));
    let (mut young, reader) = state_table(5, 4);
    assert_eq!(reader.around(0, &mut before, &mut after), Err(Miss::Empty));
    young.publish(50, 0, |row| row.fill(1));
    assert_eq!(reader.around(49, &mut before, &mut after), Err(Miss::Missing), "before the first row ever");
}

#[test]
fn delayed_counts_back_from_the_newest() {
    let (_writer, reader) = filled(4, 10);
    let mut out = [0; 5];
    assert_eq!(reader.delayed(0, &mut out).map(|i| i.row), Ok(9));
    assert_eq!(reader.delayed(3, &mut out).map(|i| i.row), Ok(6));
    assert_eq!(reader.delayed(4, &mut out), Err(Miss::Lapped));
    assert_eq!(reader.delayed(10, &mut out), Err(Miss::NotYet), "so many were never published");
}

#[test]
fn a_fill_that_panics_publishes_nothing() {
    let (mut writer, reader) = filled(3, 1);
    let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        writer.publish(1, 1, |_| panic!("on purpose"));
    }));
    assert!(panicked.is_err());
    assert_eq!(reader.published(), 1);
}

#[test]
#[should_panic(expected = "at least 3 rows")]
fn fewer_than_three_rows_are_refused() {
    state_table(8, 2);
}

#[test]
fn readers_beside_a_running_writer_never_see_a_torn_row() {
    const WORDS: usize = 37;
    let (mut writer, reader) = state_table(WORDS * 8, 3);
    let stop = AtomicBool::new(false);
    let check = |info: RowInfo, row: &[u8]| {
        let words = row.as_chunks::<8>().0;
        assert!(words.iter().all(|w| u64::from_ne_bytes(*w) == info.tick), "torn row at {info:?}");
        assert_eq!((info.stamp_ns, info.row), (info.tick * 3, info.tick));
    };
    thread::scope(|scope| {
        for _ in 0..2 {
            let reader = reader.clone();
            scope.spawn(|| {
                let reader = reader;
                let (mut row, mut other) = (vec![0; WORDS * 8], vec![0; WORDS * 8]);
                let mut cursor = 0;
                let (mut seen, mut lost) = (0, 0);
                while !stop.load(Ordering::Relaxed) {
                    if let Some(info) = reader.latest(&mut row) {
                        check(info, &row);
                    }
                    if let Ok(info) = reader.delayed(1, &mut row) {
                        check(info, &row);
                    }
                    if let Ok(found) =
                        reader.around((reader.published() * 3).saturating_sub(4), &mut row, &mut other)
                    {
                        check(found.before, &row);
                        check(found.after, &other);
                        assert!((0.0..1.0).contains(&found.fraction), "{found:?}");
                        assert!(found.after.row - found.before.row <= 1, "{found:?}");
                    }
                    lost += reader.read_batch(&mut cursor, &mut row, |info, row| {
                        check(info, row);
                        seen += 1;
                    });
                }
                assert_eq!(seen + lost, cursor, "every row is seen or counted as lost");
            });
        }
        for n in 0..200_000u64 {
            writer.publish(n * 3, n, |row| {
                row.as_chunks_mut::<8>().0.iter_mut().for_each(|w| *w = n.to_ne_bytes());
            });
        }
        stop.store(true, Ordering::Relaxed);
    });
}

proptest! {
    #[test]
    fn a_collector_knows_exactly_what_it_missed(rows in 3..9usize, bursts in prop::collection::vec(0..20u64, 1..20)) {
        let (mut writer, reader) = state_table(1, rows);
        let (mut cursor, mut published) = (0, 0);
        for burst in bursts {
            (0..burst).for_each(|i| publish_one(&mut writer, published + i));
            published += burst;
            let before = cursor;
            let mut seen = Vec::new();
            let lost = reader.read_batch(&mut cursor, &mut [0], |info, row| {
                assert_eq!(row[0], info.row as u8);
                seen.push(info.row);
            });
            let kept = burst.min(rows as u64);
            prop_assert_eq!(lost, burst - kept);
            prop_assert_eq!(seen, (before + lost..published).collect::<Vec<_>>());
            prop_assert_eq!(cursor, published);
        }
    }
}

fn publish_one(writer: &mut StateWriter, n: u64) {
    writer.publish(n, n, |row| row[0] = n as u8);
}
