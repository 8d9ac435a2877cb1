//! The shadow that a tool in front of the lamp casts on the retina: where it may lie, and how dark a place
//! is.
//!
//! Invariant: a place is in the shadow when the way from it to the lamp passes the tool's core within its
//! radius there. The edge is as soft as the lamp's end looks large beside the tool: sharp where the tool
//! touches, softer the higher it is.

use nalgebra::{Point3, Vector3};

use crate::camera::Tool;
use crate::lamp::Lamp;

/// Beside the apex by more than this nothing is drawn, m.
const FARTHEST_M: f64 = 9e-3;
/// Half the softness of every edge, m: tissue scatters light.
const SCATTERED_M: f64 = 25e-6;

/// Middle and half width (m) of the shadow of `count` points along the tool's core, from its tip on, as far
/// as they lie before the lamp: on the surface `z(x, y)`.
pub(crate) fn of<'a>(
    tool: &'a Tool,
    lamp: &'a Lamp,
    count: usize,
    z: impl Fn(f64, f64) -> f64 + 'a,
) -> impl Iterator<Item = (Point3<f64>, f64)> + 'a {
    let ([front, back], radius_m, lamp) = (tool.core(), lamp.radius_m, &lamp.at);
    let core_m = (back - front).norm();
    (0..count).map_while(move |n| {
        let part = n as f64 / (count - 1) as f64;
        let (point, radius) = (front + (back - front) * part, tool.radius_at(part * core_m));
        let way = point - lamp;
        if way.z < 0.5e-3 {
            return None;
        }
        // The retina is so many times further than the tool.
        let mut times = -lamp.z / way.z;
        for _ in 0..4 {
            let at = lamp + way * times;
            let (x, y) = (at.x.clamp(-FARTHEST_M, FARTHEST_M), at.y.clamp(-FARTHEST_M, FARTHEST_M));
            times += (z(x, y) - at.z) / way.z;
        }
        let at = lamp + way * times;
        let outside = n > 0 && (at.x.abs() > FARTHEST_M || at.y.abs() > FARTHEST_M);
        // Light that comes in low draws the shadow out.
        let slant = way.norm() / way.z;
        let times = times.max(1.0);
        let wide = radius * times + radius_m * (times - 1.0) + SCATTERED_M;
        (!outside).then_some((at, wide * slant))
    })
}

/// Depth of `at` in the shadow, 0 to 1: the part of the lamp's round end that the tool hides from it, as if
/// both were strips.
pub(crate) fn depth(at: &Point3<f64>, lamp: &Lamp, tool: &Tool, core: &[Point3<f64>; 2]) -> f64 {
    let Near { apart_m, one, other } = nearest([at, &lamp.at], [&core[0], &core[1]]);
    let radius = tool.radius_at(other * (core[1] - core[0]).norm());
    // The lamp's end seen from the place, where the tool is; and what the tissue scatters.
    let half = lamp.radius_m * one + SCATTERED_M;
    let hidden = (apart_m + half).min(radius) - (apart_m - half).max(-radius);
    let dark = (hidden / (2.0 * half)).clamp(0.0, 1.0);
    dark * dark * (3.0 - 2.0 * dark)
}

/// The nearest places of two segments.
struct Near {
    apart_m: f64,
    /// Part of each segment that lies before the nearest place.
    one: f64,
    other: f64,
}

/// Nearest places of two segments (C. Ericson, *Real-Time Collision Detection*, 2005, 5.1.9); neither is a
/// point.
fn nearest(one: [&Point3<f64>; 2], other: [&Point3<f64>; 2]) -> Near {
    let (d1, d2, r) = (one[1] - one[0], other[1] - other[0], one[0] - other[0]);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (b, c) = (d1.dot(&d2), d1.dot(&r));
    let parallel = a * e - b * b;
    let mut s = if parallel > 1e-30 { ((b * f - c * e) / parallel).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = (b * s + f) / e;
    if t < 0.0 {
        t = 0.0;
        s = (-c / a).clamp(0.0, 1.0);
    } else if t > 1.0 {
        t = 1.0;
        s = ((b - c) / a).clamp(0.0, 1.0);
    }
    let between: Vector3<f64> = r + d1 * s - d2 * t;
    Near { apart_m: between.norm(), one: s, other: t }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitVector3;

    #[test]
    fn the_distance_of_segments_is_that_of_their_nearest_points() {
        let p = Point3::new;
        let of = |a: [f64; 6], b: [f64; 6]| {
            let ends = |v: [f64; 6]| [p(v[0], v[1], v[2]), p(v[3], v[4], v[5])];
            let (a, b) = (ends(a), ends(b));
            let mut least = f64::MAX;
            for i in 0..=400 {
                for j in 0..=400 {
                    let (s, t) = (f64::from(i) / 400.0, f64::from(j) / 400.0);
                    least = least.min(((a[0] + (a[1] - a[0]) * s) - (b[0] + (b[1] - b[0]) * t)).norm());
                }
            }
            (nearest([&a[0], &a[1]], [&b[0], &b[1]]).apart_m, least)
        };
        for (one, other) in [
            ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.5, 1.0, -1.0, 0.5, 1.0, 2.0]),
            ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [2.0, 1.0, 0.0, 3.0, 1.0, 1.0]),
            ([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], [-1.0, -2.0, 0.0, -1.0, -1.0, 0.3]),
            ([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.2, 0.3, 0.0, 0.8, 0.3, 0.0]),
        ] {
            let (told, tried) = of(one, other);
            assert!((told - tried).abs() < 3e-3, "{told} instead of {tried}");
        }
    }

    fn tool(height: f64) -> Tool {
        let (tilt, turn) = (28.0_f64.to_radians(), 20.0_f64.to_radians());
        let axis = Vector3::new(-tilt.sin() * turn.cos(), -tilt.sin() * turn.sin(), tilt.cos());
        Tool::new(Point3::new(0.0, 0.0, -height), UnitVector3::new_normalize(axis))
    }

    #[test]
    fn the_shadow_lies_beside_the_tip_and_meets_it_where_the_tip_touches() {
        let lamp = Lamp::default();
        let mut apart = Vec::new();
        for height in [3e-3, 1e-3, 0.1e-3, 0.0] {
            let tool = tool(height);
            let (at, wide) = of(&tool, &lamp, 20, |_, _| 0.0).next().expect("before the lamp");
            assert!(at.z.abs() < 1e-9 && wide > tool.tip_radius_m());
            let dark = depth(&at, &lamp, &tool, &tool.core());
            assert!(dark > if height > 2e-3 { 0.4 } else { 0.9 }, "{dark} in the middle at {height}");
            apart.push((at - tool.tip).xy().norm());
        }
        assert!(apart.is_sorted_by(|a, b| a > b), "{apart:?}");
        assert!(apart[3] < Tool::TIP_RADIUS_M, "{apart:?}: it meets the tip");
        assert_eq!(depth(&Point3::new(4e-3, -4e-3, 0.0), &lamp, &tool(1e-3), &tool(1e-3).core()), 0.0);
    }

    #[test]
    fn the_edge_of_the_shadow_is_softer_the_higher_the_tool_is() {
        let lamp = Lamp::default();
        let soft = |height: f64| {
            let tool = tool(height);
            let core = tool.core();
            // The middle of the shadow 2 mm up the taper; places across it are tried.
            let (middle, _) = of(&tool, &lamp, 15, |_, _| 0.0).nth(1).expect("before the lamp");
            let partly = |n: &i32| {
                let beside = f64::from(*n) * 1e-6;
                let at = middle + Vector3::new(beside, -beside, 0.0);
                (0.05..0.95).contains(&depth(&at, &lamp, &tool, &core))
            };
            (-800..800).filter(partly).count()
        };
        assert!(
            soft(3e-3) > soft(1e-3) && soft(1e-3) > soft(0.2e-3),
            "{} {} {}",
            soft(3e-3),
            soft(1e-3),
            soft(0.2e-3)
        );
    }
}
