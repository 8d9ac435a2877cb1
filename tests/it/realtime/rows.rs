//! Rows of a state table that the ring still has, and those it has overwritten.
//!
//! Promise: whoever asks for a row gets that row, whole, or is told that it is gone and which ones there are.

use serde_json::{Value, json};
use trocar_tests::{Failure, eventually, number};

use super::Scene;

/// Stamp, number, value and whole row.
fn of(row: &Value) -> (u64, u64, f64) {
    (number(&row["stampNs"]), number(&row["seq"]), row["json"]["half"].as_f64().unwrap_or_default())
}

#[track_caller]
fn is_whole(row: &Value) {
    let (steps, half) = (number(&row["json"]["steps"]), row["json"]["half"].as_f64());
    assert_eq!(half, Some(steps as f64 / 2.0), "of one step: {row}");
}

/// Refused for this reason, and with the rows that are kept.
#[track_caller]
fn is_refused(answer: Result<Value, Failure>, field: &str, why: &str, kept: &str) {
    let refused = match answer {
        Err(refused) => refused,
        Ok(answer) => panic!("{field} should be refused because {why}: {answer}"),
    };
    assert_eq!(
        (refused.code, refused.reason.as_str()),
        ("INVALID_ARGUMENT", "ARGUMENT_INVALID"),
        "{refused}"
    );
    assert_eq!(refused.violated_fields(), [field], "{refused}");
    assert!(refused.message.contains(why) && refused.message.contains(kept), "{why}, {kept}: {refused}");
}

#[test]
fn each_row_that_is_kept_is_answered_and_each_that_was_overwritten_is_refused() {
    const KEPT: u64 = 16;
    let scene = Scene::new();
    scene.pace("host/p", json!({ "rate_hz": 1000, "history": KEPT }), json!({}));
    scene.until("host/p", "steps", 4 * KEPT);
    scene.grpc.stop("host/p");

    let rows: Vec<Value> =
        (0..KEPT).map(|k| scene.ask("host/p", "delayed", k).unwrap_or_else(|e| panic!("{k}: {e}"))).collect();
    rows.iter().for_each(is_whole);
    assert_eq!(of(&rows[0]), of(&scene.newest("host/p")), "the newest is 0 rows before itself");
    assert!(rows.windows(2).all(|w| of(&w[0]) > of(&w[1])), "older ones are earlier: {rows:#?}");
    let ((new_ns, new, _), (old_ns, old, _)) = (of(&rows[0]), of(&rows[KEPT as usize - 1]));
    let kept = format!("kept are {KEPT} rows: ticks {old} to {new}, {old_ns} to {new_ns} ns");

    for row in &rows {
        let (stamp, tick, half) = of(row);
        let found = scene.ask("host/p", "tick", tick).unwrap();
        assert_eq!((of(&found).1, of(&found).2), (tick, half), "by its tick: {found}");
        for which in ["at_ns", "nearest_ns"] {
            assert_eq!(of(&scene.ask("host/p", which, stamp).unwrap()), (stamp, tick, half), "by {which}");
        }
    }
    for (after, before) in rows.windows(2).map(|w| (of(&w[0]), of(&w[1]))).filter(|(a, b)| a.2 > b.2) {
        let at = before.0 + (after.0 - before.0) / 4;
        let expected = before.2 + (after.2 - before.2) * (at - before.0) as f64 / (after.0 - before.0) as f64;
        let between = scene.ask("host/p", "at_ns", at).unwrap();
        let (stamp, tick, half) = of(&between);
        assert_eq!((stamp, tick), (at, before.1), "{between}");
        assert!((half - expected).abs() < 1e-9, "{expected} lies between: {between}");
        assert_eq!(of(&scene.ask("host/p", "nearest_ns", at).unwrap()), before, "nearer to the earlier one");
    }

    let gone = "it has been overwritten";
    is_refused(scene.ask("host/p", "delayed", KEPT), "delayed", gone, &kept);
    for tick in [1, old / 2, old - 1] {
        is_refused(scene.ask("host/p", "tick", tick), "tick", gone, &kept);
    }
    for time in [1, old_ns - 1] {
        is_refused(scene.ask("host/p", "at_ns", time), "at_ns", gone, &kept);
        is_refused(scene.ask("host/p", "nearest_ns", time), "nearest_ns", gone, &kept);
    }
    let later = "it is not there yet";
    is_refused(scene.ask("host/p", "delayed", u64::MAX), "delayed", later, &kept);
    is_refused(scene.ask("host/p", "tick", new + 1), "tick", later, &kept);
    is_refused(scene.ask("host/p", "at_ns", new_ns + 1), "at_ns", later, &kept);
    let nearest = scene.ask("host/p", "nearest_ns", u64::MAX).unwrap();
    assert_eq!(of(&nearest), of(&rows[0]), "nothing is nearer than the newest");
}

#[test]
fn a_reader_that_the_ring_has_lapped_is_told_so_while_it_turns() {
    let scene = Scene::new();
    scene.pace("host/p", json!({ "rate_hz": 1000, "history": 3 }), json!({}));
    scene.until("host/p", "steps", 10);
    for _ in 0..20 {
        let row = scene.newest("host/p");
        is_whole(&row);
        let tick = number(&row["seq"]);
        // Rows are numbered by periods: one that was skipped has a number and is no step.
        eventually("four rows more", || match number(&scene.newest("host/p")["seq"]) {
            newest if newest >= tick + 4 => Ok(()),
            newest => Err(newest),
        });
        // Three rows are kept, and four came after it.
        is_refused(scene.ask("host/p", "tick", tick), "tick", "it has been overwritten", "kept are 3 rows");
        is_refused(
            scene.ask("host/p", "at_ns", number(&row["stampNs"])),
            "at_ns",
            "it has been overwritten",
            "kept are 3 rows",
        );
    }
}

#[test]
fn no_row_is_torn_and_none_is_another_one_however_close_the_writer_is() {
    let scene = Scene::new();
    scene.pace("host/p", json!({ "rate_hz": 10_000, "history": 3 }), json!({}));
    scene.until("host/p", "steps", 100);
    let (mut answered, mut refused) = (0, 0);
    for round in 0..100 {
        match scene.ask("host/p", "delayed", round % 3) {
            Ok(row) => {
                is_whole(&row);
                assert_eq!(number(&row["seq"]), number(&row["json"]["cycle"]) + 1, "{row}");
                answered += 1;
            }
            Err(lapped) => {
                assert!(lapped.message.contains("it has been overwritten"), "{lapped}");
                refused += 1;
            }
        }
    }
    assert!(answered > 0 && answered + refused == 100, "{answered} answered, {refused} refused");
}

#[test]
fn before_the_first_step_there_is_what_it_was_made_with_and_nothing_was_overwritten() {
    let scene = Scene::new();
    scene.grpc.create("host/p", "pace", json!({}));
    for (which, value) in [("tick", 0), ("delayed", 0), ("nearest_ns", 1)] {
        let row = scene.ask("host/p", which, value).unwrap();
        assert_eq!((number(&row["seq"]), number(&row["json"]["steps"])), (0, 0), "{which}: {row}");
    }
    is_refused(scene.ask("host/p", "tick", 1), "tick", "it is not there yet", "ticks 0 to 0");
    is_refused(scene.ask("host/p", "at_ns", 1), "at_ns", "there is no such row", "ticks 0 to 0");
    scene.grpc.start("host/p");
    let first = eventually("the row of the first step", || scene.ask("host/p", "tick", 1));
    assert_eq!(number(&first["json"]["steps"]), 1, "{first}");
}

#[test]
fn rows_go_on_where_they_were_after_a_fresh_start_so_that_earlier_ones_stay_to_be_read() {
    let scene = Scene::new();
    scene.pace("host/p", json!({ "rate_hz": 1000, "history": 65_536 }), json!({}));
    scene.until("host/p", "steps", 20);
    scene.grpc.stop("host/p");
    let before = scene.newest("host/p");
    scene.grpc.start("host/p");
    scene.until("host/p", "steps", number(&before["json"]["steps"]) + 20);
    let after = scene.newest("host/p");
    assert!(number(&after["seq"]) > number(&before["seq"]), "{before} {after}");
    assert!(number(&after["json"]["cycle"]) < number(&after["seq"]) - 1, "cycles count from Start: {after}");
    let again = scene.ask("host/p", "tick", number(&before["seq"])).unwrap();
    assert_eq!(again["json"], before["json"]);
}
