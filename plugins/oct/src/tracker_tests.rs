//! The tracker on the bench.
#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;
use trocar_sdk::data::Pose;
use trocar_sdk::testing::{Bench, numbers};

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

/// Settings, all of them live.
fn settings() -> impl Strategy<Value = String> {
    let to =
        |from: f64, to: f64| (from.log10()..=to.log10()).prop_map(move |e| 10f64.powf(e).clamp(from, to));
    (
        0.0..=0.01f64,
        1.0..=2.0f64,
        0.0..=40.0f64,
        to(1e-8, 1e-3),
        to(1e-5, 10.0),
        to(1e-6, 1e-3),
        to(1e-3, 1.0),
        to(1e-3, 10.0),
    )
        .prop_map(|(depth, index, snr, measurement, acceleration, gate, patience, lost)| {
            let rule =
                format!(r#""min_depth_m": {depth}, "n_index": {index}, "snr_db": {snr}, "gate_m": {gate}"#);
            let noise = format!(r#""measurement_m": {measurement}, "acceleration_m_s2": {acceleration}"#);
            format!(r#"{{{rule}, {noise}, "patience_s": {patience}, "lost_after_s": {lost}}}"#)
        })
}

/// Numbers of any size, mostly those that can be.
fn any_number(usual: std::ops::Range<f64>) -> impl Strategy<Value = f64> {
    let huge = (-300.0..308.2f64, any::<bool>())
        .prop_map(|(e, below)| 10f64.powf(e) * if below { -1.0 } else { 1.0 });
    prop_oneof![4 => usual, 1 => huge]
}

/// An A-scan: noise, and a peak that is where it mostly is, or elsewhere; heights of any size.
fn a_scan() -> impl Strategy<Value = (u64, Option<usize>, f32, f32)> {
    let elsewhere = prop_oneof![9 => Just(None), 1 => (0..64usize).prop_map(Some)];
    let noise = prop_oneof![19 => 1.0..3.0f32, 1 => 1e30..3.4e38f32];
    let peak = prop_oneof![19 => 30.0..100.0f32, 1 => 1e30..3.4e38f32];
    (any::<u64>(), elsewhere, noise, peak)
}

fn bins((seed, elsewhere, noise, peak): (u64, Option<usize>, f32, f32), at: usize) -> Vec<u8> {
    let random = trocar_phantom::noise::Noise::new(seed, 1).part(0);
    let mut bins: Vec<f32> = (0..64).map(|n| noise * (2.0 * random.uniform(n) as f32 - 1.0)).collect();
    bins[elsewhere.unwrap_or(at)] = peak;
    bins.iter().flat_map(|bin| bin.to_ne_bytes()).collect()
}

proptest! {
    /// Nothing is known of a surface that is not seen: its velocity is NaN, its deviation infinite.
    #[test]
    fn a_distance_is_made_of_numbers_whatever_scans_poses_and_settings_say(
        parts in prop::collection::vec(
            (
                settings(),
                (1..63usize, any_number(1e-7..1e-5), any_number(0.0..1e-3)),
                prop::collection::vec(
                    (
                        a_scan(),
                        prop::array::uniform3(any_number(-1e-6..1e-6)),
                        prop_oneof![9 => Just((None, 0i64)), 1 => ((0..11u32).prop_map(Some), -3_000_000..3_000_000i64)],
                    ),
                    1..30,
                ),
            ),
            1..4,
        ),
        has_robot: bool,
    ) {
        let mut bench = Bench::<SurfaceTracker>::new(&parts[0].0);
        for (settings, (at, bin, first), scans) in &parts {
            bench.configure(settings).unwrap();
            for (scan, position, (pace, age_ns)) in scans {
                let stamp = Stamp::from_ns(bench.now().ns().saturating_add_signed(-age_ns));
                if has_robot {
                    let measured_cp = Pose { stamp, position: *position, ..Pose::default() };
                    bench.push("robot", ArmState { stamp, measured_cp, ..ArmState::default() });
                }
                let header = AScanHeader {
                    stamp, lines: 1, samples: 64, format: SampleFormat::F32, bin: *bin, first: *first, ..AScanHeader::default()
                };
                bench.push_frame("ascan", header, &bins(*scan, *at));
                bench.step_after(pace.map_or(250_000, |e| 10u64.pow(e))).unwrap();
                let told = [
                    bench.outputs::<Distance>("distance"),
                    bench.events::<Distance>("surface_lost"),
                    bench.events::<Distance>("surface_found"),
                    vec![bench.state().last],
                ];
                for mut distance in told.concat() {
                    if !distance.valid.get() && distance.distance == 0.0 {
                        distance.sigma = 0.0;
                    }
                    if !has_robot || !distance.valid.get() && distance.distance == 0.0 {
                        distance.velocity = 0.0;
                    }
                    let told = numbers(&distance);
                    prop_assert!(told.iter().all(|n| n.is_finite()), "{distance:?}: {header:?}");
                }
            }
        }
    }
}
