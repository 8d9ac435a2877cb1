//! The median of the last samples: removes spikes, keeps edges.
//!
//! Invariant: the output is always a number that came in; until the window is full, the median is of those
//! that are there. With another length the window grows by one sample, or shrinks by two, with each sample
//! that comes: the output does not jump.
use trocar_sdk::data::{Scalar, Wrench};
use trocar_sdk::prelude::*;

use crate::lanes;

/// Longest window, samples.
const MOST: usize = 101;

#[derive(Config)]
struct MovingMedianConfig {
    /// Samples in the window, an odd number; delays an edge by half of them
    #[config(live, min = 1, max = 101, default = 5)]
    window: usize,
}

/// Median of each number of scalars and wrenches over the last samples.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct MovingMedian {
    #[input(fifo = 64, optional)]
    value: In<Scalar>,
    #[input(fifo = 64, optional)]
    wrench: In<Wrench>,
    #[output]
    filtered: Out<Scalar>,
    #[output]
    filtered_wrench: Out<Wrench>,
    /// Samples left out: not finite, or beyond 1e100.
    #[state]
    rejected: u64,
    #[config]
    cfg: MovingMedianConfig,
    of_value: Window<1>,
    of_wrench: Window<6>,
}

#[provides("ctl")]
impl MovingMedian {
    /// Forgets the past.
    #[command]
    fn clear(&mut self) {
        (self.of_value.there, self.of_wrench.there) = (0, 0);
    }
}

impl Component for MovingMedian {
    fn configure(&mut self) -> Result {
        if self.cfg.window.is_multiple_of(2) {
            return Err(format!(
                "window: {} is even: an odd number of samples has a median",
                self.cfg.window
            )
            .into());
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.rejected = 0;
        self.clear();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let length = self.cfg.window;
        let MovingMedian { of_value, of_wrench, .. } = self;
        self.rejected += lanes::pass(&mut self.value, &self.filtered, |n, _| of_value.each(length, n));
        self.rejected +=
            lanes::pass(&mut self.wrench, &self.filtered_wrench, |n, _| of_wrench.each(length, n));
        Ok(())
    }
}

/// The last samples, number by number, the oldest overwritten.
struct Window<const N: usize> {
    last: [[f64; MOST]; N],
    /// Place of the next one.
    at: usize,
    /// Number of samples before it that are in the window.
    there: usize,
}

impl<const N: usize> Default for Window<N> {
    fn default() -> Self {
        Window { last: [[0.0; MOST]; N], at: 0, there: 0 }
    }
}

impl<const N: usize> Window<N> {
    /// Takes one sample of all numbers; their medians.
    fn each(&mut self, length: usize, mut numbers: [f64; N]) -> [f64; N] {
        self.there =
            if self.there > length { length.max(self.there - 2) } else { length.min(self.there + 1) };
        let (at, there) = (self.at, self.there);
        self.at = (at + 1) % MOST;
        // Samples of the window that lie at the end of the ring.
        let before = (there - 1).saturating_sub(at);
        for (number, last) in numbers.iter_mut().zip(&mut self.last) {
            last[at] = *number;
            let mut sorted = [0.0; MOST];
            let (newer, older) = sorted[..there].split_at_mut(there - before);
            newer.copy_from_slice(&last[at + 1 - newer.len()..=at]);
            older.copy_from_slice(&last[MOST - before..]);
            // The median of an even number is the lower one of the two in the middle.
            let (_, median, _) = sorted[..there].select_nth_unstable_by((there - 1) / 2, f64::total_cmp);
            *number = *median;
        }
        numbers
    }
}
