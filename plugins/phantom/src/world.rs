//! The world as a whole: what is how far below a tip, at a time.
//!
//! Invariant: plain data and pure functions of it. Two plugins with equal worlds see the same eye, each with
//! a copy of its own; time is the host's monotonic clock in s.

use nalgebra::{Point3, UnitVector3, Vector3};

use crate::eye::{Eye, VITREOUS_INDEX};
use crate::motion::{Motion, Saccade, Step};
use crate::noise::Noise;
use crate::tissue::{EPITHELIUM_M, Echoes, Membrane, Place, Shade, echoes};

/// Streams of random numbers, one per use, so that none follows another.
pub(crate) mod streams {
    pub(crate) const PHASES: u64 = 1;
    pub(crate) const SPECKLE: u64 = 2;
    pub(crate) const HAND: u64 = 3;
    pub(crate) const PEELING: u64 = 4;
}

/// A vessel that stands out by so much begins to shade what is under it, and shades it most, m.
const VESSEL_M: [f64; 2] = [3e-6, 9e-6];
/// Amplitude that a vessel takes from what is under it, and that its blood adds to the layer it is in.
const SHADOW: f64 = 0.7;
const BLOOD: f64 = 0.4;

/// Longest way along the tool that is looked for the retina, m.
const FARTHEST_M: f64 = 25e-3;

/// Time from one jump to the next of the eye of the worlds `saccade` and `step`, s.
const AGAIN_S: f64 = 8.0;
/// Saccade of the world `saccade`: 0.3 mm to the side at 1 mm/s. Real ones are faster.
const SACCADE: Saccade = Saccade { at_s: 0.0, by_m: 0.3e-3, speed_m_s: 1e-3 };
/// Step of the world `step`: 50 µm deeper at once.
const STEP: Step = Step { at_s: 0.0, by_m: 50e-6 };

/// One simulated world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct World {
    pub seed: u64,
    pub eye: Eye,
    pub motion: Motion,
    pub membrane: Membrane,
}

/// The place of the eye that the tool points at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Below {
    /// From the tip to the first surface, membrane or ILM, along the tool, m.
    pub distance_m: f64,
    /// From the tip to the ILM, m.
    pub ilm_m: f64,
    /// From the tip to the pigment epithelium, m. Its depth below the globe is the same in the pit and under
    /// vessels as beside them, and counts along the tool, as that of all layers.
    pub epithelium_m: f64,
    /// Height of the membrane there, m; 0 where there is none.
    pub membrane_m: f64,
    /// Place on the eye, m: x and y of the ILM in the eye's own coordinates.
    pub at_m: [f64; 2],
}

impl World {
    /// Worlds by name: `default` moves and has a membrane; `no_membrane`; `static` does not move;
    /// `static_no_membrane`; `saccade` and `step` are `default` whose eye jumps besides, every 8 s there and
    /// half of that later back.
    pub const NAMES: [&str; 6] =
        ["default", "no_membrane", "static", "static_no_membrane", "saccade", "step"];

    /// The world of a name of [`World::NAMES`]; the seed decides phases of motion, speckle and all noise.
    pub fn named(name: &str, seed: u64) -> Option<World> {
        let (moves, membrane) = match name {
            "default" | "saccade" | "step" => (true, Membrane::DEFAULT),
            "no_membrane" => (true, Membrane::NONE),
            "static" => (false, Membrane::DEFAULT),
            "static_no_membrane" => (false, Membrane::NONE),
            _ => return None,
        };
        let phase = |place| std::f64::consts::TAU * Noise::new(seed, streams::PHASES).uniform(place);
        let mut motion = if moves { Motion::plausible(phase(0), phase(1)) } else { Motion::none() };
        // Time is that of the host's clock, which began long ago: what happens once would be over.
        let at_s = AGAIN_S * Noise::new(seed, streams::PHASES).uniform(2);
        match name {
            "saccade" => motion.saccade = Some(Saccade { at_s, ..SACCADE }),
            "step" => motion.step = Some(Step { at_s, ..STEP }),
            _ => {}
        }
        motion.again_s = (motion.saccade.is_some() || motion.step.is_some()).then_some(AGAIN_S);
        Some(World { seed, eye: Eye::default(), motion, membrane })
    }

    /// The same world, whose retina stands `by_m` deeper from `at_s` on, once.
    pub fn with_step(mut self, at_s: f64, by_m: f64) -> World {
        (self.motion.step, self.motion.again_s) = (Some(Step { at_s, by_m }), None);
        self
    }

    /// The random numbers of one use (`stream` is the caller's; those of the world itself are below 16).
    pub fn noise(&self, stream: u64) -> Noise {
        Noise::new(self.seed, stream)
    }

    /// z of the first surface (membrane or ILM) at `x`, `y` in the world at `t_s`, m.
    pub fn surface_z(&self, x: f64, y: f64, t_s: f64) -> f64 {
        let shift = self.motion.shift(t_s);
        let (x, y) = (x - shift.x, y - shift.y);
        self.eye.surface_z(x, y) - self.membrane.height(x, y) + shift.z
    }

    /// Returns what lies below a tool with its tip at `tip` (m) along `axis` at `t_s`; `None` when it points
    /// past the retina. A tip below a surface has a negative distance.
    pub fn below(&self, tip: &Point3<f64>, axis: &UnitVector3<f64>, t_s: f64) -> Option<Below> {
        let shift = self.motion.shift(t_s);
        let start = tip - shift;
        let ilm_m = meet(&start, axis, |x, y| self.eye.surface_z(x, y))?;
        let at = start + axis.as_ref() * ilm_m;
        let membrane_m = self.membrane.height(at.x, at.y);
        let distance_m = if membrane_m > 0.0 {
            meet(&start, axis, |x, y| self.eye.surface_z(x, y) - self.membrane.height(x, y))?
        } else {
            ilm_m
        };
        let epithelium_m = ilm_m + EPITHELIUM_M / VITREOUS_INDEX - self.eye.sunk_m(at.x, at.y) / axis.z;
        Some(Below { distance_m, ilm_m, epithelium_m, membrane_m, at_m: [at.x, at.y] })
    }

    /// Echoes of light from the tip along the tool.
    pub fn echoes(&self, below: &Below) -> Echoes {
        let [x, y] = below.at_m;
        // Along the tool the membrane lies as far before the ILM as the two distances say.
        let place = Place {
            at_m: below.at_m,
            membrane_m: VITREOUS_INDEX * below.distance_m,
            ilm_m: VITREOUS_INDEX * below.ilm_m,
            epithelium_m: VITREOUS_INDEX * below.epithelium_m,
            shade: self.shade(x, y),
        };
        echoes(self.noise(streams::SPECKLE), &place, VITREOUS_INDEX)
    }

    /// Light that the layers give back at `x`, `y` of the eye. Blood gives back more than the layers beside
    /// it, and leaves less for what lies under a vessel; the inner layers end where the pit begins.
    pub fn shade(&self, x: f64, y: f64) -> Shade {
        let deep = ((self.eye.vessel_m(x, y) - VESSEL_M[0]) / (VESSEL_M[1] - VESSEL_M[0])).clamp(0.0, 1.0);
        let vessel = deep * deep * (3.0 - 2.0 * deep);
        let borders = 1.0 - self.eye.pit(x, y);
        Shade { inner: (1.0 + BLOOD * vessel) * borders, borders, outer: 1.0 - SHADOW * vessel }
    }

    /// Velocity of the retina, m/s, in the world.
    pub fn velocity(&self, t_s: f64) -> Vector3<f64> {
        self.motion.velocity(t_s)
    }
}

/// Way from `start` along `axis` to the surface `z(x, y)`, m. Each round goes on by the height that is left:
/// surfaces are much flatter than the tool is steep, so a few rounds reach a picometre.
fn meet(start: &Point3<f64>, axis: &UnitVector3<f64>, z: impl Fn(f64, f64) -> f64) -> Option<f64> {
    if axis.z < 0.1 {
        return None;
    }
    let mut way = 0.0;
    for _ in 0..40 {
        let at = start + axis.as_ref() * way;
        let left = (z(at.x, at.y) - at.z) / axis.z;
        way += left;
        if !way.is_finite() || way.abs() > FARTHEST_M {
            return None;
        }
        if left.abs() < 1e-12 {
            break;
        }
    }
    Some(way)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight() -> UnitVector3<f64> {
        Vector3::z_axis()
    }

    #[test]
    fn straight_down_the_distance_is_the_difference_of_heights() {
        let world = World::named("default", 3).expect("a name");
        for n in 0..500 {
            let t = 0.01 * f64::from(n);
            let (x, y) = (1.4e-3 * (0.7 * t).sin(), 0.9e-3 * (1.9 * t).cos());
            let below = world.below(&Point3::new(x, y, -1e-3), &straight(), t).expect("over the retina");
            let height = world.surface_z(x, y, t) + 1e-3;
            assert!((below.distance_m - height).abs() < 1e-11, "{} instead of {height}", below.distance_m);
            assert!((below.ilm_m - below.distance_m - below.membrane_m).abs() < 1e-11);
        }
    }

    #[test]
    fn a_tilted_tool_meets_the_surface_where_its_line_does() {
        let world = World::named("static", 3).expect("a name");
        let axis = UnitVector3::new_normalize(Vector3::new(0.3, -0.2, 1.0));
        let tip = Point3::new(-0.3e-3, 0.4e-3, -1.1e-3);
        let below = world.below(&tip, &axis, 0.0).expect("over the retina");
        let at = tip + axis.as_ref() * below.distance_m;
        assert!((world.surface_z(at.x, at.y, 0.0) - at.z).abs() < 1e-10);
    }

    #[test]
    fn a_tool_that_points_away_meets_nothing() {
        let world = World::named("default", 3).expect("a name");
        let up = UnitVector3::new_normalize(Vector3::new(0.0, 0.0, -1.0));
        assert_eq!(world.below(&Point3::new(0.0, 0.0, -1e-3), &up, 0.0), None);
        let aside = UnitVector3::new_normalize(Vector3::new(1.0, 0.0, 0.01));
        assert_eq!(world.below(&Point3::new(0.0, 0.0, -1e-3), &aside, 0.0), None);
    }

    #[test]
    fn the_eyes_of_saccade_and_step_jump_there_and_back_at_any_time_of_the_clock() {
        for (name, axis, by_m) in [("saccade", 0, 0.3e-3), ("step", 2, 50e-6)] {
            let (world, calm) =
                (World::named(name, 7).expect("a name"), World::named("default", 7).expect("a name"));
            for begin_s in [0.0, 30_000.0] {
                let jumps: Vec<f64> = (0..=(100.0 * AGAIN_S) as u32)
                    .map(|n| begin_s + 0.01 * f64::from(n))
                    .map(|t| (world.motion.shift(t) - calm.motion.shift(t))[axis])
                    .collect();
                let there = jumps.iter().filter(|by| (**by - by_m).abs() < 1e-12).count() as f64;
                let here = jumps.iter().filter(|by| by.abs() < 1e-12).count() as f64;
                let half = 0.5 * jumps.len() as f64;
                assert!(
                    (there / half - 1.0).abs() < 0.1 && (here / half - 1.0).abs() < 0.1,
                    "{name}: {there}, {here}"
                );
            }
            assert_ne!(world.motion, World::named(name, 8).expect("a name").motion);
        }
        assert!(World::NAMES.iter().all(|name| World::named(name, 1).is_some()));
    }

    #[test]
    fn the_first_echo_is_the_true_surface_and_the_membranes_lower_side_is_6_to_9_um_below_it() {
        let world = World::named("static", 3).expect("a name");
        let mut lower_sides = 0;
        for n in 0..3000 {
            let (x, y) = (1e-6 * f64::from(n) - 1.5e-3, 0.05e-3);
            let below = world.below(&Point3::new(x, y, -1e-3), &straight(), 0.0).expect("over the retina");
            let echoes = world.echoes(&below);
            let paths: Vec<f64> = echoes.as_slice().iter().map(|echo| echo.path_m / VITREOUS_INDEX).collect();
            // A membrane of less than 0.5 µm has no echo of its own.
            assert!((paths[0] - below.distance_m).abs() < 0.5e-6 + 1e-12, "{} at {x}", paths[0]);
            let ilm = echoes.as_slice().iter().position(|echo| echo.tissue.is_some()).expect("tissue") - 1;
            assert!((paths[ilm] - below.ilm_m).abs() < 1e-12);
            if ilm == 2 {
                lower_sides += 1;
                let thick_m = paths[1] - paths[0];
                assert!((6e-6..=9e-6).contains(&thick_m) && paths[1] < paths[2], "{thick_m} m at {x}");
            }
        }
        assert!(lower_sides > 500, "{lower_sides}");
    }

    #[test]
    fn seeds_make_different_worlds_and_equal_ones_agree_to_the_bit() {
        let of = |seed| World::named("default", seed).expect("a name");
        assert_eq!(of(4), of(4));
        assert_ne!(of(4).motion, of(5).motion);
        let tip = Point3::new(0.1e-3, 0.0, -1e-3);
        let echoes = |seed| {
            let world = World { motion: Motion::none(), ..of(seed) };
            world.echoes(&world.below(&tip, &straight(), 0.0).expect("over the retina"))
        };
        assert_eq!(echoes(4), echoes(4));
        assert_ne!(echoes(4), echoes(5));
        assert!(World::named("flat", 1).is_none());
    }
}
