//! Colour to brightness after ITU-R BT.601: Y = 0.299 R + 0.587 G + 0.114 B, with integer weights.
//!
//! Invariant: the weights add to 256 and the sum fits 16 bits, so black stays 0, white stays 255, grey stays
//! itself.

use trocar_imaging::luma_row;
use trocar_imaging::simd::Avx2;

pub use trocar_imaging::luma;

use crate::view::{Format, View, ViewMut};

/// Writes one row of pixels of one format as another: brightness of colours, or brightness in all three
/// colours. The shorter of the two rows decides how many pixels.
pub fn convert_row(from: Format, src: &[u8], to: Format, dst: &mut [u8]) {
    match (from, to) {
        (Format::Rgb8, Format::Gray8) => luma_row(Avx2::detect(), src, dst),
        (Format::Gray8, Format::Rgb8) => {
            for (d, s) in dst.as_chunks_mut::<3>().0.iter_mut().zip(src) {
                *d = [*s; 3];
            }
        }
        (Format::Gray8, Format::Gray8) | (Format::Rgb8, Format::Rgb8) => {
            let n = src.len().min(dst.len());
            dst[..n].copy_from_slice(&src[..n]);
        }
    }
}

/// Converts an image into `dst`, whose format decides to what. Sizes are equal or the overlap is converted.
pub fn convert(src: &View<'_>, dst: &mut ViewMut<'_>) {
    let (from, to) = (src.shape().format, dst.shape().format);
    for y in 0..src.shape().height.min(dst.shape().height) {
        convert_row(from, src.row(y), to, dst.row_mut(y));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Shape;

    #[test]
    fn primaries_have_the_brightness_of_bt_601() {
        let of = |r, g, b| {
            (luma(r, g, b), (0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)).round())
        };
        assert_eq!(of(255, 0, 0), (77, 76.0));
        assert_eq!(of(0, 255, 0), (149, 150.0));
        assert_eq!(of(0, 0, 255), (29, 29.0));
        assert_eq!((luma(0, 0, 0), luma(255, 255, 255)), (0, 255));
    }

    #[test]
    fn every_colour_is_within_one_level_of_the_exact_formula() {
        for r in (0..=255).step_by(5) {
            for g in (0..=255).step_by(5) {
                for b in 0..=255u8 {
                    let exact = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
                    let got = luma(r, g, b);
                    assert!((f64::from(got) - exact).abs() <= 1.0, "({r},{g},{b}): {got}, exact {exact}");
                }
            }
        }
    }

    #[test]
    fn grey_pixels_keep_their_level_there_and_back() {
        let levels: Vec<u8> = (0..=255).collect();
        let (mut colour, mut back) = (vec![0; 768], vec![0; 256]);
        convert_row(Format::Gray8, &levels, Format::Rgb8, &mut colour);
        assert_eq!(colour[3 * 7..3 * 8], [7, 7, 7]);
        convert_row(Format::Rgb8, &colour, Format::Gray8, &mut back);
        assert_eq!(back, levels);
    }

    #[test]
    fn strided_images_convert_row_by_row_and_leave_the_padding_alone() {
        let shape = Shape { width: 2, height: 2, format: Format::Rgb8 };
        let src = [255, 0, 0, 0, 255, 0, 9, 9, 0, 0, 255, 1, 1, 1];
        let mut dst = [99; 7];
        let to = Shape { format: Format::Gray8, ..shape };
        convert(&View::new(shape, 8, &src).expect("fits"), &mut ViewMut::new(to, 4, &mut dst).expect("fits"));
        assert_eq!(dst, [77, 149, 99, 99, 29, 1, 99]);
    }
}
