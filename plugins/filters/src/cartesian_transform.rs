//! Poses in another frame: a fixed transform from the configuration, or the newest one that comes in.
//!
//! Invariant: a sample that is not a pose, or is older than `max_age_s`, is left out, never repaired; a pose
//! is never multiplied with a transform that is so much older than itself.
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use trocar_sdk::data::{Pose, Transform};
use trocar_sdk::prelude::*;

use crate::good;

#[derive(Config)]
struct CartesianTransformConfig {
    /// Translation of the transform that holds as long as none has come in
    #[config(live, unit = "m", min = -1000.0, max = 1000.0, default = [0.0, 0.0, 0.0])]
    translation_m: [f64; 3],
    /// Unit quaternion x, y, z, w of it
    #[config(live, default = [0.0, 0.0, 0.0, 1.0])]
    rotation: [f64; 4],
    /// Whether the inverse is meant
    #[config(live, default = false)]
    inverse: bool,
    /// `before`: T · pose, another reference; `behind`: pose · T, another point of the tool
    #[config(live, one_of = ["before", "behind"], default = "before")]
    side: String,
    /// Oldest pose that is multiplied, and how much older than it the transform that came in may be; 0: any
    /// age
    #[config(live, min = 0.0, max = 3600.0, unit = "s", default = 0.1)]
    max_age_s: f64,
}

/// Multiplies poses with a transform.
#[derive(Component)]
#[component(rate_hz = 1000)]
pub struct CartesianTransform {
    #[input(fifo = 64)]
    pose: In<Pose>,
    /// Instead of the configured transform, from its first sample on
    #[input(optional)]
    transform: In<Transform>,
    #[output]
    transformed: Out<Pose>,
    /// Poses left out: none, too old, from far ahead, or the transform is too old.
    #[state]
    rejected: u64,
    /// Transforms left out: none, or from far ahead. The one before holds until it is too old.
    #[state]
    rejected_transforms: u64,
    #[config]
    cfg: CartesianTransformConfig,
    fixed: Isometry3<f64>,
    /// The newest good one that came in.
    live: Option<(Isometry3<f64>, Stamp)>,
    /// Whether ever one came in since Start: then the configured one is out of use.
    came: bool,
}

impl Component for CartesianTransform {
    fn configure(&mut self) -> Result {
        let CartesianTransformConfig { translation_m: [x, y, z], rotation: [i, j, k, w], .. } = self.cfg;
        let turn = Quaternion::new(w, i, j, k);
        if !turn.norm().is_finite() || (turn.norm() - 1.0).abs() > 1e-6 {
            return Err(
                format!("rotation: its norm is {}; give a unit quaternion x, y, z, w", turn.norm()).into()
            );
        }
        let turn = UnitQuaternion::new_normalize(turn);
        self.fixed = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.rejected, self.rejected_transforms) = (0, 0);
        (self.live, self.came) = (None, false);
        Ok(())
    }

    fn step(&mut self, t: &Tick) -> Result {
        let now = t.now();
        self.take_transform(now);
        let oldest_s = if self.cfg.max_age_s == 0.0 { f64::INFINITY } else { self.cfg.max_age_s };
        while let Some(sample) = self.pose.next_sample() {
            let young = good::stamp(sample.stamp, now) && now.seconds_since(sample.stamp) <= oldest_s;
            let pose = good::pose(&sample.value).filter(|_| young && !sample.stale);
            let live = self.live.filter(|(_, since)| sample.stamp.min(now).seconds_since(*since) <= oldest_s);
            let by = if self.came { live.map(|(by, _)| by) } else { Some(self.fixed) };
            let (Some(by), Some(pose)) = (by, pose) else {
                self.rejected += 1;
                continue;
            };
            let by = if self.cfg.inverse { by.inverse() } else { by };
            let other = if self.cfg.side == "behind" { pose * by } else { by * pose };
            self.transformed.write(&Pose { stamp: sample.stamp, ..other.into() });
        }
        Ok(())
    }
}

impl CartesianTransform {
    fn take_transform(&mut self, now: Stamp) {
        let Some(sample) = self.transform.sample() else { return };
        self.came = true;
        if sample.stale {
            self.live = None;
        } else if let Some(by) = good::pose(&sample.value.pose).filter(|_| good::stamp(sample.stamp, now)) {
            // From when it came at the latest, also when its clock is ahead.
            let known = self.live.filter(|_| !sample.fresh).map(|(_, since)| since);
            self.live = Some((by, known.unwrap_or(sample.stamp.min(now))));
        } else {
            self.rejected_transforms += u64::from(sample.fresh);
        }
    }
}
