//! Between pixel formats: RGB8, BGR8, RGBA8, YUYV and GRAY8.
//!
//! Invariant: a row that cannot be converted is not begun.

use trocar_imaging::simd::Avx2;
use trocar_imaging::{luma, luma_row, yuyv};
use trocar_sdk::data::PixelFormat;

/// Format that a row of pixels is brought to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    /// Brightness.
    Gray8,
    /// Red first.
    Rgb8,
    /// Blue first.
    Bgr8,
}

impl To {
    /// As a header says it.
    pub const fn format(self) -> PixelFormat {
        match self {
            To::Gray8 => PixelFormat::GRAY8,
            To::Rgb8 => PixelFormat::RGB8,
            To::Bgr8 => PixelFormat::BGR8,
        }
    }
}

/// Converts a row; false when there is no way from this format. YUYV rows have an even number of pixels; of
/// an odd one the last pixel takes the colour of the one before.
#[must_use]
pub fn convert_row(from: PixelFormat, src: &[u8], to: To, dst: &mut [u8]) -> bool {
    match (from, to) {
        (PixelFormat::GRAY8, To::Gray8) | (PixelFormat::RGB8, To::Rgb8) | (PixelFormat::BGR8, To::Bgr8) => {
            let n = src.len().min(dst.len());
            dst[..n].copy_from_slice(&src[..n]);
        }
        (PixelFormat::RGB8, To::Gray8) => luma_row(Avx2::detect(), src, dst),
        (PixelFormat::BGR8, To::Gray8) => to_gray::<3>(src, dst, |[b, g, r]| luma(r, g, b)),
        (PixelFormat::RGBA8, To::Gray8) => to_gray::<4>(src, dst, |[r, g, b, _]| luma(r, g, b)),
        // In a YUYV row every other byte is the brightness, video range.
        (PixelFormat::YUYV, To::Gray8) => to_gray::<2>(src, dst, |[y, _]| yuyv::pixel(y, 128, 128)[0]),
        (PixelFormat::GRAY8, To::Rgb8 | To::Bgr8) => to_colour::<1>(src, dst, |[y]| [y; 3]),
        (PixelFormat::BGR8, To::Rgb8) | (PixelFormat::RGB8, To::Bgr8) => {
            to_colour::<3>(src, dst, |[a, b, c]| [c, b, a]);
        }
        (PixelFormat::RGBA8, To::Rgb8) => to_colour::<4>(src, dst, |[r, g, b, _]| [r, g, b]),
        (PixelFormat::RGBA8, To::Bgr8) => to_colour::<4>(src, dst, |[r, g, b, _]| [b, g, r]),
        (PixelFormat::YUYV, To::Rgb8 | To::Bgr8) => {
            yuyv::row(Avx2::detect(), src, to == To::Bgr8, dst);
        }
        _ => return false,
    }
    true
}

#[inline(always)]
fn to_gray<const N: usize>(src: &[u8], dst: &mut [u8], of: impl Fn([u8; N]) -> u8) {
    dst.iter_mut().zip(src.as_chunks::<N>().0).for_each(|(to, from)| *to = of(*from));
}

#[inline(always)]
fn to_colour<const N: usize>(src: &[u8], dst: &mut [u8], of: impl Fn([u8; N]) -> [u8; 3]) {
    dst.as_chunks_mut::<3>().0.iter_mut().zip(src.as_chunks::<N>().0).for_each(|(to, from)| *to = of(*from));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn converted(from: PixelFormat, src: &[u8], to: To) -> Vec<u8> {
        let pixels = src.len() / from.bytes_per_pixel();
        let mut out = vec![9; pixels * to.format().bytes_per_pixel()];
        assert!(convert_row(from, src, to, &mut out));
        out
    }

    #[test]
    fn colours_change_places_and_keep_their_levels() {
        let rgb = [1, 2, 3, 4, 5, 6];
        assert_eq!(converted(PixelFormat::RGB8, &rgb, To::Bgr8), [3, 2, 1, 6, 5, 4]);
        assert_eq!(converted(PixelFormat::BGR8, &rgb, To::Rgb8), [3, 2, 1, 6, 5, 4]);
        assert_eq!(converted(PixelFormat::RGB8, &rgb, To::Rgb8), rgb);
        assert_eq!(converted(PixelFormat::RGBA8, &[1, 2, 3, 99], To::Rgb8), [1, 2, 3]);
        assert_eq!(converted(PixelFormat::RGBA8, &[1, 2, 3, 99], To::Bgr8), [3, 2, 1]);
        assert_eq!(converted(PixelFormat::GRAY8, &[7], To::Bgr8), [7; 3]);
        assert_eq!(converted(PixelFormat::BGR8, &[255, 0, 0], To::Gray8), [29], "blue is dark");
        assert_eq!(converted(PixelFormat::RGBA8, &[0, 255, 0, 0], To::Gray8), [149]);
    }

    #[test]
    fn yuyv_black_white_and_primaries_are_those_of_bt_601() {
        assert_eq!(converted(PixelFormat::YUYV, &[16, 128, 235, 128], To::Rgb8), [0, 0, 0, 255, 255, 255]);
        assert_eq!(converted(PixelFormat::YUYV, &[16, 128, 235, 128], To::Gray8), [0, 255]);
        // Red, blue: 65.5/-37.8/112 and 25/112/-18.2 above black.
        let [r, g, b] = converted(PixelFormat::YUYV, &[81, 90, 81, 240], To::Rgb8)[..3] else {
            panic!("one pixel")
        };
        assert!(r >= 253 && g <= 1 && b <= 1, "{r} {g} {b}");
        let [b, g, r] = converted(PixelFormat::YUYV, &[41, 240, 41, 110], To::Bgr8)[..3] else {
            panic!("one pixel")
        };
        assert!(r <= 1 && g <= 1 && b >= 253, "{r} {g} {b}");
    }

    #[test]
    fn an_odd_yuyv_row_ends_with_a_pixel_of_the_colour_before() {
        let out = converted(PixelFormat::YUYV, &[81, 90, 81, 240, 81, 90], To::Rgb8);
        assert_eq!(out[3..6], out[6..9]);
        assert_eq!(converted(PixelFormat::YUYV, &[235, 128], To::Rgb8), [255; 3]);
    }

    #[test]
    fn there_is_no_way_from_formats_that_are_no_pixels_of_a_picture() {
        for from in [PixelFormat::BAYER_RG8, PixelFormat::GRAY16, PixelFormat::DEPTH32F, PixelFormat(77)] {
            let mut out = [5; 3];
            assert!(!convert_row(from, &[1; 12], To::Rgb8, &mut out));
            assert_eq!(out, [5; 3]);
        }
    }
}
