//! The shadow that a tool in front of the lamp casts on the retina: where it may lie, and how dark a place is.
//!
//! Invariant: a place is in the shadow when the way from it to the lamp passes the tool's core within its radius; the edge is
//! as soft as three fifths of the radius.

use nalgebra::{Point3, Vector3};

use crate::camera::Tool;

/// Beside the apex by more than this nothing is drawn, m.
const FARTHEST_M: f64 = 9e-3;
/// The shadow is full within this part of the radius, and gone beyond the other one.
const EDGE: [f64; 2] = [0.7, 1.3];

/// Middle and half width (m) of the shadow of `count` points along the tool's core, from its tip on, as far as they lie
/// before the lamp: on the surface `z(x, y)`.
pub(crate) fn of<'a>(
    tool: &'a Tool,
    lamp: &'a Point3<f64>,
    count: usize,
    z: impl Fn(f64, f64) -> f64 + 'a,
) -> impl Iterator<Item = (Point3<f64>, f64)> + 'a {
    let [front, back] = tool.core();
    (0..count).map_while(move |n| {
        let point = front + (back - front) * (n as f64 / (count - 1) as f64);
        let way = point - lamp;
        if way.z < 0.5e-3 {
            return None;
        }
        // How many times further than the tool the retina is.
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
        (!outside).then_some((at, EDGE[1] * tool.radius_m * times.max(1.0) * slant))
    })
}

/// How deep in the shadow `at` is: 0 to 1.
pub(crate) fn depth(at: &Point3<f64>, lamp: &Point3<f64>, core: &[Point3<f64>; 2], radius_m: f64) -> f64 {
    let away = distance([at, lamp], [&core[0], &core[1]]) / radius_m;
    let dark = ((EDGE[1] - away) / (EDGE[1] - EDGE[0])).clamp(0.0, 1.0);
    dark * dark * (3.0 - 2.0 * dark)
}

/// Distance of two segments, m (C. Ericson, *Real-Time Collision Detection*, 2005, 5.1.9); neither is a point.
fn distance(one: [&Point3<f64>; 2], other: [&Point3<f64>; 2]) -> f64 {
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
    between.norm()
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
            (distance([&a[0], &a[1]], [&b[0], &b[1]]), least)
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

    #[test]
    fn the_shadow_lies_beside_the_tip_and_meets_it_where_the_tip_touches() {
        let lamp = Point3::new(-5e-3, -4e-3, -15e-3);
        let axis = UnitVector3::new_normalize(Vector3::new(-0.3, 0.0, 1.0));
        let mut apart = Vec::new();
        for height in [2e-3, 1e-3, 0.1e-3] {
            let tool = Tool::new(Point3::new(0.0, 0.0, -height), axis);
            let (at, wide) = of(&tool, &lamp, 20, |_, _| 0.0).next().expect("before the lamp");
            assert!(at.z.abs() < 1e-9 && wide > tool.radius_m);
            assert!(depth(&at, &lamp, &tool.core(), tool.radius_m) > 0.99, "the middle is dark");
            apart.push((at - tool.tip).xy().norm());
        }
        assert!(apart.is_sorted_by(|a, b| a > b), "{apart:?}");
        let far = Point3::new(4e-3, -4e-3, 0.0);
        let tool = Tool::new(Point3::new(0.0, 0.0, -1e-3), axis);
        assert_eq!(depth(&far, &lamp, &tool.core(), tool.radius_m), 0.0);
    }
}
