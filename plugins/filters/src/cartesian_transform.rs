//! Poses in another frame: a fixed transform from the configuration, or the newest one that comes in.
//!
//! Invariant: what is not a pose, and what comes while the transform is stale or none, is left out, never repaired.
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use trocar_sdk::data::{Pose, Transform};
use trocar_sdk::prelude::*;

#[derive(Config)]
struct CartesianTransformConfig {
    /// Of the transform that holds while none comes in
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
    /// Poses left out: none, or the transform is none or stale.
    #[state]
    rejected: u64,
    #[config]
    cfg: CartesianTransformConfig,
    fixed: Isometry3<f64>,
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
        self.rejected = 0;
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let live = self.transform.sample();
        let by = match &live {
            Some(live) if live.stale => None,
            Some(live) => live.value.isometry().ok(),
            None => Some(self.fixed),
        };
        let by = by.map(|by| if self.cfg.inverse { by.inverse() } else { by });
        while let Some(sample) = self.pose.next_sample() {
            let (Some(by), Ok(pose)) = (by, sample.value.isometry()) else {
                self.rejected += 1;
                continue;
            };
            let other = if self.cfg.side == "behind" { pose * by } else { by * pose };
            self.transformed.write(&Pose { stamp: sample.stamp, ..other.into() });
        }
        Ok(())
    }
}
