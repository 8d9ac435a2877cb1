//! Disparities: their scale, their missing value, and the depth they mean.
//!
//! Invariant: a depth is positive or not a number; there is no depth for a disparity at or beyond infinity.

/// Disparities are in 1/16 px.
pub const SCALE: i16 = 16;
/// Nothing is known of a pixel.
pub const NONE: i16 = -16;

/// Depths of all disparities of a range.
#[derive(Clone, Debug)]
pub struct Depth {
    /// Indexed by disparity, 1/16 px.
    table_m: Vec<f32>,
}

impl Depth {
    /// Depth = `focal_px` · `baseline_m` / (disparity + `offset_px`) for disparities below `n_disp` px.
    pub fn new(n_disp: usize, focal_px: f64, baseline_m: f64, offset_px: f64) -> Self {
        let depth = |d: usize| {
            let reach_px = d as f64 / f64::from(SCALE) + offset_px;
            if reach_px > 0.0 { (focal_px * baseline_m / reach_px) as f32 } else { f32::NAN }
        };
        Depth { table_m: (0..n_disp * SCALE as usize).map(depth).collect() }
    }

    /// Depth of a disparity, m; not a number where there is none.
    #[inline]
    pub fn of(&self, disparity: i16) -> f32 {
        usize::try_from(disparity).ok().and_then(|d| self.table_m.get(d)).copied().unwrap_or(f32::NAN)
    }
}

/// Between the costs of the disparities one below, at and one above the best one, 1/16 px: two straight lines
/// of opposite slope through them, which is the shape that sums of absolute differences have.
#[inline(always)]
pub(crate) fn between_lines(best: i32, below: i32, at: i32, above: i32) -> i16 {
    let (rise, width) = (below - above, (below - at).max(above - at));
    // `rise` is at most `width` to both sides: at most half a pixel. Single precision is exact here and
    // faster than a division of integers: a quotient of at most 8 by less than 2^16 is further than 2^-21
    // from a whole number, or on it.
    let rounded = (rise * 8 + rise.signum() * width / 2) as f32 / width.max(1) as f32;
    let part = rounded as i32;
    (best * i32::from(SCALE) + part).max(0) as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_follows_the_formula_and_ends_at_infinity() {
        let depth = Depth::new(32, 500.0, 0.05, -1.0);
        assert!((depth.of(2 * SCALE) - 25.0).abs() < 1e-5);
        assert!((depth.of(26 * SCALE) - 1.0).abs() < 1e-6);
        assert!(depth.of(SCALE).is_nan() && depth.of(0).is_nan(), "at or beyond infinity");
        assert!(depth.of(NONE).is_nan() && depth.of(i16::MIN).is_nan() && depth.of(32 * SCALE).is_nan());
    }

    #[test]
    fn the_place_between_is_that_of_a_division_of_integers() {
        let mut rng = fastrand::Rng::with_seed(2);
        for _ in 0..200_000 {
            let at = rng.i32(0..60_000);
            let most = if rng.bool() { 65_536 } else { at + 40 };
            let (below, above) = (rng.i32(at..most.min(65_536)), rng.i32(at..most.min(65_536)));
            let (rise, width) = (below - above, (below - at).max(above - at).max(1));
            let part = (rise * 8 + rise.signum() * width / 2) / width;
            assert_eq!(between_lines(9, below, at, above), (144 + part) as i16, "{below} {at} {above}");
        }
    }

    #[test]
    fn a_symmetric_minimum_lies_on_its_disparity_and_a_flat_side_half_way() {
        assert_eq!(between_lines(5, 10, 4, 10), 80);
        assert_eq!(between_lines(5, 4, 4, 10), 72, "between 4 and 5");
        assert_eq!(between_lines(5, 10, 4, 4), 88, "between 5 and 6");
        assert_eq!(between_lines(5, 4, 4, 4), 80);
        assert_eq!(between_lines(0, 4, 4, 10), 0, "not below 0");
        // Lines of slope 4 with their meeting point a quarter to the right.
        assert_eq!(between_lines(5, 9, 5, 7), 84);
    }
}
