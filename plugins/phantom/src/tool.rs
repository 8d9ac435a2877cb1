//! A surgical tool: a shaft that tapers to a fine round tip, and where a line meets it or passes it.
//!
//! Invariant: its surface is the hull of balls whose middles lie on its core, a line from near the tip up the
//! shaft. The radius of the balls grows evenly over the taper and then stays, so the body is convex and a
//! line enters it once.

use nalgebra::{Point3, UnitVector3, Vector3};

/// A tool in the eye: a round shaft with a tapered end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// Its foremost point, m, in the world.
    pub tip: Point3<f64>,
    /// From the shaft to the tip.
    pub axis: UnitVector3<f64>,
    /// Radius of the shaft, m.
    pub radius_m: f64,
    /// From the tip to the end of what is drawn, m.
    pub length_m: f64,
}

/// A line that passes a tool: the place where it is nearest to the surface.
#[derive(Clone, Copy, Debug)]
pub struct Passing {
    /// From the line to the surface, m; negative where the line goes through the tool.
    pub gap_m: f64,
    /// Point of the core that is nearest, m, in the world.
    pub core: Point3<f64>,
    /// From that point towards the line, m.
    pub beside: Vector3<f64>,
}

impl Tool {
    /// Half the width of a 23 gauge instrument, m.
    pub const RADIUS_M: f64 = 0.3e-3;
    /// Length of the shaft that is drawn, m: a tool tilted by 20° leaves the picture before it ends.
    pub const LENGTH_M: f64 = 30e-3;
    /// Radius of the round tip, m.
    pub const TIP_RADIUS_M: f64 = 60e-6;
    /// Length of the taper, m.
    pub const TAPER_M: f64 = 4e-3;

    /// A 23 gauge tool.
    pub fn new(tip: Point3<f64>, axis: UnitVector3<f64>) -> Tool {
        Tool { tip, axis, radius_m: Tool::RADIUS_M, length_m: Tool::LENGTH_M }
    }

    /// Radius of the ball at the tip, m.
    pub fn tip_radius_m(&self) -> f64 {
        self.radius_m.min(Tool::TIP_RADIUS_M)
    }

    /// Both ends of the core, the tip's end first.
    pub fn core(&self) -> [Point3<f64>; 2] {
        let front = self.tip - self.axis.as_ref() * self.tip_radius_m();
        [front, front - self.axis.as_ref() * self.core_m()]
    }

    /// Radius of the ball whose middle lies `along_m` up the core, m.
    pub fn radius_at(&self, along_m: f64) -> f64 {
        (self.tip_radius_m() + self.slope() * along_m.max(0.0)).min(self.radius_m)
    }

    /// Way from `start` along `way` (a unit vector) to the tool, m; `None` when the line misses it: line
    /// against ball, cone, ball, cylinder, ball, of which the one counts on whose part of the core it is met.
    pub fn meet(&self, start: &Point3<f64>, way: &Vector3<f64>) -> Option<f64> {
        let ([front, _], up) = (self.core(), -self.axis.into_inner());
        let (from, slope, tip) = (start - front, self.slope(), self.tip_radius_m());
        // Along the core and across it: the line is at a + b t up the core, and far from it by the root of c
        // + 2 d t + e t².
        let (a, b) = (up.dot(&from), up.dot(way));
        let (c, d, e) = (from.norm_squared() - a * a, from.dot(way) - a * b, 1.0 - b * b);
        let wide = d * d - e * (c - self.radius_m * self.radius_m);
        if wide < 0.0 {
            return None;
        }
        let (taper, length) = (self.taper_m(), self.core_m());
        // The cylinder.
        if e > 1e-12 {
            let t = (-d - wide.sqrt()) / e;
            if (taper..=length).contains(&(a + b * t)) {
                return (t > 0.0).then_some(t);
            }
        }
        // The cone that touches the balls of the taper: ρ cos θ = tip + x sin θ, at ρ beside x on the core;
        // sin θ is the slope.
        let cos2 = 1.0 - slope * slope;
        let reach = tip + a * slope;
        let [k0, k1, k2] =
            [cos2 * c - reach * reach, cos2 * d - reach * b * slope, cos2 * e - b * b * slope * slope];
        let under = k1 * k1 - k0 * k2;
        if taper > 0.0 && under >= 0.0 && k2.abs() > 1e-15 {
            let root = under.sqrt();
            for t in [(-k1 - root) / k2, (-k1 + root) / k2] {
                // The ball that touches the cone there.
                let ball = (a + b * t + tip * slope) / cos2;
                // The line enters there, and does not leave.
                let enters = cos2 * (d + e * t) < (reach + b * slope * t) * b * slope;
                if (0.0..=taper).contains(&ball) && enters {
                    return (t > 0.0).then_some(t);
                }
            }
        }
        let ball = |at: f64, radius: f64| {
            let from = from - up * at;
            let (half, outside) = (from.dot(way), from.norm_squared() - radius * radius);
            let h = half * half - outside;
            (h >= 0.0).then(|| -half - h.sqrt())
        };
        let balls = [ball(0.0, tip), ball(taper, self.radius_m), ball(length, self.radius_m)];
        // The body is convex and holds all balls: the first of them that is met lies on its surface.
        balls.into_iter().flatten().reduce(f64::min).filter(|t| *t > 0.0)
    }

    /// Outward direction of the surface at a point on it.
    pub fn normal(&self, at: &Point3<f64>) -> Vector3<f64> {
        let ([front, _], up, slope) = (self.core(), -self.axis.into_inner(), self.slope());
        let (along, taper) = (up.dot(&(at - front)), self.taper_m());
        let ball = ((along + self.tip_radius_m() * slope) / (1.0 - slope * slope)).max(0.0);
        let ball = if ball < taper { ball } else { along.clamp(taper, self.core_m()) };
        (at - (front + up * ball)).normalize()
    }

    /// Returns the place where the line from `start` along `way` (a unit vector) passes the tool.
    pub fn pass(&self, start: &Point3<f64>, way: &Vector3<f64>) -> Passing {
        let ([front, _], up) = (self.core(), -self.axis.into_inner());
        let (from, taper) = (start - front, self.taper_m());
        let (a, b, d) = (up.dot(&from), up.dot(way), from.dot(way));
        let sine2 = (1.0 - b * b).max(1e-12);
        let middle = (a - b * d) / sine2;
        let at = if middle < taper {
            // On a cone the nearest ball lies further up than the nearest point of the core.
            let (slope, across) = (self.slope(), from + way * (b * middle - d) - up * middle);
            let ahead = if sine2 > slope * slope {
                slope * across.norm() / (sine2 * (sine2 - slope * slope)).sqrt()
            } else {
                f64::MAX
            };
            (middle + ahead).clamp(0.0, taper)
        } else {
            middle.clamp(taper, self.core_m())
        };
        let beside = from + way * (b * at - d) - up * at;
        Passing { gap_m: beside.norm() - self.radius_at(at), core: front + up * at, beside }
    }

    fn core_m(&self) -> f64 {
        (self.length_m - self.tip_radius_m() - self.radius_m).max(0.0)
    }

    fn taper_m(&self) -> f64 {
        Tool::TAPER_M.min(self.core_m())
    }

    /// By how much the radius grows per length of the core: the sine of half the taper's angle.
    fn slope(&self) -> f64 {
        let taper = self.taper_m();
        // A tool no longer than thick has no taper; that of others is never steep.
        if taper > 0.0 { ((self.radius_m - self.tip_radius_m()) / taper).min(0.9) } else { 0.0 }
    }
}

#[cfg(test)]
#[path = "tool_tests.rs"]
mod tests;
