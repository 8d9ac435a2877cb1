//! Light that the retina's smooth inner surface throws back: reflexes around the fovea and along vessels, as
//! young eyes have them.
//!
//! Invariant: a function of place, lamp and eye. The reflexes are small and move little from one eye to the
//! other, so that what a matcher finds stays right.

use nalgebra::{Point3, Vector3};

use crate::lamp::Lamp;
use crate::noise::Noise;
use crate::retina::Retina;

/// Colour of a full reflex, levels: white, a little warm.
const COLOUR: [f32; 3] = [255.0, 238.0, 214.0];
/// Strength of the reflex of the lamp on vessels, and how narrow it is.
const VESSEL: f64 = 0.42;
const VESSEL_POWER: i32 = 120;
/// Strength of the sheen of the nerve fibres beside vessels.
const SHEEN: f64 = 0.05;
/// The ring reflex on the rim of the fovea: strength, radius (m), and half its width (m).
const RING: [f64; 3] = [0.14, 0.85e-3, 0.08e-3];
/// The reflex of the foveal pit, which is a hollow mirror: strength, distance from its middle on the side
/// that faces the lamp (m), and size (m).
const PIT: [f64; 3] = [0.42, 0.1e-3, 0.035e-3];
/// Places beside each other from which the slope of a vessel is taken, m.
const BESIDE_M: f64 = 20e-6;
/// Height of a vessel that shines, m: from the first on, and fully from the second on.
const HIGH_M: [f64; 2] = [8e-6, 14e-6];
/// Random numbers of the reflexes' gaps.
const GAPS_STREAM: u64 = 0x676c_696e;

/// Light that is thrown back at `at` (m, at rest) towards `eye`, of 255; `slopes` are those of globe and pit,
/// `u` and `v` m along the retina.
pub(crate) fn at(
    [at, eye]: [&Point3<f64>; 2],
    [u, v]: [f64; 2],
    slopes: [f64; 2],
    lamp: &Lamp,
    noise: Noise,
) -> [f32; 3] {
    let retina = Retina::shared();
    let bump = |x: f64, y: f64| retina.bump_at(u + x * BESIDE_M, v + y * BESIDE_M);
    let to_lamp = (lamp.at - at).normalize();
    let half = (to_lamp + (eye - at).normalize()).normalize();
    let beside = [bump(2.0, 0.0), bump(-2.0, 0.0), bump(0.0, 2.0), bump(0.0, -2.0)];
    let high = beside.into_iter().fold(0.0, f64::max);
    let (rises, raised) = if high > HIGH_M[0] {
        let rise = |one: f64, other: f64| (one - other) / (2.0 * BESIDE_M);
        let rises = [rise(bump(1.0, 0.0), bump(-1.0, 0.0)), rise(bump(0.0, 1.0), bump(0.0, -1.0))];
        let raised = ((high - HIGH_M[0]) / (HIGH_M[1] - HIGH_M[0])).min(1.0);
        (rises, raised * (rises[0].hypot(rises[1]) / 0.08).min(1.0))
    } else {
        ([0.0; 2], 0.0)
    };
    let normal = Vector3::new(slopes[0] - rises[0], slopes[1] - rises[1], -1.0).normalize();
    let lobe = normal.dot(&half).max(0.0);
    let gaps = noise.part(GAPS_STREAM);
    let patchy = patches(gaps, u / 0.22e-3, v / 0.22e-3);
    let vessel = VESSEL * raised * patchy * lobe.powi(VESSEL_POWER);
    let sheen = SHEEN * patchy * lobe.powi(30);
    let fovea = if u.hypot(v) < 1.5 * RING[1] { fovea([u, v], &to_lamp, patchy) } else { 0.0 };
    let light = lamp.light(at, &-Vector3::z()).min(1.0);
    let all = (light * (vessel + sheen + fovea)) as f32;
    COLOUR.map(|colour| colour * all)
}

/// Reflexes of the fovea: of its rim, which is not in the surface of the phantom (its pit has no wall around
/// it), and of its pit.
fn fovea([u, v]: [f64; 2], to_lamp: &Vector3<f64>, patchy: f64) -> f64 {
    let [strength, radius, wide] = RING;
    let off = (u.hypot(1.12 * v) - radius * (0.94 + 0.12 * patchy)) / wide;
    let turn = (u * to_lamp.x + v * to_lamp.y) / u.hypot(v).max(1e-9);
    let ring = strength * (-off * off).exp() * (0.15 + 0.85 * patchy) * (0.65 - 0.5 * turn).max(0.1);
    let [strength, beside, size] = PIT;
    let flat = to_lamp.xy().normalize() * -beside;
    let off = [(u - flat.x) / size, (v - flat.y) / size];
    let across = (off[0] * flat.y - off[1] * flat.x) / beside;
    let outwards = (off[0] * flat.x + off[1] * flat.y) / beside;
    // A crescent: it bends around the pit.
    let bent = outwards + 0.16 * across * across;
    ring + strength * (-bent * bent - 0.22 * across * across).exp()
}

/// Smooth random patches, 0 to 1; a patch is about one unit wide.
fn patches(noise: Noise, x: f64, y: f64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let smooth = |part: f64| part * part * (3.0 - 2.0 * part);
    let (fx, fy) = (smooth(x - column), smooth(y - row));
    let at = |dx: i64, dy: i64| {
        let place = ((column as i64 + dx) as u64).wrapping_mul(0x1_0000_0001);
        noise.uniform(place.wrapping_add((row as i64 + dy) as u64))
    };
    let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
    let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
    upper * (1.0 - fy) + lower * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflexes_are_few_and_brightest_around_the_fovea_and_on_vessels() {
        let (lamp, eye, noise) = (Lamp::default(), Point3::new(2.5e-3, 0.0, -0.2), Noise::new(1, 1));
        let of = |x: f64, y: f64| at([&Point3::new(x, y, 0.0), &eye], [x, y], [0.0, 0.0], &lamp, noise)[0];
        let all: Vec<_> = (0..10_000)
            .map(|n| of(f64::from(n % 100) * 40e-6 - 2e-3, f64::from(n / 100) * 40e-6 - 2e-3))
            .collect();
        let bright = all.iter().filter(|value| **value > 25.0).count();
        assert!((5..800).contains(&bright), "{bright} of 10 000 places shine");
        assert!(all.iter().all(|value| (0.0..200.0).contains(value)));
    }
}
