//! Colour to brightness after ITU-R BT.601: Y = 0.299 R + 0.587 G + 0.114 B, with integer weights.
//!
//! Invariant: the weights add to 256 and the sum fits 16 bits, so black stays 0, white stays 255, grey stays
//! itself.

use crate::simd::Avx2;
use crate::weights::LUMA;

/// Brightness of one pixel.
pub fn luma(red: u8, green: u8, blue: u8) -> u8 {
    let [r, g, b] = LUMA;
    ((r * u16::from(red) + g * u16::from(green) + b * u16::from(blue) + 128) >> 8) as u8
}

/// Brightness of a row of RGB pixels; the shorter of the two rows decides how many. `lanes` as of
/// [`Avx2::detect`].
pub fn luma_row(lanes: Option<Avx2>, rgb: &[u8], gray: &mut [u8]) {
    let pixels = (rgb.len() / 3).min(gray.len());
    let done = lanes.map_or(0, |lanes| lanes.luma(&rgb[..3 * pixels], &mut gray[..pixels]));
    for (to, from) in gray[done..pixels].iter_mut().zip(rgb[3 * done..].as_chunks::<3>().0) {
        *to = luma(from[0], from[1], from[2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_instructions_give_the_same_brightness_for_every_colour_and_length() {
        let Some(lanes) = Avx2::detect() else { return };
        let mut state = 7u32;
        let mut byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Both ends of the range come often: that is where sums overflow.
            match state >> 30 {
                0 => 0,
                1 => 255,
                _ => (state >> 16) as u8,
            }
        };
        for pixels in (0..200).chain([1_024, 4_099]) {
            let rgb: Vec<u8> = (0..3 * pixels).map(|_| byte()).collect();
            let (mut wide, mut plain) = (vec![9; pixels], vec![8; pixels]);
            luma_row(Some(lanes), &rgb, &mut wide);
            luma_row(None, &rgb, &mut plain);
            assert_eq!(wide, plain, "{pixels} pixels");
        }
    }

    #[test]
    fn the_shorter_row_decides_how_many_pixels_are_made() {
        let mut gray = [7; 3];
        luma_row(Avx2::detect(), &[255, 255, 255, 0, 0, 0, 1, 1], &mut gray);
        assert_eq!(gray, [255, 0, 7]);
    }
}
