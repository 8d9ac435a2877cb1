//! Readers of a state table that are lapped while they read, and readers that ask for a time: every lost row
//! is counted, and no answer is another row's.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use trocar_rt::state::{Miss, RowInfo, StateReader, StateWriter, state_table};

/// Row `n` holds its number twice and is of tick `2 n`.
fn publish(writer: &mut StateWriter, n: u64, stamp_ns: u64) {
    writer.publish(stamp_ns, 2 * n, |row| row.fill(n as u8));
}

fn whole(info: RowInfo, row: &[u8]) -> bool {
    info.tick == 2 * info.row && row.iter().all(|byte| *byte == info.row as u8)
}

#[test]
fn a_reader_of_a_row_that_was_lapped_is_told_so_and_never_gets_the_one_in_its_place() {
    let (mut writer, reader) = state_table(5, 4);
    (0..10).for_each(|n| publish(&mut writer, n, n));
    let mut row = [0; 5];
    for n in 0..6 {
        assert_eq!(reader.row(n, &mut row), Err(Miss::Lapped), "row {n} lay where row {} is", n + 4);
    }
    for n in 6..10 {
        assert_eq!(reader.row(n, &mut row).map(|info| info.row), Ok(n));
        assert_eq!(row, [n as u8; 5]);
    }
    assert_eq!(reader.row(10, &mut row), Err(Miss::NotYet));
}

#[test]
fn a_collector_that_is_lapped_in_the_middle_of_a_batch_skips_what_went_and_counts_it() {
    let (mut writer, reader) = state_table(1, 4);
    (0..4).for_each(|n| publish(&mut writer, n, n));
    let (mut cursor, mut seen) = (0, Vec::new());
    let lost = reader.read_batch(&mut cursor, &mut [0], |info, _| {
        seen.push(info.row);
        if info.row == 0 {
            // Goes round the whole ring, and half of it again, while row 0 is looked at.
            (4..10).for_each(|n| publish(&mut writer, n, n));
        }
    });
    assert_eq!((seen.as_slice(), lost, cursor), (&[0][..], 5, 6), "rows 1 to 5 are gone");
    let lost = reader.read_batch(&mut cursor, &mut [0], |info, _| seen.push(info.row));
    assert_eq!((seen.as_slice(), lost, cursor), (&[0, 6, 7, 8, 9][..], 0, 10));
}

/// Tables whose stamps never decrease: how many rows are kept, and how far each is from the one before, ns.
fn stamps() -> impl Strategy<Value = (usize, Vec<u64>)> {
    (3..9usize, prop::collection::vec(0..6u64, 0..30))
}

/// A table with one row for each step, and the stamps of all rows.
fn table(rows: usize, steps: &[u64]) -> (StateReader, Vec<u64>) {
    let (mut writer, reader) = state_table(3, rows);
    let mut stamps = Vec::new();
    for (n, step) in (0..).zip(steps) {
        stamps.push(stamps.last().unwrap_or(&10) + step);
        publish(&mut writer, n, *stamps.last().unwrap());
    }
    (reader, stamps)
}

proptest! {
    #[test]
    fn what_a_collector_sees_and_what_it_lost_are_all_rows_whenever_it_is_lapped(
        rows in 3..7usize,
        before in 0..12u64,
        // Number of rows published while each row is looked at, batch by batch.
        meanwhile in prop::collection::vec(prop::collection::vec(0..9u64, 0..8), 1..8),
    ) {
        let (mut writer, reader) = state_table(2, rows);
        let mut published = 0;
        let mut more = |published: &mut u64, n: u64| {
            (0..n).for_each(|i| publish(&mut writer, *published + i, *published + i));
            *published += n;
        };
        more(&mut published, before);
        let (mut cursor, mut seen, mut lost) = (0, Vec::new(), 0);
        for batch in meanwhile {
            let mut batch = batch.into_iter();
            lost += reader.read_batch(&mut cursor, &mut [0; 2], |info, row| {
                assert!(whole(info, row), "torn or of another row: {info:?}");
                seen.push(info.row);
                more(&mut published, batch.next().unwrap_or(0));
            });
            prop_assert_eq!(seen.len() as u64 + lost, cursor);
        }
        // To the end, undisturbed.
        lost += reader.read_batch(&mut cursor, &mut [0; 2], |info, _| seen.push(info.row));
        prop_assert_eq!((seen.len() as u64 + lost, cursor), (published, published));
        prop_assert!(seen.is_sorted_by(|a, b| a < b), "twice or out of order: {:?}", seen);
    }

    #[test]
    fn the_nearest_row_in_time_is_nearer_than_every_other_one((rows, steps) in stamps(), at in 0..200u64) {
        let (reader, stamps) = table(rows, &steps);
        let oldest = stamps.len().saturating_sub(rows);
        let mut row = [0; 3];
        match reader.at_time(at, &mut row) {
            Ok(info) => {
                prop_assert!(whole(info, &row));
                prop_assert_eq!(info.stamp_ns, stamps[info.row as usize]);
                let distance = info.stamp_ns.abs_diff(at);
                prop_assert!(stamps.iter().all(|stamp| stamp.abs_diff(at) >= distance), "{:?} of {:?}", info, stamps);
            }
            Err(Miss::Empty) => prop_assert!(stamps.is_empty()),
            // The lost rows may have been nearer; that cannot be known any more.
            Err(miss) => prop_assert!(miss == Miss::Lapped && oldest > 0 && at < stamps[oldest]),
        }
    }

    #[test]
    fn the_rows_around_a_time_are_neighbours_and_the_fraction_leads_back_to_it((rows, steps) in stamps(), at in 0..200u64) {
        let (reader, stamps) = table(rows, &steps);
        let oldest = stamps.len().saturating_sub(rows);
        let (mut before, mut after) = ([0; 3], [0; 3]);
        match reader.around(at, &mut before, &mut after) {
            Ok(found) => {
                prop_assert!(whole(found.before, &before) && whole(found.after, &after));
                prop_assert!((0.0..1.0).contains(&found.fraction), "{:?}", found);
                prop_assert!(found.before.stamp_ns <= at && at <= found.after.stamp_ns, "{:?}", found);
                let width = (found.after.stamp_ns - found.before.stamp_ns) as f64;
                prop_assert!((found.before.stamp_ns as f64 + found.fraction * width - at as f64).abs() < 1e-6);
                if found.after.stamp_ns == at {
                    prop_assert_eq!(found.before, found.after);
                } else {
                    prop_assert_eq!(found.before.row + 1, found.after.row);
                }
            }
            Err(Miss::Empty) => prop_assert!(stamps.is_empty()),
            Err(Miss::NotYet) => prop_assert!(*stamps.last().unwrap() < at),
            Err(Miss::Lapped) => prop_assert!(oldest > 0 && at < stamps[oldest]),
            Err(Miss::Missing) => prop_assert!(oldest == 0 && at < stamps[0]),
        }
    }

    #[test]
    fn stamps_that_go_back_never_panic_a_reader(
        rows in 3..9usize,
        stamps in prop::collection::vec(prop_oneof![0..50u64, Just(u64::MAX)], 0..30),
        at in prop_oneof![0..60u64, Just(u64::MAX)],
    ) {
        let (mut writer, reader) = state_table(3, rows);
        for (n, stamp) in (0..).zip(&stamps) {
            publish(&mut writer, n, *stamp);
        }
        let (mut before, mut after) = ([0; 3], [0; 3]);
        if let Ok(info) = reader.at_time(at, &mut before) {
            prop_assert!(whole(info, &before));
        }
        if let Ok(found) = reader.around(at, &mut before, &mut after) {
            prop_assert!((0.0..1.0).contains(&found.fraction), "{:?}", found);
        }
    }
}
