//! The light in the eye.
//!
//! Invariant: light on a surface is a function of its place and direction alone; nothing casts shadows here
//! (`shadow` does).

use nalgebra::{Point3, Vector3};

/// The lamp in the eye: a light pipe, brought in beside the field on the other side than the tool and pointed
/// near the apex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Its end, m, in the world.
    pub at: Point3<f64>,
    /// Middle of its spot, m, in the world.
    pub points_at: Point3<f64>,
    /// Radius of its round end, m: the light of a wide-angle pipe.
    pub radius_m: f64,
    /// Cosines of the half angles where its spot begins to fade and where it has faded.
    pub fades: [f64; 2],
    /// Light that comes from everywhere, as a part of the lamp's at the apex.
    pub ambient: f64,
}

impl Default for Lamp {
    fn default() -> Self {
        Lamp {
            at: Point3::new(-2.5e-3, -6.5e-3, -14e-3),
            points_at: Point3::new(0.4e-3, 0.2e-3, 0.0),
            radius_m: 0.45e-3,
            fades: [0.998, 0.94],
            ambient: 0.13,
        }
    }
}

impl Lamp {
    /// The lamp's own part of the light on a surface with this outward normal: Lambert's cosine, fading with
    /// the square of the distance and beside the spot; about 1 at the apex.
    pub fn light(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let (to_lamp, to_apex) = (self.at - at, self.at - Point3::origin());
        let (way2, apex2) = (to_lamp.norm_squared(), to_apex.norm_squared());
        let cosine = (to_lamp.dot(normal) / way2.sqrt()).max(0.0);
        let middle = self.at - self.points_at;
        let beside = to_lamp.dot(&middle) / (way2 * middle.norm_squared()).sqrt();
        let [full, dark] = self.fades;
        let spot = ((beside - dark) / (full - dark)).clamp(0.0, 1.0);
        cosine * apex2 / way2 * spot * spot * (3.0 - 2.0 * spot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lamp_is_brightest_where_it_points_and_dark_beside_its_spot() {
        let lamp = Lamp::default();
        let up = -Vector3::z();
        let apex = lamp.light(&Point3::origin(), &up);
        assert!((0.8..1.1).contains(&apex), "{apex}");
        assert!(lamp.light(&Point3::new(3.5e-3, 3e-3, -1e-3), &up) < 0.6 * apex);
        assert_eq!(lamp.light(&Point3::new(11e-3, 9e-3, 0.0), &up), 0.0);
        assert_eq!(lamp.light(&Point3::origin(), &-up), 0.0, "a side that looks away");
    }
}
