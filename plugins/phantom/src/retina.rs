//! The retina as it looks from inside, and its vessels: a photograph laid on the globe.
//!
//! Invariant: decoded once per process; every lookup beyond the picture gives its nearest pixel, so no place
//! is undefined.

use std::sync::OnceLock;

use image::ImageFormat;

/// The photograph (`tests/data/SOURCES.md`): 1411 × 1411 px, a field of 45°.
const PHOTOGRAPH: &[u8] = include_bytes!("../../../tests/data/retina.jpg");

/// Width of the field on the retina, m: 45° seen from the middle of the lens are about 13 mm.
pub const FIELD_M: f64 = 13e-3;

/// Vessels stand out by 10 to 20 µm.
const BUMP_M: std::ops::RangeInclusive<f32> = 10e-6..=20e-6;

/// Half the side of the square whose mean a pixel is compared with to find vessels, px (0.18 mm).
const NEIGHBOURHOOD: usize = 20;

/// A pixel whose green is less than this part of its neighbourhood's is of a vessel.
const VESSEL_BELOW: f32 = 0.94;

/// The vessel is highest where the green falls to this part of its neighbourhood's.
const VESSEL_DARKEST: f32 = 0.70;

/// Brightness below which the photograph shows its frame and no retina.
const FRAME: u8 = 12;

/// Picture and relief of a retina.
#[derive(Debug)]
pub struct Retina {
    /// Pixels in a row, and rows.
    side: usize,
    /// Red, green, blue of each pixel, row after row.
    colour: Vec<[u8; 3]>,
    /// Height by which each pixel's tissue stands out towards the lens, m.
    bump: Vec<f32>,
}

impl Retina {
    /// The one retina of this process. The first call decodes it: some 0.1 s, so it belongs into `configure`.
    pub fn shared() -> &'static Retina {
        static SHARED: OnceLock<Retina> = OnceLock::new();
        SHARED.get_or_init(Retina::decode)
    }

    fn decode() -> Retina {
        let picture = image::load_from_memory_with_format(PHOTOGRAPH, ImageFormat::Jpeg)
            .expect("the photograph is part of this library and decodes");
        let picture = picture.into_rgb8();
        let side = picture.width().min(picture.height()) as usize;
        let colour: Vec<[u8; 3]> =
            (0..side * side).map(|at| picture.get_pixel((at % side) as u32, (at / side) as u32).0).collect();
        let bump = smooth(&relief(&colour, side), side);
        Retina { side, colour, bump }
    }

    /// Pixels per metre along the retina.
    pub fn pixels_per_metre(&self) -> f64 {
        self.side as f64 / FIELD_M
    }

    /// Pixels in a row, and rows.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Red, green, blue (0 to 255) at `u`, `v` m along the retina from its middle, between pixels
    /// interpolated.
    pub fn colour_at(&self, u: f64, v: f64) -> [f32; 3] {
        let (corners, weights) = self.corners(u, v);
        let mut sum = [0.0; 3];
        for (corner, weight) in corners.into_iter().zip(weights) {
            for (sum, value) in sum.iter_mut().zip(self.colour[corner]) {
                *sum += weight * f32::from(value);
            }
        }
        sum
    }

    /// Height by which the tissue stands out at `u`, `v` m along the retina from its middle, m; 0 beside
    /// vessels.
    pub fn bump_at(&self, u: f64, v: f64) -> f64 {
        let (corners, weights) = self.corners(u, v);
        let sum: f32 =
            corners.into_iter().zip(weights).map(|(corner, weight)| weight * self.bump[corner]).sum();
        f64::from(sum)
    }

    /// The four pixels around a place and the part each has in it.
    fn corners(&self, u: f64, v: f64) -> ([usize; 4], [f32; 4]) {
        let last = self.side - 1;
        let place =
            |along: f64| (along * self.pixels_per_metre() + last as f64 / 2.0).clamp(0.0, last as f64);
        let (x, y) = (place(u), place(v));
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(last), (top + 1).min(last));
        let (fx, fy) = ((x - left as f64) as f32, (y - top as f64) as f32);
        let corner = |x, y| y * self.side + x;
        (
            [corner(left, top), corner(right, top), corner(left, bottom), corner(right, bottom)],
            [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy],
        )
    }
}

/// Height of each pixel: vessels are darker in the green than what is around them.
fn relief(colour: &[[u8; 3]], side: usize) -> Vec<f32> {
    let sums = Sums::new(side, |at| u64::from(colour[at][1]));
    (0..side * side)
        .map(|at| {
            let around = sums.mean(at % side, at / side, NEIGHBOURHOOD);
            let darkness = f32::from(colour[at][1]) / around.max(1.0);
            if around < f32::from(FRAME) || darkness >= VESSEL_BELOW {
                return 0.0;
            }
            let deep = ((VESSEL_BELOW - darkness) / (VESSEL_BELOW - VESSEL_DARKEST)).min(1.0);
            BUMP_M.start() + deep * (BUMP_M.end() - BUMP_M.start())
        })
        .collect()
}

/// Flanks instead of cliffs: the mean over 9 × 9 px (80 µm).
fn smooth(heights: &[f32], side: usize) -> Vec<f32> {
    // In nm, so that sums are exact.
    let sums = Sums::new(side, |at| (heights[at] * 1e9) as u64);
    (0..side * side).map(|at| sums.mean(at % side, at / side, 4) * 1e-9).collect()
}

/// Sums over all rectangles of a square of values, from its corner on.
struct Sums {
    side: usize,
    sums: Vec<u64>,
}

impl Sums {
    fn new(side: usize, value: impl Fn(usize) -> u64) -> Sums {
        let mut sums = vec![0; (side + 1) * (side + 1)];
        for y in 0..side {
            let mut row = 0;
            for x in 0..side {
                row += value(y * side + x);
                sums[(y + 1) * (side + 1) + x + 1] = sums[y * (side + 1) + x + 1] + row;
            }
        }
        Sums { side, sums }
    }

    /// Mean of the square of `2 reach + 1` around `x`, `y`, as far as it lies inside.
    fn mean(&self, x: usize, y: usize, reach: usize) -> f32 {
        let (left, top) = (x.saturating_sub(reach), y.saturating_sub(reach));
        let (right, bottom) = ((x + reach + 1).min(self.side), (y + reach + 1).min(self.side));
        let at = |x: usize, y: usize| self.sums[y * (self.side + 1) + x];
        let sum = at(right, bottom) + at(left, top) - at(right, top) - at(left, bottom);
        sum as f32 / ((right - left) * (bottom - top)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vessels_stand_out_and_cover_a_small_part_of_the_field() {
        let retina = Retina::shared();
        let highest = retina.bump.iter().copied().fold(0.0, f32::max);
        assert!((10e-6..=20e-6).contains(&highest), "{highest:e} m");
        let raised = retina.bump.iter().filter(|bump| **bump > 5e-6).count() as f64;
        let part = raised / retina.bump.len() as f64;
        assert!((0.01..0.25).contains(&part), "{part} of the field stands out");
    }

    #[test]
    fn between_pixels_the_value_is_between_theirs_and_beyond_the_picture_that_of_the_rim() {
        let retina = Retina::shared();
        let pixel = 1.0 / retina.pixels_per_metre();
        let (a, b) = (retina.colour_at(0.0, 0.0), retina.colour_at(pixel, 0.0));
        let middle = retina.colour_at(0.5 * pixel, 0.0);
        for channel in 0..3 {
            assert!((middle[channel] - 0.5 * (a[channel] + b[channel])).abs() < 1e-3);
        }
        assert_eq!(retina.colour_at(1.0, 0.0), retina.colour_at(FIELD_M, 0.0));
        assert!(retina.bump_at(-1.0, 1.0).is_finite());
    }
}
