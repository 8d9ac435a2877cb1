//! Source, processor and tracker one after the other, as in a stream: what is measured is what is true.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{AScanHeader, ArmState, CartesianState, Distance, Pose, SpectraHeader, Twist};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::{OctProcessor, OctSource, SurfaceTracker};

struct Whole {
    source: Bench<OctSource>,
    processor: Bench<OctProcessor>,
    tracker: Bench<SurfaceTracker>,
}

impl Whole {
    fn new(source: &str) -> Whole {
        Whole { source: Bench::new(source), processor: Bench::new("{}"), tracker: Bench::new("{}") }
    }

    /// One millisecond with the tip at `z` moving at `speed`; truth and measurement of its lines.
    fn step(&mut self, x: f64, z: f64, speed: f64) -> Vec<(Distance, Distance)> {
        let stamp = self.source.now();
        let pose = Pose { stamp, position: [x, 0.0, z], ..Pose::default() };
        let twist = Twist { stamp, linear: [0.0, 0.0, speed], ..Twist::default() };
        self.source.push("tip", CartesianState { stamp, pose, twist, ..CartesianState::default() });
        self.source.step(1);
        for (header, bytes, _) in self.source.frames::<SpectraHeader>("spectra") {
            self.processor.push_frame("spectra", header, &bytes);
        }
        self.processor.step(1);
        // Robots tell where they are in another frame: only differences count.
        let measured_cp = Pose { position: [x + 0.3, 0.1, z + 0.08], ..pose };
        self.tracker.push("robot", ArmState { stamp, measured_cp, ..ArmState::default() });
        for (header, bytes, _) in self.processor.frames::<AScanHeader>("ascan") {
            self.tracker.push_frame("ascan", header, &bytes);
        }
        self.tracker.step(1);
        let truth = self.source.outputs::<Distance>("true_distance");
        let measured = self.tracker.outputs::<Distance>("distance");
        assert_eq!(truth.len(), measured.len());
        truth.into_iter().zip(measured).collect()
    }
}

#[test]
fn what_the_tracker_says_is_the_truth_of_the_source_while_eye_and_tip_move() {
    for seed in 1..=3 {
        let mut whole = Whole::new(&format!(r#"{{"world": "no_membrane", "seed": {seed}}}"#));
        let (mut squares, mut count, mut velocity) = (0.0, 0, 0.0f64);
        for n in 0..1500 {
            let t = f64::from(n) * 1e-3;
            let z = -500e-6 + 30e-6 * (6.0 * t).sin();
            for (truth, measured) in whole.step(0.2e-3, z, 180e-6 * (6.0 * t).cos()) {
                assert_eq!(truth.stamp, measured.stamp);
                if n > 200 {
                    assert!(measured.valid.get(), "{measured:?} at {t} s");
                    squares += (measured.distance - truth.distance).powi(2);
                    velocity = velocity.max(measured.velocity.abs());
                    count += 1;
                }
            }
        }
        let rms = (squares / f64::from(count)).sqrt();
        println!("seed {seed}: {rms:.3e} m, fastest {velocity:.2e} m/s");
        assert!(count > 5000 && rms < 0.5e-6, "seed {seed}: {rms:.2e} m over {count} lines");
        assert!((50e-6..1e-3).contains(&velocity), "pulse and breathing, not the tip: {velocity:.2e} m/s");
    }
}

#[test]
fn light_that_fails_is_told_and_never_gives_a_valid_distance() {
    let mut whole = Whole::new(r#"{"world": "static"}"#);
    (0..100).for_each(|_| _ = whole.step(0.0, -500e-6, 0.0));
    for (setting, event) in [
        (r#"{"world": "static", "light": false}"#, "dark"),
        (r#"{"world": "static", "reference": 1.4}"#, "saturated"),
    ] {
        whole.source.configure(setting).unwrap();
        for _ in 0..100 {
            for (_, measured) in whole.step(0.0, -500e-6, 0.0) {
                assert!(!measured.valid.get(), "{event}: {measured:?}");
            }
        }
        assert_eq!(whole.processor.events::<Flag>(event), [Flag::TRUE]);
        assert_eq!(whole.tracker.events::<Distance>("surface_lost").len(), 1);
        whole.source.configure(r#"{"world": "static"}"#).unwrap();
        let back: Vec<_> = (0..100).flat_map(|_| whole.step(0.0, -500e-6, 0.0)).collect();
        let (truth, measured) = back.last().unwrap();
        assert!(measured.valid.get() && (measured.distance - truth.distance).abs() < 1e-6);
        assert_eq!(whole.processor.events::<Flag>(event), [Flag::FALSE]);
    }
}

#[test]
fn no_retina_is_no_surface() {
    let mut whole = Whole::new("{}");
    for _ in 0..200 {
        // Beyond what the spectrometer resolves: nothing comes back but what is folded, and that is too weak.
        for (_, measured) in whole.step(0.0, -8e-3, 0.0) {
            assert!(!measured.valid.get(), "{measured:?}");
        }
    }
}
