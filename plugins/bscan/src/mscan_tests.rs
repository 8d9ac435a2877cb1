//! The rolling image on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::{PixelFormat, Pose, SampleFormat};
use trocar_sdk::testing::Bench;

const CONFIG: &str = r#"{"rows": 4, "columns": 3, "lines": 2, "image_rate_hz": 100, "range_db": [50, 90]}"#;

fn header(format: SampleFormat, lines: u32, samples: u32) -> AScanHeader {
    AScanHeader { stamp: Stamp::from_ns(1), lines, samples, format, ..AScanHeader::default() }
}

fn newest(bench: &mut Bench<MScan>) -> (ImageHeader, Vec<u8>) {
    let (header, pixels, _) = bench.frames::<ImageHeader>("image").pop().unwrap();
    (header, pixels)
}

#[test]
fn columns_are_means_of_their_a_scans_and_the_newest_is_at_the_right() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    bench.push_frame("ascan", header(SampleFormat::U8, 2, 4), &[10, 0, 0, 1, 20, 0, 0, 2]);
    let decibels: Vec<u8> =
        [90.0f32, 50.0, 70.0, 50.0].repeat(2).iter().flat_map(|db| db.to_ne_bytes()).collect();
    bench.push_frame("ascan", header(SampleFormat::F32, 2, 4), &decibels);
    bench.step(1);
    let (image, pixels) = newest(&mut bench);
    assert_eq!((image.width, image.height, image.stride, image.format), (3, 4, 3, PixelFormat::GRAY8));
    assert_eq!(pixels, [0, 15, 255, 0, 0, 0, 0, 0, 128, 0, 2, 0]);
    assert_eq!((bench.state().seen, bench.state().refused_frames), (4, 0));
}

#[test]
fn what_are_no_a_scans_is_counted_and_the_next_good_one_is_shown() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    let bad = [
        (header(SampleFormat::U8, 2, 4), 7),
        (header(SampleFormat::F32, 1, 4), 4),
        (header(SampleFormat::U8, u32::MAX, u32::MAX), 8),
        (header(SampleFormat::U16, 1, 4), 8),
        (header(SampleFormat(99), 1, 4), 8),
        (AScanHeader { stamp: Stamp::INVALID, ..header(SampleFormat::U8, 2, 4) }, 8),
        (AScanHeader { line_period: f64::NAN, ..header(SampleFormat::U8, 2, 4) }, 8),
        // Its second A-scan is still to come.
        (AScanHeader { stamp: bench.now(), line_period: 0.5, ..header(SampleFormat::U8, 2, 4) }, 8),
    ];
    for (header, len) in bad {
        bench.push_frame("ascan", header, &vec![200; len]);
    }
    bench.step(1);
    assert_eq!((bench.state().seen, bench.state().refused_frames), (0, bad.len() as u64));
    assert!(bench.frames::<ImageHeader>("image").is_empty(), "no news");
    bench.push_frame("ascan", header(SampleFormat::U8, 2, 4), &[8; 8]);
    bench.step(1);
    assert_eq!(newest(&mut bench).1, [0, 0, 8].repeat(4));
}

/// A-scans, distances and poses of two columns: the second one of each pair of A-scans 250 µs after the
/// first.
fn push_all(bench: &mut Bench<MScan>) {
    let at = |ns| Stamp::from_ns(ns);
    for (ns, distance, valid) in
        [(1_000_000, 0.5e-3, true), (1_250_000, 0.6e-3, true), (1_500_000, 0.0, false)]
    {
        let valid = valid.into();
        bench.push("distance", Distance { stamp: at(ns), distance, valid, ..Distance::default() });
    }
    for (ns, x) in [(900_000, 1.0), (1_900_000, 2.0)] {
        let measured_cp = Pose { stamp: at(ns), position: [x, 0.0, 0.0], ..Pose::default() };
        bench.push("robot", ArmState { stamp: at(ns), measured_cp, ..ArmState::default() });
    }
    for ns in [1_000_000, 1_500_000] {
        let header = AScanHeader { stamp: at(ns), line_period: 250e-6, ..header(SampleFormat::U8, 2, 4) };
        bench.push_frame("ascan", header, &[8; 8]);
    }
}

#[test]
fn columns_tell_where_tip_and_surface_were_when_their_first_a_scan_was_taken() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    push_all(&mut bench);
    bench.step(1);
    let columns = bench.outputs::<ScanColumn>("column");
    let told = |c: &ScanColumn| (c.stamp.ns(), c.scan, c.column, c.lines, c.pose.stamp.ns());
    let expected = [(1_000_000, 0, 0, 2, 1_000_000), (1_500_000, 0, 1, 2, 1_500_000)];
    assert_eq!(columns.iter().map(told).collect::<Vec<_>>(), expected);
    assert!((columns[0].pose.position[0] - 1.1).abs() < 1e-12, "{:?}", columns[0].pose);
    assert!((columns[1].pose.position[0] - 1.6).abs() < 1e-12, "{:?}", columns[1].pose);
    assert_eq!(columns[0].distance, 0.5e-3);
    assert!(columns[1].distance.is_nan(), "that A-scan shows no surface");
}

#[test]
fn poses_and_distances_from_ahead_are_counted_and_those_that_follow_are_the_columns() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    let stamp = Stamp::from_ns(bench.now().ns() + 1_000_000_000);
    for stamp in [stamp, Stamp::INVALID] {
        bench.push("distance", Distance { stamp, ..Distance::default() });
        let measured_cp = Pose { stamp, ..Pose::default() };
        bench.push("robot", ArmState { measured_cp, ..ArmState::default() });
    }
    bench.step(1);
    let state = bench.state();
    assert_eq!(
        (state.refused_distances, state.refused_poses),
        (2, 1),
        "stamp 0 is a robot that does not measure"
    );
    push_all(&mut bench);
    bench.step(1);
    let columns = bench.outputs::<ScanColumn>("column");
    assert_eq!((columns[0].pose.stamp, columns[0].distance), (columns[0].stamp, 0.5e-3));
}

#[test]
fn without_robot_and_tracker_columns_have_a_time_and_no_pose() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    bench.connect_input("robot", false);
    bench.connect_input("distance", false);
    push_all(&mut bench);
    bench.step(1);
    let columns = bench.outputs::<ScanColumn>("column");
    assert_eq!(columns.iter().map(|c| c.stamp.ns()).collect::<Vec<_>>(), [1_000_000, 1_500_000]);
    assert!(columns.iter().all(|c| !c.pose.is_valid() && c.distance.is_nan()));
}

#[test]
fn a_start_begins_with_a_black_image_and_column_0() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    push_all(&mut bench);
    bench.push_frame("ascan", header(SampleFormat::U8, 1, 4), &[200; 4]);
    bench.step(1);
    bench.stop().unwrap();
    bench.start().unwrap();
    push_all(&mut bench);
    bench.step(2);
    assert_eq!(bench.outputs::<ScanColumn>("column").last().unwrap().column, 1);
    assert_eq!(newest(&mut bench).1, [0, 8, 8].repeat(4));
}

#[test]
fn images_come_at_their_rate_and_without_a_free_frame_they_are_counted_as_left_out() {
    let mut bench = Bench::<MScan>::new(r#"{"rows": 4, "columns": 3, "image_rate_hz": 25}"#);
    step_with_news(&mut bench, 100);
    assert_eq!(bench.frames::<ImageHeader>("image").len(), 25);
    bench.exhaust("image", true);
    step_with_news(&mut bench, 8);
    assert_eq!(bench.state().left_out, 2);
}

/// Steps, with an A-scan just before each one.
fn step_with_news(bench: &mut Bench<MScan>, steps: usize) {
    for _ in 0..steps {
        let stamp = bench.now();
        bench.push_frame("ascan", AScanHeader { stamp, ..header(SampleFormat::U8, 1, 4) }, &[8; 4]);
        bench.step(1);
    }
}

#[test]
fn images_have_the_time_of_their_newest_a_scan_and_a_silent_oct_sends_none() {
    let mut bench = Bench::<MScan>::new(CONFIG);
    bench.step(10);
    assert!(bench.frames::<ImageHeader>("image").is_empty(), "nothing was seen yet");
    push_all(&mut bench);
    bench.step(1);
    let newest = Stamp::from_ns(1_750_000);
    let images = bench.frames::<ImageHeader>("image");
    assert_eq!(images.iter().map(|(h, _, s)| (h.stamp, *s)).collect::<Vec<_>>(), [(newest, newest)]);
    bench.step(100);
    assert!(bench.frames::<ImageHeader>("image").is_empty(), "the OCT is silent");
    step_with_news(&mut bench, 1);
    assert_eq!(bench.frames::<ImageHeader>("image").len(), 1, "and here again");
}

#[test]
fn a_range_that_is_none_is_refused() {
    let mut bench = Bench::<MScan>::new("{}");
    for range in ["[50, 50]", "[90, 50]"] {
        let refused = bench.configure(format!(r#"{{"range_db": {range}}}"#));
        assert!(refused.unwrap_err().to_string().contains("range_db"), "{range}");
    }
}

#[test]
fn a_step_allocates_nothing() {
    let mut bench = Bench::<MScan>::new("{}");
    bench.assert_no_alloc(|bench| {
        for _ in 0..20 {
            push_all(bench);
            bench.step(5);
        }
    });
}
