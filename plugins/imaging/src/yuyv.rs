//! YUYV to colours after ITU-R BT.601, video range, with 20 bits after the point, as OpenCV does.
//!
//! Invariant: the same bytes with and without AVX2; each level is within one of the formula in floating
//! point.

use crate::simd::{self, Avx2};
use crate::weights::{BU, GU, GV, RV, Y};

/// Red, green, blue (`bgr`: blue, green, red) of a row of YUYV; `lanes` as of [`Avx2::detect`]. The shorter
/// of the two rows decides how many pixels; of an odd number the last one takes the colour of the one before.
pub fn row(lanes: Option<Avx2>, src: &[u8], bgr: bool, dst: &mut [u8]) {
    let pixels = (src.len() / 2).min(dst.len() / 3);
    let (src, dst) = (&src[..2 * pixels], &mut dst[..3 * pixels]);
    // An odd last pixel has no V of its own.
    let before = src.len().checked_sub(3).map_or(128, |at| src[at]);
    // Whole pairs, so that the rest begins with a pair, too.
    let done = lanes.map_or(0, |lanes| simd::yuyv(lanes, src, bgr, dst));
    let (src, dst) = (&src[2 * done..], &mut dst[3 * done..]);
    let order = |[r, g, b]: [u8; 3]| if bgr { [b, g, r] } else { [r, g, b] };
    let (pairs, rest) = src.as_chunks::<4>();
    let pixels = dst.as_chunks_mut::<3>().0;
    let (twos, last) = pixels.as_chunks_mut::<2>();
    for (to, &[y0, u, y1, v]) in twos.iter_mut().zip(pairs) {
        *to = [order(pixel(y0, u, v)), order(pixel(y1, u, v))];
    }
    if let ([last], [y, u]) = (last, rest) {
        *last = order(pixel(*y, *u, before));
    }
}

/// Full range red, green, blue of one pixel in video range.
#[inline(always)]
pub fn pixel(y: u8, u: u8, v: u8) -> [u8; 3] {
    let light = (i32::from(y) - 16).max(0) * Y;
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    [RV * v, GV * v + GU * u, BU * u].map(|tint| ((light + tint + (1 << 19)) >> 20).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_yuyv_colour_is_within_one_level_of_the_formula_in_floating_point() {
        for y in (0..=255u8).step_by(5) {
            for u in (0..=255u8).step_by(3) {
                for v in (0..=255u8).step_by(3) {
                    let (l, cu, cv) = (
                        (f64::from(y) - 16.0).max(0.0) * 255.0 / 219.0,
                        f64::from(u) - 128.0,
                        f64::from(v) - 128.0,
                    );
                    let exact = [l + 1.596 * cv, l - 0.813 * cv - 0.391 * cu, l + 2.018 * cu];
                    for (got, exact) in pixel(y, u, v).into_iter().zip(exact) {
                        let off = (f64::from(got) - exact.clamp(0.0, 255.0)).abs();
                        assert!(off <= 1.0, "({y}, {u}, {v}): {got}, exact {exact}");
                    }
                }
            }
        }
    }

    #[test]
    fn yuyv_is_the_same_with_and_without_wide_instructions_at_every_length() {
        let mut rng = fastrand::Rng::with_seed(3);
        for pixels in (1..70).chain([640]) {
            let src: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(2 * pixels).collect();
            for bgr in [false, true] {
                let (mut wide, mut plain) = (vec![1; 3 * pixels], vec![2; 3 * pixels]);
                row(Avx2::detect(), &src, bgr, &mut wide);
                row(None, &src, bgr, &mut plain);
                assert_eq!(wide, plain, "{pixels} pixels");
            }
        }
    }

    #[test]
    fn the_shorter_row_decides_how_many_pixels_are_made() {
        let mut dst = [7; 9];
        row(Avx2::detect(), &[235, 128, 16, 128, 235, 128, 16, 128], false, &mut dst[..8]);
        assert_eq!(dst, [255, 255, 255, 0, 0, 0, 7, 7, 7]);
        row(None, &[235, 128, 16], false, &mut dst);
        assert_eq!(dst, [255, 255, 255, 0, 0, 0, 7, 7, 7]);
        row(None, &[], true, &mut []);
    }
}
