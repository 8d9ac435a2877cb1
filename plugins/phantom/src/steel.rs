//! The colour of the tool's steel where it is seen, and the part of a pixel that it covers.
//!
//! Invariant: a function of place and direction; a colour is told also a little beside the outline, where the
//! edge is soft.

use nalgebra::{Point3, Vector3};

use crate::defocus;
use crate::scenery::{Line, Scenery};

/// Colour of the steel in white light, levels.
const STEEL: [f64; 3] = [158.0, 161.0, 166.0];
/// Mirror image in the steel's sides: the lit retina, levels.
const RETINA: [f64; 3] = [120.0, 44.0, 28.0];
/// The lamp's streak, its glow beside it, and the microscope's streak: levels, and how narrow each is.
const STREAKS: [(f64, i32); 3] = [(190.0, 100), (34.0, 10), (46.0, 70)];
/// Lamp light that steel scatters, and microscope light.
const DIFFUSE: [f64; 2] = [0.38, 0.34];

/// Highlights above this are seen as streaks, levels.
const STREAK: f64 = 8.0;
/// A tool of a smaller radius is thin, px.
const THIN_PX: f64 = 18.0;

/// No picture is wider, px.
const FARTHEST_PX: f64 = 65_536.0;

/// The tool as one pixel shows it.
#[derive(Clone, Copy, Default)]
pub(crate) struct Seen {
    /// Light from the tool: red, green, blue, levels.
    pub(crate) light: [f32; 3],
    /// Part of the pixel that the tool covers, 0 to 1.
    pub(crate) covered: f32,
    /// Columns beside it are not between it and the next ones: a streak is there, or the tool is thin.
    pub(crate) fine: bool,
    /// So many columns to each side show nothing of the tool either.
    pub(crate) clear: usize,
}

/// Returns the tool as column `x` of a line shows it.
pub(crate) fn seen(scenery: &Scenery<'_>, line: &Line<'_>, x: usize) -> Seen {
    let way = line.way(x).normalize();
    let (tool, camera) = (scenery.tool, &scenery.eye.camera);
    let passing = tool.pass(line.from(), &way);
    let depth = (passing.core - line.from()).dot(&way);
    let gap_px = passing.gap_m * camera.focal_px / depth;
    let edge_px = defocus::edge_px(camera, passing.core.z);
    // Written so that a place that is no number shows nothing.
    if !(gap_px < edge_px && depth > 0.0) {
        // A tenth is left for lenses that bend and for edges that grow wider.
        return Seen { clear: (0.9 * (gap_px - edge_px)).min(FARTHEST_PX) as usize, ..Seen::default() };
    }
    let covered = (0.5 - 0.5 * gap_px / edge_px).min(1.0) as f32;
    let covered = covered * covered * (3.0 - 2.0 * covered);
    let (at, normal) = match tool.meet(line.from(), &way) {
        Some(far) => {
            let at = line.from() + way * far;
            (at, tool.normal(&at))
        }
        // Beside the outline the steel looks as on it.
        None => (passing.core, passing.beside.normalize()),
    };
    let (light, streaks) = colour(scenery, &at, &normal, &way);
    let thin = (at - passing.core).norm() * camera.focal_px / depth < THIN_PX;
    let light = light.map(|level| level.min(255.0) * covered);
    Seen { light, covered, fine: thin || streaks > STREAK, clear: 0 }
}

/// Diffuse light, what the steel mirrors, and highlights (J. Blinn, *Models of light reflection for computer
/// synthesized pictures*, 1977) of the lamp and of the microscope's own light, which comes from where the
/// camera is. A shaft is turned: its fine grooves scatter along the axis, so only directions across it count,
/// and highlights are streaks along the shaft (G. Ward, *Measuring and modeling anisotropic reflection*,
/// 1992). Levels of the three colours, and what of them is of the narrow highlights.
fn colour(
    scenery: &Scenery<'_>,
    at: &Point3<f64>,
    normal: &Vector3<f64>,
    way: &Vector3<f64>,
) -> ([f32; 3], f64) {
    let (lamp, axis) = (scenery.lamp, scenery.tool.axis.as_ref());
    let across = |to: Vector3<f64>| (to - axis * axis.dot(&to)).try_normalize(1e-6).unwrap_or(*normal);
    let to_lamp = (lamp.at - at).normalize();
    let around = across(*normal);
    // Round ends face the eye as they are.
    let facing = around.dot(&across(-way)).max(-normal.dot(way)).clamp(0.0, 1.0);
    let shining = around.dot(&across(to_lamp - way)).max(0.0);
    // The shaft far above the retina is beside the lamp's beam.
    let beam = (1.0 + at.z / 14e-3).clamp(0.25, 1.0);
    let light =
        lamp.ambient + DIFFUSE[0] * around.dot(&across(to_lamp)).max(0.0) * beam + DIFFUSE[1] * facing;
    let [lamps, glow, scopes] = STREAKS;
    let narrow = beam * lamps.0 * shining.powi(lamps.1) + scopes.0 * facing.powi(scopes.1);
    let streaks = narrow + beam * glow.0 * shining.powi(glow.1);
    // The side that looks away from the lamp mirrors the retina; the limb is dark.
    let lower = 1.0 - 0.5 * (1.0 + shining);
    let retina = beam * (0.25 + 1.3 * lower) * (1.0 - 0.6 * facing);
    let limb = 0.5 + 0.5 * (facing * 2.5).min(1.0);
    (std::array::from_fn(|i| ((STEEL[i] * light + RETINA[i] * retina) * limb + streaks) as f32), narrow)
}
