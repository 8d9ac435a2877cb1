//! Forces of the eye on a tool: of the retina at its tip, and of the sclera where it enters.
//!
//! Invariant: pure in world, pose, velocity and time; positive is what the eye does to the tool, in the axes
//! of the world. Stick and slip of peeling depends on the place alone, so it needs no memory of the way
//! there.

use nalgebra::{Point3, UnitVector3, Vector3};

use crate::world::{World, streams};

/// Stiffness of the retina at a tip that presses on it, N/m (0.15 mN/µm).
pub const RETINA_N_M: f64 = 150.0;

/// Stiffness of the sclera against a shaft that is pulled aside at its entry, N/m (20 mN/mm).
pub const SCLERA_N_M: f64 = 20.0;

/// Point at which the tool enters the eye while the eye does not move, m: on the globe, opposite of the
/// retina's apex, so that the tool of a robot at home stands in it without force.
pub const ENTRY_M: [f64; 3] = [0.0, 0.0, -24e-3];

/// A membrane lets go at these forces, N, one for each tooth.
const PEEL_N: [f64; 2] = [7e-3, 20e-3];

/// Way from one slip of a membrane to the next, m.
const TOOTH_M: f64 = 80e-6;

/// Peeling slower than this pulls less than it could, m/s.
const SLOW_M_S: f64 = 20e-6;

/// A membrane thinner than this is none, m.
const THINNEST_M: f64 = 1e-6;

impl World {
    /// Force at the tip, N: along the tool `RETINA_N_M` times the depth below the ILM; against a motion to
    /// the side the pull of a membrane that the tip is in, which grows to 7 to 20 mN and slips, again and
    /// again. `velocity` is the tip's, m/s.
    pub fn tip_force(
        &self,
        tip: &Point3<f64>,
        axis: &UnitVector3<f64>,
        velocity: &Vector3<f64>,
        t_s: f64,
    ) -> Vector3<f64> {
        let Some(below) = self.below(tip, axis, t_s) else { return Vector3::zeros() };
        let mut force = Vector3::zeros();
        if below.ilm_m < 0.0 {
            force += axis.as_ref() * (RETINA_N_M * below.ilm_m);
        }
        if below.membrane_m > THINNEST_M && below.distance_m < 0.0 {
            force += self.peeling(&below.at_m, axis, &(velocity - self.velocity(t_s)));
        }
        force
    }

    fn peeling(&self, at_m: &[f64; 2], axis: &UnitVector3<f64>, velocity: &Vector3<f64>) -> Vector3<f64> {
        let aside = velocity - axis.as_ref() * velocity.dot(axis);
        let speed = aside.norm();
        if speed < 1e-9 {
            return Vector3::zeros();
        }
        let towards = aside / speed;
        let teeth = (at_m[0] * towards.x + at_m[1] * towards.y) / TOOTH_M;
        let tooth = teeth.floor();
        let strength = self.noise(streams::PEELING).uniform(tooth as i64 as u64);
        let peak = PEEL_N[0] + (PEEL_N[1] - PEEL_N[0]) * strength;
        towards * (-peak * (teeth - tooth) * speed / (speed + SLOW_M_S))
    }

    /// Force of the sclera on the shaft, N: towards the entry, which moves with the eye. None before the tip
    /// is inside.
    pub fn sclera_force(&self, tip: &Point3<f64>, axis: &UnitVector3<f64>, t_s: f64) -> Vector3<f64> {
        let to_entry = Point3::from(ENTRY_M) + self.motion.shift(t_s) - tip;
        let along = to_entry.dot(axis);
        if along >= 0.0 { Vector3::zeros() } else { (to_entry - axis.as_ref() * along) * SCLERA_N_M }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(name: &str) -> World {
        World::named(name, 4).expect("a name")
    }

    #[test]
    fn a_tip_above_the_retina_feels_nothing_and_below_it_the_stiffness_along_the_tool() {
        let world = world("static_no_membrane");
        let axis = Vector3::z_axis();
        let surface = world.surface_z(0.2e-3, 0.0, 0.0);
        let press = |depth: f64| {
            world.tip_force(&Point3::new(0.2e-3, 0.0, surface + depth), &axis, &Vector3::x(), 0.0)
        };
        assert_eq!(press(-1e-6), Vector3::zeros());
        let force = press(20e-6);
        assert!((force - Vector3::new(0.0, 0.0, -3e-3)).norm() < 1e-9, "20 µm are 3 mN: {force:?}");
    }

    #[test]
    fn peeling_pulls_against_the_motion_in_teeth_of_7_to_20_millinewton() {
        let world = world("static");
        let (axis, speed) = (Vector3::z_axis(), 1e-3);
        // The retina rises away from the pit: at the end of the way the tip is some 40 µm deep.
        let z = world.surface_z(0.45e-3, 0.0, 0.0) + 5e-6;
        let (mut peaks, mut before) = (Vec::new(), 0.0);
        for n in 0..3_000 {
            let tip = Point3::new(0.45e-3 + 0.1e-6 * f64::from(n), 0.0, z);
            let force = world.tip_force(&tip, &axis, &(Vector3::x() * speed), 0.0);
            assert!(force.x <= 0.0 && force.y == 0.0, "{force:?}");
            let pull = -force.x;
            if pull < 0.5 * before {
                peaks.push(before);
            }
            before = pull;
        }
        assert!(peaks.len() >= 3, "{peaks:?}");
        assert!(peaks.iter().all(|peak| (6.5e-3..20e-3).contains(peak)), "{peaks:?}");
        let still = world.tip_force(&Point3::new(0.6e-3, 0.0, z), &axis, &Vector3::zeros(), 0.0);
        assert_eq!(still, Vector3::zeros());
    }

    #[test]
    fn the_sclera_pulls_the_shaft_to_its_entry_and_lets_it_turn_there() {
        let world = world("static");
        let aside = world.sclera_force(&Point3::new(1e-3, 0.0, -1e-3), &Vector3::z_axis(), 0.0);
        assert!((aside - Vector3::new(-20e-3, 0.0, 0.0)).norm() < 1e-12, "1 mm aside is 20 mN: {aside:?}");
        let entry = Point3::from(ENTRY_M);
        let axis = UnitVector3::new_normalize(Vector3::new(0.2, -0.1, 1.0));
        let turned = world.sclera_force(&(entry + axis.as_ref() * 20e-3), &axis, 0.0);
        assert!(turned.norm() < 1e-12, "{turned:?}");
        let outside = Point3::new(5e-3, 0.0, -30e-3);
        assert_eq!(world.sclera_force(&outside, &Vector3::z_axis(), 0.0), Vector3::zeros());
    }
}
