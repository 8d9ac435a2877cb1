//! Answers of each filter to signals whose answer is known, and its refusals; one file for each class.
#![allow(clippy::unwrap_used)]

mod add_latency;
mod bad_samples;
mod biquad;
mod cartesian_transform;
mod changes;
mod finite;
mod kalman;
mod moving_median;
mod pid;
mod resampler;
mod rows;
mod settings;
mod watchdog;

pub(crate) use bad_samples::as_if_the_bad_ones_had_not_come;
pub(crate) use rows::{Given, Law, Row, ten_to, told};

use trocar_sdk::Class;
use trocar_sdk::data::{Pose, Scalar, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::*;

trocar_sdk::testing::count_allocations!();

fn scalar(value: f64) -> Scalar {
    Scalar { stamp: Stamp::INVALID, value }
}

/// Returns the output for a signal at 1 kHz.
fn through<C: Class>(bench: &mut Bench<C>, samples: usize, signal: impl Fn(f64) -> f64) -> Vec<f64> {
    for n in 0..samples {
        bench.push("value", scalar(signal(n as f64 * 1e-3)));
        bench.step(1);
    }
    bench.outputs::<Scalar>("filtered").iter().map(|s| s.value).collect()
}

#[track_caller]
fn refused<C: Class>(config: &str) -> String {
    Bench::<C>::created().configure(config).unwrap_err().reason
}

#[test]
fn no_filter_allocates_in_a_step() {
    fn quiet<C: Class>(config: &str, feed: impl Fn(&mut Bench<C>)) {
        let mut bench = Bench::<C>::new(config);
        feed(&mut bench);
        bench.step(1);
        bench.assert_no_alloc(|bench| {
            for _ in 0..50 {
                feed(bench);
                bench.step(1);
            }
        });
    }
    quiet::<Biquad>("{}", |bench| bench.push("value", scalar(1.0)));
    quiet::<MovingMedian>(r#"{"window": 101}"#, |bench| bench.push("wrench", Wrench::default()));
    quiet::<Kalman>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Resampler>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Pid>("{}", |bench| {
        bench.push("setpoint", scalar(1.0));
        bench.push("measured", scalar(0.5));
    });
    quiet::<CartesianTransform>("{}", |bench| bench.push("pose", Pose::default()));
    quiet::<Watchdog>("{}", |bench| bench.push("watched", scalar(1.0)));
    quiet::<AddLatency>("{}", |bench| bench.push("sample", scalar(1.0)));
}
