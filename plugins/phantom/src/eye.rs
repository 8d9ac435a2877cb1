//! The shape of the eye: a globe with a foveal pit and raised vessels, seen from inside.
//!
//! Invariant: z points down into the eye, the nominal apex of the retina is the origin, and the shape does
//! not move: motion is added by `World`.

use crate::retina::Retina;

/// Refractive index of the vitreous body.
pub const VITREOUS_INDEX: f64 = 1.336;

/// Shape of the inner surface of the retina (ILM), m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// Radius of the globe: half of the axial length of 23.5 mm, rounded (PMC4276342).
    pub globe_radius_m: f64,
    /// Depth of the foveal pit below the globe.
    pub pit_depth_m: f64,
    /// Distance from the middle at which the pit has 1/e of its depth.
    pub pit_radius_m: f64,
    /// Are vessels raised?
    pub vessels: bool,
}

impl Default for Eye {
    fn default() -> Self {
        Eye { globe_radius_m: 12e-3, pit_depth_m: 100e-6, pit_radius_m: 0.5e-3, vessels: true }
    }
}

impl Eye {
    /// z of the surface at `x`, `y`: `sqrt(R² − r²) − R + pit − vessels`, in m. Beyond the globe, the rim's.
    pub fn surface_z(&self, x: f64, y: f64) -> f64 {
        let (radius, r2) = (self.globe_radius_m, x * x + y * y);
        let globe = (radius * radius - r2).max(0.0).sqrt() - radius;
        globe + self.sunk_m(x, y)
    }

    /// Depth of the pit at `x`, `y`, as a part of that in its middle.
    pub fn pit(&self, x: f64, y: f64) -> f64 {
        (-(x * x + y * y) / (self.pit_radius_m * self.pit_radius_m)).exp()
    }

    /// Depth of the ILM below the globe at `x`, `y`, m: the pit's, less than nothing on a vessel.
    pub fn sunk_m(&self, x: f64, y: f64) -> f64 {
        self.pit_depth_m * self.pit(x, y) - self.vessel_m(x, y)
    }

    /// Height by which a vessel stands out at `x`, `y`, m; 0 beside vessels.
    pub fn vessel_m(&self, x: f64, y: f64) -> f64 {
        if !self.vessels {
            return 0.0;
        }
        let (u, v) = self.along(x, y);
        Retina::shared().bump_at(u, v)
    }

    /// The place of `x`, `y` on the retina: m along the globe from the apex, in x and y direction
    /// (equidistant projection).
    pub fn along(&self, x: f64, y: f64) -> (f64, f64) {
        let r = x.hypot(y);
        let sine = (r / self.globe_radius_m).min(1.0);
        let stretch = if sine < 1e-6 { 1.0 } else { sine.asin() / sine };
        (x * stretch, y * stretch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pit_is_the_deepest_place_and_the_retina_rises_to_the_sides() {
        let eye = Eye { vessels: false, ..Eye::default() };
        assert!((eye.surface_z(0.0, 0.0) - 100e-6).abs() < 1e-12);
        let at = |r: f64| eye.surface_z(r, 0.0);
        assert!(at(0.0) > at(0.2e-3) && at(0.2e-3) > at(1e-3) && at(1e-3) > at(3e-3));
        // 1.5 mm from the apex the globe has risen by R − sqrt(R² − r²) = 94.1 µm.
        assert!((at(1.5e-3) + 94.1e-6).abs() < 0.1e-6, "{}", at(1.5e-3));
    }

    #[test]
    fn vessels_rise_towards_the_lens_by_20_micrometres_at_most() {
        let (with, without) = (Eye::default(), Eye { vessels: false, ..Eye::default() });
        let mut highest = 0.0_f64;
        for n in 0..10_000 {
            let (x, y) = (f64::from(n % 100) * 60e-6 - 3e-3, f64::from(n / 100) * 60e-6 - 3e-3);
            let raised = without.surface_z(x, y) - with.surface_z(x, y);
            assert!((-1e-12..=20.1e-6).contains(&raised), "{raised:e} at {x}, {y}");
            highest = highest.max(raised);
        }
        assert!(highest > 8e-6, "{highest:e}");
    }
}
