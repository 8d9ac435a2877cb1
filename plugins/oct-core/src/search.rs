//! Finds the dispersion that makes A-scans sharpest, a little work at a time.
//!
//! Invariant: one call of `work` transforms one line, so a step that makes few of them is never long; the
//! search ends after a bounded number of them, and a result at the end of the range ([`WIDEST_RAD`]) is none.
//! Sharpness is `Σ|A|⁴ / (Σ|A|²)²` per line, over the bins beyond what is left of the reference arm.

use trocar_fft::num_complex::Complex;

use crate::chain::Chain;
use crate::dispersion::{Dispersion, fill_filter};

/// Lines that are looked at.
pub const LINES: usize = 64;

/// Largest a2 and a3 that are looked at, rad, to either side.
pub const WIDEST_RAD: (f64, f64) = (60.0, 20.0);
/// Step of the first look, rad.
const FIRST: (f64, f64) = (2.0, 1.0);
/// Step at which refining ends, rad.
const FINEST_RAD: f64 = 0.02;

/// Lines of noise have a sharpness of 2 over the number of bins; below this many times that there is nothing
/// to see.
const AT_LEAST: f64 = 2.0;

/// Result of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    pub dispersion: Dispersion,
    /// Mean sharpness of the lines, 0 to 1.
    pub sharpness: f64,
    /// There was something to see, and it is sharpest within the range; else the dispersion means nothing.
    pub sure: bool,
    /// The sharpest lies where the range ends: there may be something sharper beyond.
    pub at_edge: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Idle,
    Collect,
    A2(u32),
    A3(u32),
    /// Step in rad, and which of four neighbours is looked at.
    Refine(f64, u32),
}

/// The search; buffers are made once.
#[derive(Clone)]
pub struct Search {
    lines: Vec<f32>,
    samples: usize,
    taken: usize,
    phase: Phase,
    filter: Vec<Complex<f32>>,
    trial: Dispersion,
    /// Lines of this trial done, and their sharpness so far.
    done: usize,
    sum: f64,
    best: (Dispersion, f64),
    /// Centre from which the neighbours are counted, and whether one of them was better.
    middle: Dispersion,
    moved: bool,
}

impl Search {
    /// For lines of `samples`; idle.
    pub fn new(samples: usize) -> Search {
        Search {
            lines: vec![0.0; LINES * samples],
            samples,
            taken: 0,
            phase: Phase::Idle,
            filter: vec![Complex::default(); samples],
            trial: Dispersion::default(),
            done: 0,
            sum: 0.0,
            best: (Dispersion::default(), 0.0),
            middle: Dispersion::default(),
            moved: false,
        }
    }

    /// Begins anew with the next lines.
    pub fn begin(&mut self) {
        (self.taken, self.phase) = (0, Phase::Collect);
        self.best = (Dispersion::default(), 0.0);
    }

    /// Is it at work?
    pub fn is_busy(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Keeps the chain's last line while lines are wanted.
    pub fn see(&mut self, chain: &Chain) {
        if self.phase != Phase::Collect || chain.grid().samples() != self.samples {
            return;
        }
        let at = self.taken * self.samples;
        for (kept, x) in self.lines[at..at + self.samples].iter_mut().zip(chain.linear()) {
            *kept = x;
        }
        self.taken += 1;
        if self.taken == LINES {
            self.phase = Phase::A2(0);
            self.next_trial(chain);
        }
    }

    /// Transforms one line; the result when it was the last one.
    pub fn work(&mut self, chain: &mut Chain) -> Option<Found> {
        if matches!(self.phase, Phase::Idle | Phase::Collect) {
            return None;
        }
        let at = self.done * self.samples;
        chain.transform.run(
            &self.lines[at..at + self.samples],
            |from, to| to.copy_from_slice(from),
            &self.filter,
        );
        self.sum += sharpness(&chain.transform.buffer[self.samples / 16..self.samples / 2]);
        self.done += 1;
        if self.done < LINES {
            return None;
        }
        let mean = self.sum / LINES as f64;
        if mean > self.best.1 {
            self.best = (self.trial, mean);
            self.moved = true;
        }
        self.advance();
        if self.phase == Phase::Idle {
            let noise = 2.0 / (self.samples / 2 - self.samples / 16) as f64;
            let (dispersion, sharpness) = self.best;
            let at_edge = is_far(&dispersion);
            let sure = sharpness > AT_LEAST * noise && !at_edge;
            return Some(Found { dispersion, sharpness, sure, at_edge });
        }
        self.next_trial(chain);
        None
    }

    /// The trial after this one.
    fn advance(&mut self) {
        let trials = |widest: f64, step: f64| (2.0 * widest / step) as u32 + 1;
        self.phase = match self.phase {
            Phase::A2(n) if n + 1 < trials(WIDEST_RAD.0, FIRST.0) => Phase::A2(n + 1),
            Phase::A2(_) => {
                self.middle = self.best.0;
                Phase::A3(0)
            }
            Phase::A3(n) if n + 1 < trials(WIDEST_RAD.1, FIRST.1) => Phase::A3(n + 1),
            Phase::A3(_) => {
                (self.middle, self.moved) = (self.best.0, false);
                Phase::Refine(FIRST.1, 0)
            }
            Phase::Refine(step, side) if side < 3 => Phase::Refine(step, side + 1),
            Phase::Refine(step, _) => {
                let moved = std::mem::replace(&mut self.moved, false);
                let far = is_far(&self.best.0);
                self.middle = self.best.0;
                match step {
                    step if moved && !far => Phase::Refine(step, 0),
                    step if step > FINEST_RAD => Phase::Refine(0.5 * step, 0),
                    _ => Phase::Idle,
                }
            }
            phase => phase,
        };
    }

    fn next_trial(&mut self, chain: &Chain) {
        let Dispersion { a2_rad, a3_rad } = self.middle;
        self.trial = match self.phase {
            Phase::A2(n) => Dispersion { a2_rad: FIRST.0 * f64::from(n) - WIDEST_RAD.0, a3_rad: 0.0 },
            Phase::A3(n) => Dispersion { a2_rad, a3_rad: FIRST.1 * f64::from(n) - WIDEST_RAD.1 },
            Phase::Refine(step, 0) => Dispersion { a2_rad: a2_rad + step, a3_rad },
            Phase::Refine(step, 1) => Dispersion { a2_rad: a2_rad - step, a3_rad },
            Phase::Refine(step, 2) => Dispersion { a2_rad, a3_rad: a3_rad + step },
            Phase::Refine(step, _) => Dispersion { a2_rad, a3_rad: a3_rad - step },
            Phase::Idle | Phase::Collect => self.trial,
        };
        (self.done, self.sum) = (0, 0.0);
        fill_filter(chain.grid(), self.trial, &mut self.filter);
    }
}

/// At the end of the range, or beyond it.
fn is_far(dispersion: &Dispersion) -> bool {
    dispersion.a2_rad.abs() >= WIDEST_RAD.0 || dispersion.a3_rad.abs() >= WIDEST_RAD.1
}

/// `Σ|A|⁴ / (Σ|A|²)²`: 1 when all light is in one bin, 2 over the number of bins for noise.
fn sharpness(bins: &[Complex<f32>]) -> f64 {
    let (mut squares, mut fourth) = (0.0f64, 0.0f64);
    for x in bins {
        let power = f64::from(x.re * x.re + x.im * x.im);
        squares += power;
        fourth += power * power;
    }
    if squares > 0.0 { fourth / (squares * squares) } else { 0.0 }
}
