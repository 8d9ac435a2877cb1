//! Samples that come as they like, on the grid of this component.
//!
//! Invariant: an output is never older than its step: it is the signal `delay_s` before the deadline. Between samples it is
//! interpolated; beyond the newest one it is carried on for `ahead_s` and told as such.
use nalgebra::{UnitQuaternion, Vector3};
use trocar_sdk::data::{Pose, Scalar};
use trocar_sdk::prelude::*;

/// Samples that are remembered.
const MOST: usize = 64;

#[derive(Config)]
struct ResamplerConfig {
    /// `linear` (orientations on the shortest arc), or `hold`: the newest sample before the instant
    #[config(live, one_of = ["linear", "hold"], default = "linear")]
    method: String,
    /// How long before now the instant lies; a little more than the time between two samples gives pure interpolation
    #[config(live, min = 0.0, max = 10.0, unit = "s", default = 0.02)]
    delay_s: f64,
    /// How far beyond the newest sample its motion is carried on; then it is held
    #[config(live, min = 0.0, max = 10.0, unit = "s", default = 0.02)]
    ahead_s: f64,
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
    /// Samples left out: no number, no pose, without a stamp, or back in time.
    #[state]
    rejected: u64,
    /// Outputs since Start that lie beyond the newest sample.
    #[state]
    extrapolated: u64,
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
    fn start(&mut self) -> Result {
        (self.rejected, self.extrapolated) = (0, 0);
        self.clear();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        while let Some(s) = self.value.next_sample() {
            let taken = s.value.value.is_finite() && self.values.push(s.stamp, s.value.value);
            self.rejected += u64::from(!taken);
        }
        while let Some(s) = self.pose.next_sample() {
            let pose = s.value.isometry().ok().map(|pose| (pose.translation.vector, pose.rotation));
            let taken = pose.is_some_and(|pose| self.poses.push(s.stamp, pose));
            self.rejected += u64::from(!taken);
        }
        let delay_ns = (self.cfg.delay_s * 1e9) as u64;
        let instant = Stamp::from_ns(tick.deadline().ns().saturating_sub(delay_ns).max(1));
        if let Some((a, b, part)) = self.values.around(instant, &self.cfg, &mut self.extrapolated) {
            self.resampled.write(&Scalar { stamp: instant, value: a + part * (b - a) });
        }
        if let Some(((p, q), (to, turned), part)) =
            self.poses.around(instant, &self.cfg, &mut self.extrapolated)
        {
            let turn = UnitQuaternion::from_scaled_axis((q.inverse() * turned).scaled_axis() * part);
            let pose = Pose::from(nalgebra::Isometry3::from_parts((p + (to - p) * part).into(), q * turn));
            self.resampled_pose.write(&Pose { stamp: instant, ..pose });
        }
        Ok(())
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

    /// Two samples and the part of the way from one to the other at which the instant lies; above 1 beyond the newest.
    fn around(&self, instant: Stamp, cfg: &ResamplerConfig, beyond: &mut u64) -> Option<(T, T, f64)> {
        let (newest, value) = self.back(0)?;
        let hold = cfg.method == "hold";
        if instant > newest {
            *beyond += 1;
        }
        let mut after = (newest, value);
        for n in 1.. {
            // Before the first sample there is no signal.
            let Some(before) = self.back(n) else {
                return (instant >= after.0).then_some((after.1, after.1, 0.0));
            };
            if hold && instant >= after.0 {
                return Some((after.1, after.1, 0.0));
            }
            if instant >= before.0 {
                let way = after.0.seconds_since(before.0);
                let gone = instant.seconds_since(before.0).min(way + cfg.ahead_s);
                let part = if hold { 0.0 } else { gone / way };
                return Some((before.1, after.1, part));
            }
            after = before;
        }
        None
    }
}
