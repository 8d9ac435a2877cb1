//! Images of every format as red, green, blue, for people to look at.
//!
//! Invariant: colours are those that the filters make of the same pixels; lower halves of 16 bits are
//! dropped. Disparity and depth have [colours of their own](crate::nearness), scaled to what the frame holds.

use trocar_sdk::data::{BadFrame, ImageView, PixelFormat, StereoHeader};

use crate::nearness::Scale;
use crate::simd::Avx2;
use crate::{debayer, yuyv};

/// Which part of a pair is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Both images, side by side.
    Both,
    /// The left one.
    Left,
    /// The right one; the left one where there is one image for both.
    Right,
}

impl Part {
    /// Each part once.
    pub const ALL: [Part; 3] = [Part::Both, Part::Left, Part::Right];

    /// Its word in settings.
    pub fn name(self) -> &'static str {
        match self {
            Part::Both => "both",
            Part::Left => "left",
            Part::Right => "right",
        }
    }

    /// The images of a pair that are shown.
    pub fn of<'a, 'b>(self, header: &StereoHeader, images: &'a [ImageView<'b>; 2]) -> &'a [ImageView<'b>] {
        match self {
            // One image for both eyes is shown once.
            Part::Both if header.right_offset == 0 => &images[..1],
            Part::Both => &images[..],
            Part::Left => &images[..1],
            Part::Right => &images[1..],
        }
    }
}

/// Fills `rgb` with the pixels of a part, rows touching; gives width and height.
///
/// # Errors
/// The header promises what the bytes do not hold.
pub fn rgb(
    header: &StereoHeader,
    bytes: &[u8],
    part: Part,
    rgb: &mut Vec<u8>,
) -> Result<(u32, u32), BadFrame> {
    let images = header.images(bytes)?;
    let shown = part.of(header, &images);
    rgb.clear();
    let scale = Scale::of(shown);
    for y in 0..header.height {
        for image in shown {
            row(image, y, scale, rgb);
        }
    }
    Ok((header.width * shown.len() as u32, header.height))
}

fn row(image: &ImageView<'_>, y: u32, scale: Scale, rgb: &mut Vec<u8>) {
    let row = image.row(y);
    match image.format() {
        PixelFormat::RGB8 => rgb.extend_from_slice(row),
        PixelFormat::GRAY8 => rgb.extend(row.iter().flat_map(|v| [*v; 3])),
        PixelFormat::BGR8 => rgb.extend(row.as_chunks::<3>().0.iter().flat_map(|[b, g, r]| [*r, *g, *b])),
        PixelFormat::RGBA8 => rgb.extend(row.as_chunks::<4>().0.iter().flat_map(|[r, g, b, _]| [*r, *g, *b])),
        PixelFormat::GRAY16 => {
            let levels = row.as_chunks::<2>().0.iter().map(|v| (u16::from_ne_bytes(*v) >> 8) as u8);
            rgb.extend(levels.flat_map(|v| [v; 3]));
        }
        PixelFormat::YUYV => yuyv::row(Avx2::detect(), row, false, room(image, rgb)),
        PixelFormat::BAYER_RG8 if image.width() > 1 && image.height() > 1 => {
            let rows = debayer::neighbours(image.height() as usize, y as usize).map(|y| image.row(y as u32));
            debayer::row(rows, y % 2 == 1, room(image, rgb));
        }
        // One row or column has no pattern.
        PixelFormat::BAYER_RG8 => rgb.extend(row.iter().flat_map(|v| [*v; 3])),
        PixelFormat::DISPARITY16 | PixelFormat::DEPTH32F => scale.row(image.format(), row, rgb),
        // `images` has refused it.
        _ => rgb.extend(std::iter::repeat_n(0, 3 * image.width() as usize)),
    }
}

/// Room for one more row.
fn room<'a>(image: &ImageView<'_>, rgb: &'a mut Vec<u8>) -> &'a mut [u8] {
    let begin = rgb.len();
    rgb.resize(begin + 3 * image.width() as usize, 0);
    &mut rgb[begin..]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn header(format: PixelFormat, width: u32, height: u32) -> StereoHeader {
        let stride = width * format.bytes_per_pixel() as u32;
        let right_offset = u64::from(stride * height);
        StereoHeader { width, height, stride, format, right_offset, ..Default::default() }
    }

    fn shown(header: &StereoHeader, bytes: &[u8], part: Part) -> Vec<u8> {
        let mut to = vec![9];
        let (width, height) = rgb(header, bytes, part, &mut to).unwrap();
        assert_eq!(to.len() as u32, 3 * width * height);
        to
    }

    #[test]
    fn each_format_becomes_red_green_blue() {
        for (format, left) in [
            (PixelFormat::RGB8, vec![1, 2, 3, 4, 5, 6]),
            (PixelFormat::BGR8, vec![3, 2, 1, 6, 5, 4]),
            (PixelFormat::RGBA8, vec![1, 2, 3, 99, 4, 5, 6, 99]),
        ] {
            let bytes = [left.clone(), vec![0; left.len()]].concat();
            assert_eq!(shown(&header(format, 2, 1), &bytes, Part::Left), [1, 2, 3, 4, 5, 6], "{format:?}");
        }
        let gray = shown(&header(PixelFormat::GRAY8, 2, 1), &[1, 2, 3, 4], Part::Both);
        assert_eq!(gray, [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
        let deep: Vec<u8> = [0x1234u16, 0xff00].iter().flat_map(|v| v.to_ne_bytes()).collect();
        assert_eq!(
            shown(&header(PixelFormat::GRAY16, 1, 1), &deep, Part::Both),
            [0x12, 0x12, 0x12, 255, 255, 255]
        );
        let yuyv = header(PixelFormat::YUYV, 2, 1);
        assert_eq!(shown(&yuyv, &[235, 128, 16, 128, 0, 0, 0, 0], Part::Left), [255, 255, 255, 0, 0, 0]);
        let red = shown(&yuyv, &[82, 90, 82, 240, 0, 0, 0, 0], Part::Left);
        assert!(red[0] >= 254 && red[1] < 3 && red[2] < 3, "{red:?}");
        let mosaic = [10, 20, 40, 30, 0, 0, 0, 0];
        let colours = [[10, 30, 30], [10, 20, 30], [10, 40, 30], [10, 30, 30]].concat();
        assert_eq!(shown(&header(PixelFormat::BAYER_RG8, 2, 2), &mosaic, Part::Left), colours);
    }

    #[test]
    fn disparity_and_depth_are_coloured_by_nearness_and_black_where_nothing_is_known() {
        let disparities = [-16i16, 160, 320, 480].map(i16::to_ne_bytes).concat();
        let mono = StereoHeader { right_offset: 0, ..header(PixelFormat::DISPARITY16, 4, 1) };
        let by_disparity = shown(&mono, &disparities, Part::Both);
        let pixels = by_disparity.as_chunks::<3>().0;
        assert_eq!(pixels[0], [0; 3]);
        assert!(
            pixels[1][2] > pixels[1][0] && pixels[3][0] > pixels[3][2],
            "far is blue, near red: {pixels:?}"
        );
        // The same scene as depth looks the same: depth is 1 / disparity.
        let depths = [f32::NAN, 0.3, 0.15, 0.1].map(f32::to_ne_bytes).concat();
        let mono = StereoHeader { right_offset: 0, ..header(PixelFormat::DEPTH32F, 4, 1) };
        let by_depth = shown(&mono, &depths, Part::Left);
        for (one, other) in by_disparity.iter().zip(&by_depth) {
            assert!(one.abs_diff(*other) <= 6, "{by_disparity:?} {by_depth:?}");
        }
    }

    #[test]
    fn an_image_for_both_eyes_is_shown_once() {
        let mono = StereoHeader { right_offset: 0, ..header(PixelFormat::GRAY8, 2, 1) };
        assert_eq!(shown(&mono, &[7, 8], Part::Both), [7, 7, 7, 8, 8, 8]);
        assert_eq!(shown(&mono, &[7, 8], Part::Right), [7, 7, 7, 8, 8, 8]);
    }

    #[test]
    fn odd_sizes_of_formats_in_pairs_are_shown_without_a_panic() {
        for format in [PixelFormat::YUYV, PixelFormat::BAYER_RG8] {
            for (width, height) in [(3, 3), (1, 1), (1, 4), (4, 1), (2, 3)] {
                let header = header(format, width, height);
                let bytes = vec![100; 2 * header.right_offset as usize];
                let pixels = shown(&header, &bytes, Part::Right);
                assert_eq!(pixels.len() as u32, 3 * width * height, "{format:?} {width} × {height}");
            }
        }
    }

    #[test]
    fn a_mosaic_and_yuyv_look_as_the_filters_make_them() {
        #[rustfmt::skip]
        let mosaic = [
            10, 20, 31,
            40, 50, 60,
            70, 81, 90,
        ];
        let mono = StereoHeader { right_offset: 0, ..header(PixelFormat::BAYER_RG8, 3, 3) };
        let pixels = shown(&mono, &mosaic, Part::Left);
        assert_eq!((&pixels[12..15], &pixels[3..6]), (&[50, 50, 50][..], &[21, 20, 50][..]));
        let mono = StereoHeader { right_offset: 0, ..header(PixelFormat::YUYV, 2, 1) };
        let pixels = shown(&mono, &[81, 90, 41, 240], Part::Left);
        assert_eq!(pixels, [yuyv::pixel(81, 90, 240), yuyv::pixel(41, 90, 240)].concat());
    }

    #[test]
    fn a_header_that_lies_is_refused() {
        let lying = StereoHeader { width: 9, ..header(PixelFormat::RGB8, 2, 1) };
        assert!(rgb(&lying, &[0; 12], Part::Both, &mut Vec::new()).is_err());
    }
}
