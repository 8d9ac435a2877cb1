//! A surgical tool: a shaft with a round end, and where a line meets it.
//!
//! Invariant: its surface is all that is `radius_m` away from its core, a line from near the tip up the shaft.

use nalgebra::{Point3, UnitVector3, Vector3};

/// A tool in the eye: a round shaft with a round end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// Its foremost point, m, in the world.
    pub tip: Point3<f64>,
    /// From the shaft to the tip.
    pub axis: UnitVector3<f64>,
    pub radius_m: f64,
    pub length_m: f64,
}

impl Tool {
    /// Half the width of a 23 gauge instrument, m.
    pub const RADIUS_M: f64 = 0.3e-3;
    /// How much of the shaft is drawn, m.
    pub const LENGTH_M: f64 = 25e-3;

    /// A 23 gauge tool.
    pub fn new(tip: Point3<f64>, axis: UnitVector3<f64>) -> Tool {
        Tool { tip, axis, radius_m: Tool::RADIUS_M, length_m: Tool::LENGTH_M }
    }

    /// Both ends of the line that its surface is `radius_m` away from, the tip's end first.
    pub fn core(&self) -> [Point3<f64>; 2] {
        let front = self.tip - self.axis.as_ref() * self.radius_m;
        [front, front - self.axis.as_ref() * (self.length_m - 2.0 * self.radius_m).max(0.0)]
    }

    /// Way from `start` along `way` (a unit vector) to the tool, m; `None` when the line misses it. Line against capsule:
    /// the cylinder first, then the end that lies nearer.
    pub fn meet(&self, start: &Point3<f64>, way: &Vector3<f64>) -> Option<f64> {
        let [front, back] = self.core();
        let (core, from) = (back - front, start - front);
        let (cc, cw, cf) = (core.norm_squared(), core.dot(way), core.dot(&from));
        let (wf, r2) = (way.dot(&from), self.radius_m * self.radius_m);
        let a = cc - cw * cw;
        let b = cc * wf - cf * cw;
        let c = cc * from.norm_squared() - cf * cf - r2 * cc;
        let h = b * b - a * c;
        if h < 0.0 {
            return None;
        }
        let y = if a > 1e-12 * cc {
            let t = (-b - h.sqrt()) / a;
            let y = cf + t * cw;
            if y > 0.0 && y < cc {
                return (t > 0.0).then_some(t);
            }
            y
        } else {
            // The line runs along the tool: it meets an end.
            if cw > 0.0 { 0.0 } else { cc }
        };
        let from = if y <= 0.0 { from } else { start - back };
        let b = way.dot(&from);
        let h = b * b - (from.norm_squared() - r2);
        let t = -b - h.max(0.0).sqrt();
        (h >= 0.0 && t > 0.0).then_some(t)
    }

    /// Outward direction of the surface at a point on it.
    pub fn normal(&self, at: &Point3<f64>) -> Vector3<f64> {
        let [front, back] = self.core();
        let core = back - front;
        let along = (core.dot(&(at - front)) / core.norm_squared().max(1e-18)).clamp(0.0, 1.0);
        (at - (front + core * along)).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_meets_the_tool_where_its_surface_is() {
        let axis = UnitVector3::new_normalize(Vector3::new(0.4, -0.3, 1.0));
        let tool = Tool::new(Point3::new(1e-3, 0.0, -2e-3), axis);
        let [front, back] = tool.core();
        let from = Point3::new(-2.5e-3, 0.0, -0.2);
        let mut met = 0;
        for n in 0..4000 {
            let aim =
                Point3::new(f64::from(n % 80) * 0.1e-3 - 4e-3, f64::from(n / 80) * 0.1e-3 - 2e-3, -2e-3);
            let way = (aim - from).normalize();
            let Some(t) = tool.meet(&from, &way) else { continue };
            met += 1;
            let at = from + way * t;
            let core = back - front;
            let along = (core.dot(&(at - front)) / core.norm_squared()).clamp(0.0, 1.0);
            let away = (at - (front + core * along)).norm();
            assert!((away - tool.radius_m).abs() < 1e-9, "{away:e} m from the core");
            assert!(tool.normal(&at).dot(&way) < 1e-6, "a side that is seen faces the eye");
        }
        assert!(met > 100, "{met} lines met it");
        let tip_first =
            tool.meet(&(tool.tip + axis.as_ref() * 1e-3), &-axis.into_inner()).expect("onto the tip");
        assert!((tip_first - 1e-3).abs() < 1e-12, "{tip_first:e}");
        let from_behind = tool.meet(&(back - axis.as_ref() * 1e-3), &axis).expect("onto the back");
        assert!((from_behind - (1e-3 - tool.radius_m)).abs() < 1e-12);
        assert_eq!(tool.meet(&Point3::new(0.1, 0.1, -0.2), &Vector3::z()), None);
    }
}
