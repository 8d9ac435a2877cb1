//! Samples that come as they like, on the grid of this component.
//!
//! Invariant: an output is the signal at its stamp: `delay_s` before the deadline, between two samples or
//! carried on beyond the newest one for `ahead_s`. A value that is only held keeps its own stamp, and is no
//! longer given when it is too old.
use nalgebra::{UnitQuaternion, Vector3};
use trocar_sdk::data::{Pose, Scalar};
use trocar_sdk::prelude::*;

use crate::good;

/// Samples that are remembered.
const MOST: usize = 64;

#[derive(Config)]
struct ResamplerConfig {
    /// `linear` (orientations on the shortest arc), or `hold`: the newest sample before the instant
    #[config(live, one_of = ["linear", "hold"], default = "linear")]
    method: String,
    /// Time from the instant to now; a little more than the time between two samples gives pure interpolation
    #[config(live, min = 0.0, max = 10.0, unit = "s", default = 0.02)]
    delay_s: f64,
    /// Time for which the motion is carried on beyond the newest sample; then it is held
    #[config(live, min = 0.0, max = 10.0, unit = "s", default = 0.02)]
    ahead_s: f64,
    /// Time for which a sample is held; then nothing comes out until the next one, and nothing is
    /// interpolated over a longer gap
    #[config(live, min = 0.0001, max = 3600.0, unit = "s", default = 0.5)]
    max_age_s: f64,
}

/// Gives scalars and poses at the component's own rate.
#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
pub struct Resampler {
    #[input(fifo = 64, optional)]
    value: In<Scalar>,
    #[input(fifo = 64, optional)]
    pose: In<Pose>,
    #[output]
    resampled: Out<Scalar>,
    #[output]
    resampled_pose: Out<Pose>,
    /// Samples left out: no number, no pose, without a stamp, back in time or from far ahead.
    #[state]
    rejected: u64,
    /// Outputs since Start that lie beyond the newest sample.
    #[state]
    extrapolated: u64,
    /// Steps since Start in which the newest sample was too old for an output.
    #[state]
    too_old: u64,
    #[config]
    cfg: ResamplerConfig,
    values: Past<f64>,
    poses: Past<(Vector3<f64>, UnitQuaternion<f64>)>,
}

#[provides("ctl")]
impl Resampler {
    /// Forgets the past.
    #[command]
    fn clear(&mut self) {
        (self.values.seen, self.poses.seen) = (0, 0);
    }
}

impl Component for Resampler {
    fn configure(&mut self) -> Result {
        let ResamplerConfig { ahead_s, max_age_s, .. } = self.cfg;
        if ahead_s > max_age_s {
            return Err(format!(
                "ahead_s, max_age_s: {ahead_s} s ahead is longer than a sample is held, {max_age_s} s: raise max_age_s or lower ahead_s"
            )
            .into());
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.rejected, self.extrapolated, self.too_old) = (0, 0, 0);
        self.clear();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        while let Some(s) = self.value.next_sample() {
            let good = good::number(s.value.value) && good::stamp(s.stamp, now);
            let taken = good && self.values.push(s.stamp, s.value.value);
            self.rejected += u64::from(!taken);
        }
        while let Some(s) = self.pose.next_sample() {
            let pose = good::pose(&s.value).filter(|_| good::stamp(s.stamp, now));
            let taken = pose.is_some_and(|p| self.poses.push(s.stamp, (p.translation.vector, p.rotation)));
            self.rejected += u64::from(!taken);
        }
        let delay_ns = (self.cfg.delay_s * 1e9) as u64;
        let instant = Stamp::from_ns(tick.deadline().ns().saturating_sub(delay_ns).max(1));
        match self.values.at(instant, &self.cfg) {
            Signal::Is { from, to, part, stamp } => {
                self.extrapolated += u64::from(self.values.ended(instant));
                self.resampled.write(&Scalar { stamp, value: from + part * (to - from) });
            }
            signal => self.too_old += u64::from(signal == Signal::TooOld),
        }
        match self.poses.at(instant, &self.cfg) {
            Signal::Is { from: (p, q), to: (to, turned), part, stamp } => {
                self.extrapolated += u64::from(self.poses.ended(instant));
                let turn = UnitQuaternion::from_scaled_axis((q.inverse() * turned).scaled_axis() * part);
                let pose =
                    Pose::from(nalgebra::Isometry3::from_parts((p + (to - p) * part).into(), q * turn));
                self.resampled_pose.write(&Pose { stamp, ..pose });
            }
            signal => self.too_old += u64::from(signal == Signal::TooOld),
        }
        Ok(())
    }
}

/// Knowledge of a signal at an instant.
#[derive(Clone, Copy, PartialEq)]
enum Signal<T> {
    /// No sample is as old as the instant.
    NotYet,
    /// The newest sample is too old.
    TooOld,
    /// The instant lies the part of the way between two samples, above 1 beyond the newest one; the value is
    /// as it was at `stamp`.
    Is { from: T, to: T, part: f64, stamp: Stamp },
}

impl<T> Signal<T> {
    fn held(value: T, stamp: Stamp) -> Signal<T>
    where
        T: Copy,
    {
        Signal::Is { from: value, to: value, part: 0.0, stamp }
    }
}

/// The last samples, the oldest overwritten.
struct Past<T> {
    last: [Option<(Stamp, T)>; MOST],
    seen: usize,
}

impl<T: Copy> Default for Past<T> {
    fn default() -> Self {
        Past { last: [None; MOST], seen: 0 }
    }
}

impl<T: Copy> Past<T> {
    fn push(&mut self, stamp: Stamp, value: T) -> bool {
        let goes_back = self.back(0).is_some_and(|(newest, _)| stamp <= newest);
        if goes_back || !stamp.is_valid() {
            return false;
        }
        self.last[self.seen % MOST] = Some((stamp, value));
        self.seen += 1;
        true
    }

    /// The newest, the one before, …
    fn back(&self, n: usize) -> Option<(Stamp, T)> {
        if n < self.seen.min(MOST) { self.last[(self.seen - 1 - n) % MOST] } else { None }
    }

    /// Whether the newest sample is before the instant.
    fn ended(&self, instant: Stamp) -> bool {
        self.back(0).is_some_and(|(newest, _)| instant > newest)
    }

    fn at(&self, instant: Stamp, cfg: &ResamplerConfig) -> Signal<T> {
        let Some(mut after) = self.back(0) else { return Signal::NotYet };
        if instant.seconds_since(after.0) > cfg.max_age_s {
            return Signal::TooOld;
        }
        for n in 1.. {
            // Before the first sample, and in a gap in which it could be anything, there is no signal.
            let before = self.back(n).filter(|before| after.0.seconds_since(before.0) <= cfg.max_age_s);
            let past = instant >= after.0;
            let Some(before) = before else {
                return if past { Signal::held(after.1, after.0) } else { Signal::NotYet };
            };
            if past && cfg.method == "hold" {
                return Signal::held(after.1, after.0);
            }
            if instant >= before.0 && cfg.method == "hold" {
                return Signal::held(before.1, before.0);
            }
            if instant >= before.0 {
                let (way, gone) = (after.0.seconds_since(before.0), instant.seconds_since(before.0));
                let most = way + cfg.ahead_s;
                // Carried on no further: the value stays as it was there.
                let ended = Stamp::from_ns(after.0.ns() + (cfg.ahead_s * 1e9) as u64);
                let stamp = if gone > most { ended } else { instant };
                return Signal::Is { from: before.1, to: after.1, part: gone.min(most) / way, stamp };
            }
            after = before;
        }
        Signal::NotYet
    }
}
