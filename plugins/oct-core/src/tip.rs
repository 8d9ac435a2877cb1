//! Travel of the tip along the tool, at any time of the last moments.
//!
//! Invariant: travel is summed up from pose to pose along the tool's axis of the later one, so a tool that
//! turns about its tip travels nowhere; only differences of travel mean anything. Times without known poses
//! have no travel.

/// Poses that are kept.
const KEPT: usize = 64;
/// A time this much later than the last pose is still answered, ns.
const LATEST_NS: u64 = 5_000_000;
/// The speed for that is taken over so many poses: one encoder step in one period would be a wild guess.
const OVER: usize = 4;

/// A value over the last moments.
#[derive(Clone, Debug)]
pub struct Timeline {
    ring: [(u64, f64); KEPT],
    count: usize,
    newest: usize,
}

impl Default for Timeline {
    fn default() -> Timeline {
        Timeline { ring: [(0, 0.0); KEPT], count: 0, newest: 0 }
    }
}

impl Timeline {
    /// Adds a value; one that is no number or not later than the last one is left out. Tells whether it was
    /// taken.
    pub fn push(&mut self, ns: u64, value: f64) -> bool {
        if !value.is_finite() || (self.count > 0 && ns <= self.ring[self.newest].0) {
            return false;
        }
        self.newest = (self.newest + 1) % KEPT;
        self.ring[self.newest] = (ns, value);
        self.count = (self.count + 1).min(KEPT);
        true
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// The last value and its time.
    pub fn last(&self) -> Option<(u64, f64)> {
        (self.count > 0).then(|| self.back(0))
    }

    fn back(&self, n: usize) -> (u64, f64) {
        self.ring[(self.newest + KEPT - n) % KEPT]
    }

    /// Returns the value at `ns`, interpolated between values and carried on after the last one; none before
    /// those that are kept and more than 5 ms after them.
    pub fn at(&self, ns: u64) -> Option<f64> {
        let (last_ns, last) = self.last()?;
        if ns >= last_ns {
            let ahead = ns - last_ns;
            return (ahead <= LATEST_NS).then(|| last + self.slope_s() * ahead as f64 * 1e-9);
        }
        for n in 1..self.count {
            let ((early_ns, early), (late_ns, late)) = (self.back(n), self.back(n - 1));
            if ns >= early_ns {
                let part = (ns - early_ns) as f64 / (late_ns - early_ns) as f64;
                return Some(early + part * (late - early));
            }
        }
        None
    }

    /// Change per second over the last values; 0 while there is only one.
    pub fn slope_s(&self) -> f64 {
        let over = OVER.min(self.count.saturating_sub(1));
        if over == 0 {
            return 0.0;
        }
        let ((early_ns, early), (late_ns, late)) = (self.back(over), self.back(0));
        (late - early) / ((late_ns - early_ns) as f64 * 1e-9)
    }
}

/// Travel of the tip, m.
#[derive(Clone, Debug, Default)]
pub struct TipTravel {
    line: Timeline,
    position_m: [f64; 3],
}

impl TipTravel {
    /// Takes the tip's position (m) and the tool's orientation at `ns`. A pose that is not later than the
    /// last one, or is no pose, is left out; tells whether it was taken.
    pub fn push(&mut self, ns: u64, position_m: [f64; 3], orientation: &[f64; 4]) -> bool {
        let Some(axis) = axis_of(orientation) else { return false };
        if position_m.iter().any(|p| !p.is_finite()) {
            return false;
        }
        let travel = self.line.last().map_or(0.0, |(_, travel)| {
            travel + along(&[0, 1, 2].map(|i| position_m[i] - self.position_m[i]), &axis)
        });
        let taken = self.line.push(ns, travel);
        if taken {
            self.position_m = position_m;
        }
        taken
    }

    /// Travel at `ns`, m; none before the poses that are kept and longer than 5 ms after them.
    pub fn at(&self, ns: u64) -> Option<f64> {
        self.line.at(ns)
    }
}

/// The tool's axis, +z of an orientation x, y, z, w; none when it is no unit quaternion.
pub fn axis_of(orientation: &[f64; 4]) -> Option<[f64; 3]> {
    let [x, y, z, w] = *orientation;
    let norm = x * x + y * y + z * z + w * w;
    ((norm - 1.0).abs() < 1e-3).then(|| {
        [2.0 * (x * z + w * y) / norm, 2.0 * (y * z - w * x) / norm, (w * w + z * z - x * x - y * y) / norm]
    })
}

/// Length of `v` along `axis`.
pub fn along(v: &[f64; 3], axis: &[f64; 3]) -> f64 {
    v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

    #[test]
    fn between_poses_and_shortly_after_them_travel_is_known_elsewhere_it_is_not() {
        let mut tip = TipTravel::default();
        assert_eq!(tip.at(0), None);
        for n in 0..200u64 {
            assert!(tip.push(n * 1_000_000, [0.0, 1.0, 2e-6 * n as f64], &UPRIGHT));
        }
        let near = |ns: u64, wanted: f64| (tip.at(ns).expect("known") - wanted).abs() < 1e-15;
        assert!(near(199_000_000, 398e-6) && near(198_250_000, 396.5e-6) && near(201_000_000, 402e-6));
        assert_eq!((tip.at(204_100_000), tip.at(135_000_000)), (None, None));
        assert!(!tip.push(199_000_000, [0.0; 3], &UPRIGHT), "not later");
        assert!(!tip.push(300_000_000, [f64::NAN, 0.0, 0.0], &UPRIGHT));
        assert!(!tip.push(300_000_000, [0.0; 3], &[0.0; 4]));
    }

    #[test]
    fn a_tool_that_turns_about_its_tip_travels_nowhere_and_one_that_is_tilted_along_itself() {
        let mut tip = TipTravel::default();
        tip.push(1, [0.0, 0.0, 0.1], &UPRIGHT);
        let tilted = [(0.5f64).sin(), 0.0, 0.0, (0.5f64).cos()];
        tip.push(2, [0.0, 0.0, 0.1], &tilted);
        assert_eq!(tip.at(2), Some(0.0));
        let axis = axis_of(&tilted).expect("a unit quaternion");
        assert!((axis[1] + 1f64.sin()).abs() < 1e-12 && (axis[2] - 1f64.cos()).abs() < 1e-12);
        tip.push(3, [0.0, -1e-3 * 1f64.sin(), 0.1 + 1e-3 * 1f64.cos()], &tilted);
        assert!((tip.at(3).expect("known") - 1e-3).abs() < 1e-12);
    }
}
