//! The tracker on spectra of the phantom, against its truth.

use super::*;
use crate::decibel::SILENT_DB;

const BIN_M: f64 = 3.5e-6;
const LINE_NS: u64 = 250_000;
const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// An A-scan with a surface `distance_m` away.
fn ascan(line: u64, distance_m: Option<f64>) -> Vec<f32> {
    let noise = trocar_phantom::noise::Noise::new(3, 3).part(line);
    let mut bins: Vec<f32> =
        (0..512).map(|i| 40.0 + 10.0 * (-(noise.uniform(i) + 1e-9).ln()).log10() as f32).collect();
    if let Some(distance_m) = distance_m {
        let at = distance_m * 1.336 / BIN_M;
        for (i, db) in bins.iter_mut().enumerate() {
            let off = i as f64 - at;
            *db = db.max((85.0 - 3.0 * off * off) as f32);
        }
    }
    bins
}

fn see(tracker: &mut Tracker, line: u64, distance_m: Option<f64>) -> Reading {
    tracker.see(line * LINE_NS, &ascan(line, distance_m), BIN_M, 0.0)
}

#[test]
fn a_surface_is_believed_after_eight_lines_and_found_once() {
    let mut tracker = Tracker::new(Settings::default());
    let readings: Vec<Reading> = (1..100).map(|line| see(&mut tracker, line, Some(500e-6))).collect();
    assert_eq!(readings.iter().position(|r| r.valid), Some(7));
    assert_eq!(readings.iter().filter(|r| r.change == Change::Found).count(), 1);
    let last = readings[98];
    assert!(
        (last.distance_m - 500e-6).abs() < 0.1e-6 && last.sigma_m < 3e-6 && last.snr_db > 30.0,
        "{last:?}"
    );
}

#[test]
fn a_surface_that_goes_is_invalid_at_once_and_lost_once_after_fifty_milliseconds() {
    let mut tracker = Tracker::new(Settings::default());
    (1..100).for_each(|line| _ = see(&mut tracker, line, Some(500e-6)));
    let gone: Vec<Reading> = (100..600).map(|line| see(&mut tracker, line, None)).collect();
    assert!(gone.iter().all(|r| !r.valid));
    let lost: Vec<usize> = (0..500).filter(|i| gone[*i].change == Change::Lost).collect();
    assert_eq!(lost, [200], "50 ms are 200 lines");
    assert!(gone[300].distance_m.is_nan());
    let back: Vec<Reading> = (600..700).map(|line| see(&mut tracker, line, Some(700e-6))).collect();
    assert_eq!(back.iter().filter(|r| r.change == Change::Found).count(), 1);
    assert!(back[99].valid && (back[99].distance_m - 700e-6).abs() < 0.2e-6);
}

#[test]
fn a_deeper_layer_is_not_taken_for_the_surface_and_a_surface_that_stays_elsewhere_is() {
    let mut tracker = Tracker::new(Settings::default());
    (1..200).for_each(|line| _ = see(&mut tracker, line, Some(500e-6)));
    for line in 200..210 {
        let reading = see(&mut tracker, line, Some(680e-6));
        assert!(!reading.valid && (reading.distance_m - 500e-6).abs() < 1e-6, "{reading:?}");
    }
    assert!(see(&mut tracker, 210, Some(500e-6)).valid);
    let moved: Vec<Reading> = (211..300).map(|line| see(&mut tracker, line, Some(680e-6))).collect();
    assert!(
        moved.iter().all(|r| !r.valid || (r.distance_m - 680e-6).abs() < 1e-6),
        "never something between"
    );
    assert_eq!(moved.iter().position(|r| r.valid), Some(47), "10 ms of patience, eight lines of belief");
}

#[test]
fn a_surface_that_is_somewhere_else_is_lost_and_then_found_there() {
    let mut tracker = Tracker::new(Settings::default());
    (1..200).for_each(|line| _ = see(&mut tracker, line, Some(500e-6)));
    let moved: Vec<Reading> = (200..300).map(|line| see(&mut tracker, line, Some(680e-6))).collect();
    let at = |change| (0..100).filter(|i| moved[*i].change == change).collect::<Vec<_>>();
    assert_eq!((at(Change::Lost), at(Change::Found)), (vec![40], vec![47]));
}

#[test]
fn a_filter_that_was_never_believed_is_forgotten_when_nothing_more_comes() {
    let mut tracker = Tracker::new(Settings::default());
    (1..6).for_each(|line| _ = see(&mut tracker, line, Some(500e-6)));
    let waited: Vec<Reading> = (6..300).map(|line| see(&mut tracker, line, None)).collect();
    assert!(waited[150].distance_m.is_finite() && waited[250].distance_m.is_nan(), "50 ms are 200 lines");
    assert!(waited.iter().all(|r| !r.valid && r.change == Change::None));
    // Nothing of it counts for another one: eight lines of belief again.
    let again: Vec<Reading> = (300..330).map(|line| see(&mut tracker, line, Some(510e-6))).collect();
    assert_eq!(again.iter().position(|r| r.valid), Some(7));
}

#[test]
fn the_velocity_is_the_surfaces_own_whatever_the_tip_does() {
    let mut tracker = Tracker::new(Settings::default());
    let mut last = None;
    for line in 0..8000u64 {
        let t = line as f64 * 250e-6;
        let tip = 20e-6 * (6.0 * t).sin();
        if line.is_multiple_of(4) {
            tracker.tip_at(line * LINE_NS, [0.1, 0.0, tip], &UPRIGHT);
        }
        last = Some(see(&mut tracker, line, Some(500e-6 + 0.1e-3 * t - tip)));
    }
    let last = last.expect("a reading");
    assert!(last.valid && (last.velocity_m_s - 0.1e-3).abs() < 2e-6, "{last:?}");
}

#[test]
fn a_robot_that_falls_silent_makes_readings_invalid() {
    let mut tracker = Tracker::new(Settings::default());
    tracker.tip_at(LINE_NS, [0.0; 3], &UPRIGHT);
    for line in 1..20 {
        see(&mut tracker, line, Some(500e-6));
    }
    assert!(see(&mut tracker, 20, Some(500e-6)).valid);
    let late = see(&mut tracker, 30, Some(500e-6));
    assert!(!late.valid && late.distance_m.is_nan(), "{late:?}");
}

#[test]
fn silence_and_headers_that_make_no_sense_give_nothing() {
    let mut tracker = Tracker::new(Settings::default());
    for (bins, bin_m, first_m) in [
        (vec![SILENT_DB; 512], BIN_M, 0.0),
        (vec![f32::NAN; 512], BIN_M, 0.0),
        (Vec::new(), BIN_M, 0.0),
        (ascan(1, Some(500e-6)), 0.0, 0.0),
        (ascan(1, Some(500e-6)), -1.0, 0.0),
        (ascan(1, Some(500e-6)), f64::NAN, 0.0),
        (ascan(1, Some(500e-6)), BIN_M, f64::INFINITY),
    ] {
        let reading = tracker.see(1, &bins, bin_m, first_m);
        assert!(!reading.valid && reading.measured_m.is_nan(), "{reading:?}");
    }
}
