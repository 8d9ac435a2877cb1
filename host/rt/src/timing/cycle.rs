//! Figures of an executor's cycles: period, computing time, lateness, and their number.
//!
//! One thread records, any thread takes snapshots; a snapshot is of one moment (the rows of [`crate::seq`]).

use super::Histogram;
use crate::exclusive::TryCell;
use crate::seq;
use crate::sync::{AtomicU64, Ordering};

/// Attempts of a snapshot against a recording that goes on all the time; the last answer is then all zero.
const ATTEMPTS: usize = 1000;

/// Mean, standard deviation and extremes of durations, in ns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    pub avg_ns: f64,
    pub std_ns: f64,
    pub min_ns: u64,
    pub max_ns: u64,
}

/// The statistics of one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CycleSnapshot {
    /// From start to start.
    pub period: Spread,
    /// From start to end of a step.
    pub compute: Spread,
    pub lateness_p50_ns: u64,
    pub lateness_p99_ns: u64,
    pub lateness_p999_ns: u64,
    pub lateness_max_ns: u64,
    /// Cycles that ran.
    pub executed: u64,
    /// Cycles that were due and did not run.
    pub skipped: u64,
    /// Cycles that ended after the next one was due.
    pub overruns: u64,
    /// Share of the time spent computing, 0 to 1.
    pub load: f64,
}

/// Sums of one kind of duration, as Welford's method keeps them (Technometrics 4(3), 1962).
#[derive(Clone, Copy, Default)]
struct Sums {
    count: u64,
    mean: f64,
    squares: f64,
    min: u64,
    max: u64,
}

impl Sums {
    const WORDS: usize = 5;

    fn add(&mut self, ns: u64) {
        self.min = if self.count == 0 { ns } else { self.min.min(ns) };
        self.max = self.max.max(ns);
        self.count += 1;
        let off = ns as f64 - self.mean;
        self.mean += off / self.count as f64;
        self.squares += off * (ns as f64 - self.mean);
    }

    fn spread(&self) -> Spread {
        let std_ns = if self.count > 1 { (self.squares / (self.count - 1) as f64).sqrt() } else { 0.0 };
        Spread { avg_ns: self.mean, std_ns, min_ns: self.min, max_ns: self.max }
    }

    fn to_words(self) -> [u64; Self::WORDS] {
        [self.count, self.mean.to_bits(), self.squares.to_bits(), self.min, self.max]
    }

    fn from_words(w: &[u64]) -> Self {
        let (mean, squares) = (f64::from_bits(w[1]), f64::from_bits(w[2]));
        Self { count: w[0], mean, squares, min: w[3], max: w[4] }
    }
}

#[derive(Clone, Copy, Default)]
struct Totals {
    period: Sums,
    compute: Sums,
    skipped: u64,
    overruns: u64,
    last_start_ns: Option<u64>,
    /// Number of the next publication.
    next: u64,
}

const WORDS: usize = 2 * Sums::WORDS + 2;

/// Statistics of one executor (or one component in it).
pub struct CycleStats {
    period_ns: AtomicU64,
    totals: TryCell<Totals>,
    row: Box<[AtomicU64]>,
    published: AtomicU64,
    lateness: Histogram,
}

impl CycleStats {
    /// `period_ns` is the nominal period that overruns are judged by; 0 for executors without one.
    pub fn new(period_ns: u64) -> Self {
        Self {
            period_ns: AtomicU64::new(period_ns),
            totals: TryCell::new(Totals::default()),
            row: seq::words(seq::OVERHEAD + WORDS),
            published: AtomicU64::new(0),
            lateness: Histogram::new(),
        }
    }

    /// Records one executed cycle: when it started and ended (ns, monotonic) and how long after its deadline
    /// it started. The executor's thread; a second thread at the same moment is not counted.
    pub fn record(&self, start_ns: u64, end_ns: u64, lateness_ns: u64) {
        let compute_ns = end_ns.saturating_sub(start_ns);
        self.update(|t| {
            if let Some(last) = t.last_start_ns.replace(start_ns) {
                t.period.add(start_ns.saturating_sub(last));
            }
            t.compute.add(compute_ns);
            let period_ns = self.period_ns.load(Ordering::Relaxed);
            let over = period_ns > 0 && lateness_ns.saturating_add(compute_ns) > period_ns;
            t.overruns += u64::from(over);
            self.lateness.record_alone(lateness_ns);
        });
    }

    /// Records cycles that were due and did not run. Same thread as [`CycleStats::record`].
    pub fn record_skipped(&self, cycles: u64) {
        if cycles > 0 {
            self.update(|t| t.skipped += cycles);
        }
    }

    /// Forgets everything, so that the figures count from now on, judged by `period_ns`. Same thread as
    /// [`CycleStats::record`], between two cycles; a snapshot taken meanwhile may show part of both.
    pub fn reset(&self, period_ns: u64) {
        self.period_ns.store(period_ns, Ordering::Relaxed);
        self.update(|t| *t = Totals { next: t.next, ..Totals::default() });
        self.lateness.reset();
    }

    /// Forgets the last start, so that a pause is not taken for a period. Same thread as `record`.
    pub fn pause(&self) {
        self.update(|t| t.last_start_ns = None);
    }

    /// Returns the statistics now. Any thread; never disturbs the executor.
    pub fn snapshot(&self) -> CycleSnapshot {
        let w = self.words();
        let period = Sums::from_words(&w);
        let compute = Sums::from_words(&w[Sums::WORDS..]);
        let (skipped, overruns) = (w[2 * Sums::WORDS], w[2 * Sums::WORDS + 1]);
        CycleSnapshot {
            period: period.spread(),
            compute: compute.spread(),
            lateness_p50_ns: self.lateness.percentile(0.5),
            lateness_p99_ns: self.lateness.percentile(0.99),
            lateness_p999_ns: self.lateness.percentile(0.999),
            lateness_max_ns: self.lateness.max(),
            executed: compute.count,
            skipped,
            overruns,
            load: if period.mean > 0.0 { compute.mean / period.mean } else { 0.0 },
        }
    }

    /// The histogram of lateness, for other percentiles.
    pub fn lateness(&self) -> &Histogram {
        &self.lateness
    }

    fn update(&self, change: impl FnOnce(&mut Totals)) {
        let Some(mut totals) = self.totals.try_enter() else { return };
        change(&mut totals);
        let Totals { period, compute, skipped, overruns, next, .. } = *totals;
        let mut words = [0; WORDS];
        words[..Sums::WORDS].copy_from_slice(&period.to_words());
        words[Sums::WORDS..2 * Sums::WORDS].copy_from_slice(&compute.to_words());
        words[2 * Sums::WORDS..].copy_from_slice(&[skipped, overruns]);
        seq::write(&self.row, next, words, &[]);
        totals.next = next + 1;
        self.published.store(next + 1, Ordering::Release);
    }

    fn words(&self) -> [u64; WORDS] {
        for _ in 0..ATTEMPTS {
            let mut words = [0; WORDS];
            let Some(newest) = self.published.load(Ordering::Acquire).checked_sub(1) else { break };
            if seq::read(&self.row, newest, &mut words, &mut []).is_ok() {
                return words;
            }
        }
        [0; WORDS]
    }
}
