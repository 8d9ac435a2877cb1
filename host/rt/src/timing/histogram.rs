//! A log-linear histogram of durations: 32 buckets per doubling, so a percentile is at most 3.2 % too high.
//!
//! Counting is one atomic addition from any thread; nothing is ever lost or rescaled.

use crate::sync::{AtomicU64, Ordering};

const SUB_BITS: u32 = 5;
const SUB: u64 = 1 << SUB_BITS;
/// Durations from 2^42 ns (73 minutes) on share the last bucket.
const TOP_BITS: u32 = 42;
const BUCKETS: usize = ((TOP_BITS - SUB_BITS) as usize + 1) * SUB as usize;

/// Counts durations in ns.
pub struct Histogram {
    buckets: Box<[AtomicU64]>,
    max_ns: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

fn bucket_of(ns: u64) -> usize {
    let ns = ns.min((1 << TOP_BITS) - 1);
    let shift = (ns | 1).ilog2().saturating_sub(SUB_BITS);
    (u64::from(shift) * SUB + (ns >> shift)) as usize
}

/// The longest duration, in ns, that falls into the bucket.
fn end_of(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    let shift = (bucket / SUB).saturating_sub(1);
    let mantissa = bucket - shift * SUB;
    ((mantissa + 1) << shift) - 1
}

impl Histogram {
    pub fn new() -> Self {
        Self { buckets: (0..BUCKETS).map(|_| AtomicU64::new(0)).collect(), max_ns: AtomicU64::new(0) }
    }

    /// Counts one duration in ns. Any thread; never waits.
    pub fn record(&self, ns: u64) {
        self.buckets[bucket_of(ns)].fetch_add(1, Ordering::Relaxed);
        if ns > self.max_ns.load(Ordering::Relaxed) {
            self.max_ns.fetch_max(ns, Ordering::Relaxed);
        }
    }

    /// As [`Histogram::record`], where only one thread at a time ever counts: without an atomic addition.
    #[inline]
    pub fn record_alone(&self, ns: u64) {
        let bucket = &self.buckets[bucket_of(ns)];
        bucket.store(bucket.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
        if ns > self.max_ns.load(Ordering::Relaxed) {
            self.max_ns.store(ns, Ordering::Relaxed);
        }
    }

    /// Forgets all durations. One counted at the same moment may stay or go.
    pub fn reset(&self) {
        self.buckets.iter().for_each(|b| b.store(0, Ordering::Relaxed));
        self.max_ns.store(0, Ordering::Relaxed);
    }

    /// The duration, in ns, that the share `q` (0 to 1) of all counted ones does not exceed; 0 with none
    /// counted. Never below the true value by rounding, and never above the longest one counted.
    pub fn percentile(&self, q: f64) -> u64 {
        let rank = ((self.count() as f64 * q.clamp(0.0, 1.0)).ceil() as u64).max(1);
        let mut seen = 0;
        let bucket = self.buckets.iter().position(|b| {
            seen += b.load(Ordering::Relaxed);
            seen >= rank
        });
        bucket.map_or(0, end_of).min(self.max())
    }

    /// The longest duration counted, in ns.
    pub fn max(&self) -> u64 {
        self.max_ns.load(Ordering::Relaxed)
    }

    /// Returns the number of durations counted.
    pub fn count(&self) -> u64 {
        self.buckets.iter().map(|b| b.load(Ordering::Relaxed)).sum()
    }
}
