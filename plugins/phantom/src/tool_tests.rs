//! Lines against the tool: from above, from the side, onto its ends.

use super::*;

/// From the core to a point, less the radius there, m: the least over many balls.
fn outside(tool: &Tool, at: &Point3<f64>) -> f64 {
    let [front, back] = tool.core();
    let long = (back - front).norm();
    let of = |along: f64| (at - (front + (back - front) * (along / long))).norm() - tool.radius_at(along);
    let coarse = (0..=3000).map(|n| long * f64::from(n) / 3000.0).min_by(|a, b| of(*a).total_cmp(&of(*b)));
    let near = coarse.expect("some");
    (-500..=500).map(|n| of((near + f64::from(n) * long / 1.5e6).clamp(0.0, long))).fold(f64::MAX, f64::min)
}

fn tilted() -> Tool {
    let axis = UnitVector3::new_normalize(Vector3::new(0.4, -0.3, 1.0));
    Tool::new(Point3::new(1e-3, 0.0, -2e-3), axis)
}

/// Lines from an eye above, a tenth of a millimetre apart.
fn lines(from: Point3<f64>) -> impl Iterator<Item = Vector3<f64>> {
    (0..9600).map(move |n| {
        let (x, y) = (f64::from(n % 120) * 0.1e-3 - 9e-3, f64::from(n / 120) * 0.1e-3 - 3e-3);
        (Point3::new(x, y, -2e-3) - from).normalize()
    })
}

#[test]
fn a_line_meets_the_tool_where_its_surface_is_and_the_normal_faces_the_eye() {
    let tool = tilted();
    let (mut met, mut tapered) = (0, 0);
    for from in [Point3::new(-2.5e-3, 0.0, -0.2), Point3::new(-0.1, 0.05, -0.1)] {
        for way in lines(from) {
            let Some(t) = tool.meet(&from, &way) else { continue };
            met += 1;
            let at = from + way * t;
            let off = outside(&tool, &at);
            assert!(off.abs() < 2e-9, "{off:e} m beside the surface");
            let normal = tool.normal(&at);
            assert!(normal.dot(&way) < 1e-6, "a side that is seen faces the eye");
            // The surface does not change along it: the normal is that of the surface.
            let side = normal.cross(&way).normalize() * 1e-7;
            assert!((outside(&tool, &(at + side)) - off).abs() < 1e-9, "across the normal");
            assert!((outside(&tool, &(at + normal * 1e-7)) - off - 1e-7).abs() < 1e-9, "along the normal");
            let along = -tool.axis.dot(&(at - tool.core()[0]));
            tapered += i32::from((0.1e-3..3.9e-3).contains(&along));
        }
    }
    assert!(met > 500 && tapered > 50, "{met} lines met it, {tapered} of them its taper");
}

#[test]
fn a_line_passes_the_tool_on_the_side_that_its_gap_tells() {
    let tool = tilted();
    let from = Point3::new(-2.5e-3, 0.0, -0.2);
    let mut near = 0;
    for way in lines(from) {
        let passing = tool.pass(&from, &way);
        let met = tool.meet(&from, &way).is_some();
        assert_eq!(met, passing.gap_m <= 0.0, "{:e} m", passing.gap_m);
        if (0.0..0.2e-3).contains(&passing.gap_m) {
            near += 1;
            let to = passing.core + passing.beside;
            let off = outside(&tool, &to) - passing.gap_m;
            assert!(off.abs() < 2e-9, "{off:e} m");
        }
    }
    assert!(near > 50, "{near} lines pass nearby");
}

#[test]
fn a_line_onto_an_end_meets_the_end() {
    let tool = tilted();
    let axis = tool.axis;
    let tip_first = tool.meet(&(tool.tip + axis.as_ref() * 1e-3), &-axis.into_inner()).expect("onto the tip");
    assert!((tip_first - 1e-3).abs() < 1e-12, "{tip_first:e}");
    let back = tool.core()[1];
    let from_behind = tool.meet(&(back - axis.as_ref() * 1e-3), &axis).expect("onto the back");
    assert!((from_behind - (1e-3 - tool.radius_m)).abs() < 1e-12);
    assert_eq!(tool.meet(&Point3::new(0.1, 0.1, -0.2), &Vector3::z()), None);
    assert_eq!(tool.radius_at(0.0), Tool::TIP_RADIUS_M);
    assert_eq!(tool.radius_at(10e-3), Tool::RADIUS_M);
}

#[test]
fn a_short_or_thin_tool_has_no_taper_that_is_steeper_than_it_can_be() {
    for (radius_m, length_m) in [(50e-6, 1e-3), (0.3e-3, 0.6e-3), (2e-3, 4e-3), (2e-3, 5e-3)] {
        let tool = Tool { radius_m, length_m, ..tilted() };
        let t = tool.meet(&(tool.tip + tool.axis.as_ref() * 1e-3), &-tool.axis.into_inner());
        assert!(t.is_some_and(|t| (t - 1e-3).abs() < 1e-9 || t < 1e-3), "{t:?} for {radius_m}, {length_m}");
    }
}
