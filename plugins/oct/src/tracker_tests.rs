//! The tracker on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::Pose;
use trocar_sdk::testing::Bench;

const BIN_M: f64 = 3.5e-6;

/// Pushes a frame of four A-scans that end now, with a surface at `distance_m`, and steps.
fn step(bench: &mut Bench<SurfaceTracker>, distance_m: Option<f64>) {
    let noise = trocar_phantom::noise::Noise::new(3, bench.now().ns());
    let mut bytes = Vec::new();
    for line in 0..4u64 {
        let at = distance_m.map(|d| d * 1.336 / BIN_M);
        for bin in 0..512u64 {
            let floor = 40.0 + 10.0 * (-(noise.part(line).uniform(bin) + 1e-9).ln()).log10();
            let peak = at.map_or(f64::MIN, |at| 85.0 - 3.0 * (bin as f64 - at).powi(2));
            bytes.extend((floor.max(peak) as f32).to_ne_bytes());
        }
    }
    let stamp = Stamp::from_ns(bench.now().ns() + 125_000);
    let header = AScanHeader {
        stamp,
        lines: 4,
        samples: 512,
        format: SampleFormat::F32,
        line_period: 250e-6,
        bin: BIN_M,
        ..AScanHeader::default()
    };
    bench.push_frame("ascan", header, &bytes);
    bench.step(1);
}

fn robot(bench: &mut Bench<SurfaceTracker>) {
    let stamp = bench.now();
    let measured_cp = Pose { stamp, ..Pose::default() };
    bench.push("robot", ArmState { stamp, measured_cp, ..ArmState::default() });
}

#[test]
fn each_a_scan_gives_a_distance_with_its_own_stamp() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    for _ in 0..30 {
        robot(&mut bench);
        step(&mut bench, Some(500e-6));
    }
    let distances = bench.outputs::<Distance>("distance");
    assert_eq!(distances.len(), 120);
    assert!(distances.windows(2).all(|w| w[1].stamp.ns() - w[0].stamp.ns() == 250_000));
    let last = distances[119];
    assert!(last.valid.get() && (last.distance - 500e-6).abs() < 0.2e-6, "{last:?}");
    assert!(last.velocity.abs() < 1e-4 && last.sigma < 3e-6 && last.snr_db > 30.0, "{last:?}");
    assert_eq!(bench.read::<(), Distance>("measured_distance", ()).unwrap(), last);
    assert_eq!(bench.events::<Distance>("surface_found").len(), 1);
}

#[test]
fn without_a_robot_distances_are_valid_and_the_velocity_is_not_known() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    (0..10).for_each(|_| step(&mut bench, Some(500e-6)));
    let last = bench.state().last;
    assert!(last.valid.get() && last.velocity.is_nan(), "{last:?}");
}

#[test]
fn a_lost_surface_is_told_once_and_no_distance_of_it_is_valid() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    (0..20).for_each(|_| step(&mut bench, Some(500e-6)));
    bench.outputs::<Distance>("distance");
    (0..100).for_each(|_| step(&mut bench, None));
    assert!(bench.outputs::<Distance>("distance").iter().all(|d| !d.valid.get() && d.distance.is_finite()));
    assert_eq!(bench.events::<Distance>("surface_lost").len(), 1);
    assert_eq!(bench.state().invalid, 400 + 7);
}

#[test]
fn one_pose_from_ahead_or_without_a_time_does_not_hide_those_that_follow() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    let wrong = |stamp| ArmState { measured_cp: Pose { stamp, ..Pose::default() }, ..ArmState::default() };
    for stamp in [Stamp::from_ns(u64::MAX), Stamp::from_ns(bench.now().ns() + 60_000_000_000), Stamp::INVALID]
    {
        bench.push("robot", wrong(stamp));
    }
    // The tip goes down and the surface with it: the distance stays and the surface's velocity is the tip's.
    for n in 0..400 {
        let stamp = bench.now();
        let position = [0.0, 0.0, 1e-6 * f64::from(n)];
        let measured_cp = Pose { stamp, position, ..Pose::default() };
        bench.push("robot", ArmState { stamp, measured_cp, ..ArmState::default() });
        step(&mut bench, Some(500e-6));
    }
    let last = bench.state().last;
    assert!(last.valid.get() && (last.velocity - 1e-3).abs() < 1e-4, "{last:?}");
    assert_eq!(bench.state().refused_poses, 3);
}

#[test]
fn frames_that_are_no_a_scans_in_decibels_or_from_ahead_are_counted() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    let stamp = bench.now();
    let ahead = Stamp::from_ns(stamp.ns() + 1_000_000_000);
    let good =
        AScanHeader { stamp, lines: 1, samples: 512, format: SampleFormat::F32, ..AScanHeader::default() };
    let endless = AScanHeader { lines: 2, line_period: f64::INFINITY, ..good };
    let late = AScanHeader { stamp: Stamp::from_ns(u64::MAX), lines: 2, line_period: 1.0, ..good };
    for (header, bytes) in [
        (endless, 4096),
        (late, 4096),
        (AScanHeader { line_period: f64::NAN, ..good }, 2048),
        (AScanHeader { stamp: ahead, ..good }, 2048),
        (AScanHeader { format: SampleFormat::U8, ..good }, 512),
        (AScanHeader { samples: 10_000, ..good }, 40_000),
        (good, 2047),
    ] {
        bench.push_frame("ascan", header, &vec![0; bytes]);
    }
    bench.step(1);
    assert_eq!((bench.state().refused_frames, bench.outputs::<Distance>("distance").len()), (7, 0));
}

#[test]
fn settings_change_while_it_runs_and_what_is_followed_stays() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    (0..20).for_each(|_| step(&mut bench, Some(500e-6)));
    bench.configure(r#"{"gate_m": 0.0001}"#).unwrap();
    step(&mut bench, Some(580e-6));
    assert!(bench.state().last.valid.get(), "80 µm are within the wider gate");
    let refused = bench.configure(r#"{"n_index": 0.5}"#).unwrap_err().reason;
    assert_eq!(refused, "n_index: 0.5 is below 1");
}

#[test]
fn tracking_allocates_nothing() {
    let mut bench = Bench::<SurfaceTracker>::new("{}");
    step(&mut bench, Some(500e-6));
    bench.assert_no_alloc(|bench| (0..10).for_each(|_| step(bench, Some(500e-6))));
}
