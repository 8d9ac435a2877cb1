//! Colour rows as a sensor sends them: as they are, as the mosaic of its colour filters, or as brightness and
//! colour.
//!
//! Invariant: a row has an even number of pixels, and no byte outside of it is touched.

use trocar_sdk::data::PixelFormat;

/// Writes row `y` of red, green, blue pixels as `format`. BAYER_RG8 has red at (0, 0) and blue at (1, 1).
/// YUYV is 4:2:2 after ITU-R BT.601 (16 to 235), the colour of two pixels being their mean. Other formats are
/// left alone.
pub(crate) fn write(format: PixelFormat, y: usize, rgb: &[u8], to: &mut [u8]) {
    let pairs = rgb.as_chunks::<6>().0;
    match format {
        PixelFormat::RGB8 => to.copy_from_slice(&rgb[..to.len()]),
        PixelFormat::BAYER_RG8 => {
            // Green and blue sit in the odd rows.
            let (first, second) = if y.is_multiple_of(2) { (0, 4) } else { (1, 5) };
            for (to, pair) in to.as_chunks_mut::<2>().0.iter_mut().zip(pairs) {
                *to = [pair[first], pair[second]];
            }
        }
        PixelFormat::YUYV => {
            for (to, pair) in to.as_chunks_mut::<4>().0.iter_mut().zip(pairs) {
                let [r, g, b] = [0, 1, 2].map(|c| i32::from(pair[c]) + i32::from(pair[c + 3]));
                let luma = |at: usize| {
                    let [r, g, b] = [0, 1, 2].map(|c| i32::from(pair[at + c]));
                    ((66 * r + 129 * g + 25 * b + 128) >> 8) + 16
                };
                let u = ((-38 * r - 74 * g + 112 * b + 256) >> 9) + 128;
                let v = ((112 * r - 94 * g - 18 * b + 256) >> 9) + 128;
                *to = [luma(0), u, luma(3), v].map(|value| value.clamp(0, 255) as u8);
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROW: [u8; 6] = [255, 0, 0, 0, 10, 200];

    #[test]
    fn the_mosaic_has_red_and_green_in_even_rows_and_green_and_blue_in_odd_ones() {
        let mut to = [0; 2];
        write(PixelFormat::BAYER_RG8, 0, &ROW, &mut to);
        assert_eq!(to, [255, 10]);
        write(PixelFormat::BAYER_RG8, 1, &ROW, &mut to);
        assert_eq!(to, [0, 200]);
    }

    #[test]
    fn brightness_and_colour_are_those_of_bt_601() {
        let of = |rgb: [u8; 3]| {
            let mut to = [0; 4];
            write(PixelFormat::YUYV, 0, &[rgb, rgb].concat(), &mut to);
            to
        };
        assert_eq!(of([0, 0, 0]), [16, 128, 16, 128]);
        assert_eq!(of([255, 255, 255]), [235, 128, 235, 128]);
        assert_eq!(of([255, 0, 0]), [82, 90, 82, 240]);
        assert_eq!(of([0, 0, 255]), [41, 240, 41, 110]);
    }

    #[test]
    fn colour_rows_pass_as_they_are() {
        let mut to = [0; 6];
        write(PixelFormat::RGB8, 3, &ROW, &mut to);
        assert_eq!(to, ROW);
    }
}
