//! The sensor behind the interface: bias, range, and the force at one place of the tool.
//!
//! Invariant: no clock and no allocation; a bias is a mean of real samples, taken only when there are enough
//! of them.

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};
use trocar_phantom::World;

/// Samples whose mean is taken as zero.
const MEAN_OF: usize = 32;

/// Place of the sensor in the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Site {
    /// At the tip: the retina.
    #[default]
    Tip,
    /// In the shaft: the sclera where the tool enters.
    Sclera,
}

/// Force of the eye on the tool at `site`, in the frame of the tip, N.
pub(crate) fn load(
    world: &World,
    site: Site,
    tip: &Isometry3<f64>,
    velocity: &Vector3<f64>,
    t_s: f64,
) -> Vector3<f64> {
    let axis = UnitVector3::new_normalize(tip.rotation * Vector3::z());
    let at = Point3::from(tip.translation.vector);
    let force = match site {
        Site::Tip => world.tip_force(&at, &axis, velocity, t_s),
        Site::Sclera => world.sclera_force(&at, &axis, t_s),
    };
    tip.rotation.inverse() * force
}

/// Bias and range of a sensor with three axes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gauge {
    bias: Vector3<f64>,
    recent: [Vector3<f64>; MEAN_OF],
    taken: usize,
    overloaded: bool,
}

impl Gauge {
    /// Takes one sample (N): what is left of it without the bias.
    pub(crate) fn take(&mut self, raw: &Vector3<f64>) -> Vector3<f64> {
        self.recent[self.taken % MEAN_OF] = *raw;
        self.taken += 1;
        raw - self.bias
    }

    /// A sample could not be taken: the mean begins anew.
    pub(crate) fn miss(&mut self) {
        self.taken = 0;
    }

    /// Takes the mean of the last samples as zero; tells how many are missing where there are too few.
    pub(crate) fn zero(&mut self) -> Result<(), usize> {
        if self.taken < MEAN_OF {
            return Err(MEAN_OF - self.taken);
        }
        self.bias = self.recent.iter().sum::<Vector3<f64>>() / MEAN_OF as f64;
        Ok(())
    }

    /// Compares a load (N) with the range: whether it is outside now, where that is another answer than
    /// before.
    pub(crate) fn compare(&mut self, load: &Vector3<f64>, range_n: f64) -> Option<bool> {
        let outside = load.amax() > range_n;
        let changed = outside != self.overloaded;
        self.overloaded = outside;
        changed.then_some(outside)
    }

    /// The force that is taken as zero, N.
    pub(crate) fn bias(&self) -> Vector3<f64> {
        self.bias
    }
}
