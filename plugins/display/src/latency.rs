//! Percentiles of many times in a fixed room.
//!
//! Invariant: a percentile is told at most a 32nd above the true one, and none of the counted times is
//! forgotten.

use trocar_sdk::prelude::*;

/// Steps within each doubling of the time: 1/32 is the precision.
const STEPS: usize = 32;
/// Doublings of 32 µs that are told apart: up to 9 hours.
const DOUBLINGS: usize = 30;

/// Age of the frames when they were ready to be shown.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Latency {
    /// Frames counted.
    pub frames: u64,
    /// Half of them were not older.
    #[unit("ms")]
    pub p50_ms: f64,
    /// 99 of 100 were not older.
    #[unit("ms")]
    pub p99_ms: f64,
    /// The oldest.
    #[unit("ms")]
    pub max_ms: f64,
}

/// Counts times.
pub(crate) struct Histogram {
    counts: Vec<u64>,
    frames: u64,
    max_s: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Histogram { counts: vec![0; STEPS * (DOUBLINGS + 1)], frames: 0, max_s: 0.0 }
    }
}

impl Histogram {
    /// Counts one; a negative one as 0.
    pub(crate) fn count(&mut self, time_s: f64) {
        let at = bucket((time_s.max(0.0) * 1e6) as u64);
        self.counts[at] += 1;
        self.frames += 1;
        self.max_s = self.max_s.max(time_s);
    }

    pub(crate) fn clear(&mut self) {
        self.counts.fill(0);
        (self.frames, self.max_s) = (0, 0.0);
    }

    /// The figures so far.
    pub(crate) fn told(&self) -> Latency {
        let max_ms = self.max_s * 1e3;
        let ms = |part: f64| (self.percentile_us(part) * 1e-3).min(max_ms);
        Latency { frames: self.frames, p50_ms: ms(0.5), p99_ms: ms(0.99), max_ms }
    }

    fn percentile_us(&self, part: f64) -> f64 {
        let wanted = (part * self.frames as f64).ceil() as u64;
        let mut sum = 0;
        for (at, count) in self.counts.iter().enumerate() {
            sum += count;
            if sum >= wanted.max(1) {
                return above(at);
            }
        }
        0.0
    }
}

/// 0 to 31 µs one by one, then 32 steps for each doubling.
fn bucket(us: u64) -> usize {
    let us = us.max(1);
    let doubling = (us.ilog2() as usize).saturating_sub(STEPS.ilog2() as usize);
    let step = (us >> doubling) as usize;
    (doubling * STEPS + step).min(STEPS * (DOUBLINGS + 1) - 1)
}

/// The end of a bucket, µs.
fn above(at: usize) -> f64 {
    let doubling = (at / STEPS).saturating_sub(1);
    let step = at - doubling * STEPS;
    (step + 1) as f64 * (1u64 << doubling) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_time_lies_below_the_end_of_its_bucket_by_a_32nd_at_most() {
        let mut us = 1u64;
        while us < 20_000_000_000 {
            let end = above(bucket(us));
            assert!(end > us as f64, "{us} µs in a bucket that ends at {end}");
            assert!(end <= us as f64 * (1.0 + 1.0 / 32.0) + 1.0, "{us} µs in a bucket that ends at {end}");
            us += 1 + us / 100;
        }
    }

    #[test]
    fn percentiles_are_those_of_what_was_counted() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.told(), Latency::default());
        for n in 1..=1000 {
            histogram.count(f64::from(n) * 1e-5);
        }
        let told = histogram.told();
        assert_eq!(told.frames, 1000);
        assert!((5.0..5.2).contains(&told.p50_ms), "{told:?}");
        assert!((9.9..10.0 + 1e-9).contains(&told.p99_ms), "{told:?}");
        assert!((told.max_ms - 10.0).abs() < 1e-9);
        histogram.count(-1.0);
        histogram.count(1e9);
        assert_eq!(histogram.told().frames, 1002);
        histogram.clear();
        assert_eq!(histogram.told(), Latency::default());
    }
}
