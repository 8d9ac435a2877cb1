//! Frames that are images as small JPEGs, for readers outside.
//!
//! Invariant: header and bytes come from a plugin: every size is checked against the available bytes before
//! one of them is read, and a frame that is no image gives none, without a report. Never called by a thread
//! that steps.

use jpeg_encoder::{ColorType, Encoder};
use serde_json::Value;
use trocar_lcm_api::Eye;

/// Widths of the pictures, px.
const WIDTHS: std::ops::RangeInclusive<u32> = 16..=1920;
/// Longest side of an image, px: no camera has a longer one.
const MOST: usize = 16_384;
/// JPEG quality of 100: artefacts are not seen, and 1024 × 576 has some 80 kB.
const QUALITY: u8 = 80;
/// Values that set the scale from distance to brightness; more make no visible difference.
const SAMPLES: usize = 20_000;

/// Pixel formats of docs/INTERFACES.md.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Gray8,
    Rgb8,
    Bgr8,
    Rgba8,
    Gray16,
    BayerRg8,
    Yuyv,
    Disparity16,
    Depth32f,
}

impl Format {
    fn of(value: &Value) -> Option<Format> {
        Some(match value.as_str()? {
            "GRAY8" => Format::Gray8,
            "RGB8" => Format::Rgb8,
            "BGR8" => Format::Bgr8,
            "RGBA8" => Format::Rgba8,
            "GRAY16" => Format::Gray16,
            "BAYER_RG8" => Format::BayerRg8,
            "YUYV" => Format::Yuyv,
            "DISPARITY16" => Format::Disparity16,
            "DEPTH32F" => Format::Depth32f,
            _ => return None,
        })
    }

    /// Bytes per pixel.
    fn size(self) -> usize {
        match self {
            Format::Gray8 | Format::BayerRg8 => 1,
            Format::Gray16 | Format::Yuyv | Format::Disparity16 => 2,
            Format::Rgb8 | Format::Bgr8 => 3,
            Format::Rgba8 | Format::Depth32f => 4,
        }
    }
}

/// An image whose rows all lie inside the bytes.
struct Image<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    format: Format,
}

/// Red, green, blue, rows touching.
pub(super) struct Small {
    rgb: Vec<u8>,
    width: u16,
    height: u16,
}

impl<'a> Image<'a> {
    fn of(header: &Value, bytes: &'a [u8]) -> Option<Image<'a>> {
        let side = |name: &str| header.get(name)?.as_u64().and_then(|n| usize::try_from(n).ok());
        let (width, height, stride) = (side("width")?, side("height")?, side("stride")?);
        let format = Format::of(header.get("format")?)?;
        let row = width.checked_mul(format.size())?;
        let whole = stride.checked_mul(height.checked_sub(1)?)?.checked_add(row)?;
        let fits = (1..=MOST).contains(&width) && height <= MOST && row <= stride && whole <= bytes.len();
        fits.then_some(Image { bytes, width, height, stride, format })
    }

    fn row(&self, y: usize) -> &'a [u8] {
        &self.bytes[y * self.stride..][..self.width * self.format.size()]
    }

    /// Adds the pixels of a row to the sums of the boxes they lie in.
    fn gather(&self, y: usize, light: Light, boxes: &[u32], sums: &mut [[u32; 3]]) {
        let row = self.row(y);
        match self.format {
            Format::Gray8 => add(boxes, sums, row.iter().map(|v| [*v; 3])),
            Format::Rgb8 => add(boxes, sums, row.as_chunks::<3>().0.iter().copied()),
            Format::Bgr8 => add(boxes, sums, row.as_chunks::<3>().0.iter().map(|[b, g, r]| [*r, *g, *b])),
            Format::Rgba8 => add(boxes, sums, row.as_chunks::<4>().0.iter().map(|[r, g, b, _]| [*r, *g, *b])),
            // The upper half: native order is little endian wherever this runs.
            Format::Gray16 => add(boxes, sums, row.as_chunks::<2>().0.iter().map(|[_, high]| [*high; 3])),
            Format::Yuyv => add(boxes, sums, (0..self.width).map(|x| yuyv(row, x))),
            Format::BayerRg8 => {
                let (red, blue) = (self.row(y & !1), self.row((y | 1).min(self.height - 1)));
                let last = self.width - 1;
                add(
                    boxes,
                    sums,
                    (0..self.width).map(|x| [red[x & !1], red[(x | 1).min(last)], blue[(x | 1).min(last)]]),
                );
            }
            Format::Disparity16 | Format::Depth32f => {
                add(
                    boxes,
                    sums,
                    (0..self.width).map(|x| [light.of_nearness(nearness(self.format, row, x)); 3]),
                );
            }
        }
    }

    fn scaled(&self, asked: u32, light: Light) -> Small {
        let width = (asked as usize).min(self.width);
        let height = (self.height * width / self.width).clamp(1, usize::from(u16::MAX));
        let boxes: Vec<u32> = (0..self.width).map(|x| (x * width / self.width) as u32).collect();
        let mut counts = vec![0_u32; width];
        for to in &boxes {
            counts[*to as usize] += 1;
        }
        let mut rgb = Vec::with_capacity(3 * width * height);
        let mut sums = vec![[0_u32; 3]; width];
        for y in 0..height {
            let (first, end) = (y * self.height / height, (y + 1) * self.height / height);
            sums.fill([0; 3]);
            for row in first..end {
                self.gather(row, light, &boxes, &mut sums);
            }
            for (sum, count) in sums.iter().zip(&counts) {
                let n = count * (end - first) as u32;
                rgb.extend(sum.map(|part| ((part + n / 2) / n.max(1)) as u8));
            }
        }
        Small { rgb, width: width as u16, height: height as u16 }
    }
}

fn add(boxes: &[u32], sums: &mut [[u32; 3]], pixels: impl Iterator<Item = [u8; 3]>) {
    for (to, rgb) in boxes.iter().zip(pixels) {
        for (sum, part) in sums[*to as usize].iter_mut().zip(rgb) {
            *sum += u32::from(part);
        }
    }
}

/// Scale from nearness to brightness: which is black and which is white.
#[derive(Clone, Copy, Default)]
struct Light {
    far: f32,
    per_nearness: f32,
}

impl Light {
    /// The range of the images' values, without a few at its ends; for images of light any scale.
    fn of(images: &[&Image<'_>]) -> Light {
        let is_of_depth =
            |image: &&&Image<'_>| matches!(image.format, Format::Disparity16 | Format::Depth32f);
        let mut seen = Vec::new();
        for image in images.iter().filter(is_of_depth) {
            let every = (image.width * image.height * images.len()).div_ceil(SAMPLES).max(1);
            let places = (0..image.width * image.height).step_by(every);
            seen.extend(
                places.filter_map(|at| nearness(image.format, image.row(at / image.width), at % image.width)),
            );
        }
        seen.sort_unstable_by(f32::total_cmp);
        let [Some(far), Some(near)] =
            [seen.len() / 50, (seen.len() * 49 / 50).min(seen.len().saturating_sub(1))]
                .map(|at| seen.get(at))
        else {
            return Light::default();
        };
        Light { far: *far, per_nearness: (near - far).max(f32::MIN_POSITIVE).recip() }
    }

    /// Near is bright; unknown is black.
    fn of_nearness(self, nearness: Option<f32>) -> u8 {
        let part = |nearness: f32| ((nearness - self.far) * self.per_nearness).clamp(0.0, 1.0);
        nearness.map_or(0, |nearness| (40.0 + 215.0 * part(nearness)) as u8)
    }
}

/// Disparity in 1/16 px, or 1/depth in 1/m; `None` where unknown.
fn nearness(format: Format, row: &[u8], x: usize) -> Option<f32> {
    if format == Format::Disparity16 {
        let value = i16::from_le_bytes(row.as_chunks::<2>().0[x]);
        return (value >= 0).then_some(f32::from(value));
    }
    let value = f32::from_le_bytes(row.as_chunks::<4>().0[x]);
    (value > 0.0 && value.recip().is_finite()).then_some(value.recip())
}

/// ITU-R BT.601, video range; of an odd number of pixels the last one has no V and is grey.
fn yuyv(row: &[u8], x: usize) -> [u8; 3] {
    let pair = (x & !1) * 2;
    let (u, v) = match (row.get(pair + 1), row.get(pair + 3)) {
        (Some(u), Some(v)) => (i32::from(*u) - 128, i32::from(*v) - 128),
        _ => (0, 0),
    };
    let y = 298 * (i32::from(row[2 * x]) - 16);
    [409 * v, -100 * u - 208 * v, 516 * u].map(|tint| ((y + tint + 128) >> 8).clamp(0, 255) as u8)
}

/// The image in a frame as an eye sees it, `width` wide at most; `None` where the frame is no image.
pub(super) fn small(header: &Value, bytes: &[u8], width: u32, eye: Eye) -> Option<Small> {
    let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
    // Where the right image begins; at 0 there is one image for both eyes.
    let right_at = header.get("right_offset").filter(|at| at.as_u64() != Some(0));
    let left = || Image::of(header, bytes);
    let right = |at: &Value| Image::of(header, bytes.get(usize::try_from(at.as_u64()?).ok()?..)?);
    let alone = |image: Image<'_>| image.scaled(width, Light::of(&[&image]));
    match (eye, right_at) {
        (Eye::Left, _) | (_, None) => left().map(alone),
        (Eye::Right, Some(at)) => right(at).map(alone),
        (Eye::Both, Some(at)) => {
            let (left, right) = (left()?, right(at)?);
            // One scale for both: what is as near is as bright.
            let light = Light::of(&[&left, &right]);
            Some(side_by_side(&left.scaled(width / 2, light), &right.scaled(width / 2, light)))
        }
    }
}

/// Two images of one size in one, the rows of the first before those of the second.
fn side_by_side(left: &Small, right: &Small) -> Small {
    let row = 3 * usize::from(left.width);
    let rows = left.rgb.chunks_exact(row).zip(right.rgb.chunks_exact(row));
    let rgb = rows.flat_map(|(left, right)| [left, right]).flatten().copied().collect();
    Small { rgb, width: 2 * left.width, height: left.height }
}

/// The image as JPEG; empty when it cannot be coded, which never happens for allowed sides.
pub(super) fn jpeg(small: &Small) -> Vec<u8> {
    let mut coded = Vec::new();
    let encoder = Encoder::new(&mut coded, QUALITY);
    match encoder.encode(&small.rgb, small.width, small.height, ColorType::Rgb) {
        Ok(()) => coded,
        Err(e) => {
            log::warn!("a picture of {} × {} was not coded: {e}", small.width, small.height);
            Vec::new()
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use serde_json::json;

    use super::*;

    fn header(format: &str, width: usize, height: usize, stride: usize) -> Value {
        json!({ "width": width, "height": height, "stride": stride, "format": format })
    }

    fn shown(format: &str, width: usize, height: usize, bytes: &[u8], to: u32) -> Small {
        let size = Format::of(&json!(format)).unwrap().size();
        small(&header(format, width, height, width * size), bytes, to, Eye::Left).unwrap()
    }

    #[test]
    fn every_format_gives_the_colour_that_was_put_in() {
        let cases: [(&str, &[u8], [u8; 3]); 7] = [
            ("GRAY8", &[90], [90; 3]),
            ("RGB8", &[10, 120, 240], [10, 120, 240]),
            ("BGR8", &[240, 120, 10], [10, 120, 240]),
            ("RGBA8", &[10, 120, 240, 7], [10, 120, 240]),
            ("GRAY16", &[3, 77], [77; 3]),
            ("YUYV", &[235, 128], [255; 3]),
            ("BAYER_RG8", &[50], [50; 3]),
        ];
        for (format, pixel, rgb) in cases {
            let bytes = pixel.repeat(32 * 18);
            let small = shown(format, 32, 18, &bytes, 16);
            assert_eq!((small.width, small.height), (16, 9), "{format}");
            assert!(
                small.rgb.as_chunks::<3>().0.iter().all(|p| *p == rgb),
                "{format}: {:?}",
                &small.rgb[..6]
            );
        }
    }

    #[test]
    fn a_pixel_is_the_mean_of_its_box() {
        let bytes: Vec<u8> = (0..32 * 2).map(|n| if n % 2 == 0 { 0 } else { 100 }).collect();
        let small = shown("GRAY8", 32, 2, &bytes, 16);
        assert_eq!((small.width, small.height), (16, 1));
        assert!(small.rgb.iter().all(|v| *v == 50), "{:?}", small.rgb);
    }

    #[test]
    fn what_is_as_near_is_as_bright_in_both_images() {
        let mut pair = header("DEPTH32F", 32, 1, 32 * 4);
        pair["right_offset"] = json!(32 * 4);
        let depths = |least: usize| (0..32).map(move |x| (least + x) as f32);
        let bytes: Vec<u8> = depths(1).chain(depths(17)).flat_map(f32::to_le_bytes).collect();
        let both = small(&pair, &bytes, 64, Eye::Both).unwrap();
        let grey: Vec<u8> = both.rgb.as_chunks::<3>().0.iter().map(|p| p[0]).collect();
        // 17 m to 32 m are the second half of the left image, and the first of the right one.
        assert_eq!(grey[16..32], grey[32..48], "{grey:?}");
        assert!(grey[0] > grey[31], "{grey:?}");
    }

    #[test]
    fn a_pair_side_by_side_is_no_wider_than_one_image() {
        let mut pair = header("GRAY8", 4000, 4, 4000);
        pair["right_offset"] = json!(4000 * 4);
        let bytes = vec![0; 2 * 4000 * 4];
        for (asked, made) in [(1, 16), (31, 30), (u32::MAX, 1920)] {
            assert_eq!(small(&pair, &bytes, asked, Eye::Both).unwrap().width, made, "{asked}");
        }
    }

    #[test]
    fn each_eye_of_a_pair_sees_its_own_image() {
        let mut pair = header("GRAY8", 32, 4, 32);
        pair["right_offset"] = json!(32 * 4);
        let bytes = [[10_u8; 32 * 4], [200; 32 * 4]].concat();
        let grey = |small: &Small| small.rgb.as_chunks::<3>().0.iter().map(|p| p[0]).collect::<Vec<_>>();
        for (eye, light) in [(Eye::Left, 10), (Eye::Right, 200)] {
            assert!(grey(&small(&pair, &bytes, 32, eye).unwrap()).iter().all(|v| *v == light), "{eye:?}");
        }
        let both = small(&pair, &bytes, 32, Eye::Both).unwrap();
        assert_eq!((both.width, both.height), (32, 2));
        assert_eq!(grey(&both), [[10; 16], [200; 16]].concat().repeat(2));
        for beyond in [json!(32 * 4 + 1), json!(u64::MAX), json!(-1), json!("128")] {
            pair["right_offset"] = beyond;
            assert!(small(&pair, &bytes, 32, Eye::Right).is_none(), "{}", pair["right_offset"]);
        }
        assert!(small(&pair, &bytes, 32, Eye::Left).is_some(), "the left one needs no right one");
        pair["right_offset"] = json!(0);
        let mono = small(&pair, &bytes, 32, Eye::Both).unwrap();
        assert_eq!((mono.width, mono.height), (32, 4), "one image for both eyes is shown once");
        // One image is what every eye sees.
        for eye in [Eye::Left, Eye::Right, Eye::Both] {
            assert_eq!(small(&header("GRAY8", 32, 4, 32), &bytes, 32, eye).unwrap().width, 32, "{eye:?}");
        }
    }

    #[test]
    fn colours_of_a_sensor_come_from_their_own_places() {
        let rows = [[200, 100].repeat(16), [100, 30].repeat(16)];
        let bytes = rows.concat().repeat(8);
        let small = shown("BAYER_RG8", 32, 16, &bytes, 32);
        assert!(small.rgb.as_chunks::<3>().0.iter().all(|p| *p == [200, 100, 30]), "{:?}", &small.rgb[..6]);
    }

    #[test]
    fn what_is_near_is_bright_and_what_nobody_knows_is_black() {
        let disparity: Vec<u8> =
            (0..32_i16).flat_map(|x| if x == 5 { -16 } else { x * 16 }.to_le_bytes()).collect();
        let depth: Vec<u8> = (0..32)
            .flat_map(|x| if x == 5 { f32::NAN } else { 1.0 / (x + 1) as f32 }.to_le_bytes())
            .collect();
        for (format, bytes) in [("DISPARITY16", disparity), ("DEPTH32F", depth)] {
            let small = shown(format, 32, 1, &bytes, 32);
            let grey: Vec<u8> = small.rgb.as_chunks::<3>().0.iter().map(|p| p[0]).collect();
            assert_eq!(grey[5], 0, "{format}");
            assert!(grey[31] == 255 && grey[0] == 40 && grey[10] < grey[20], "{format}: {grey:?}");
        }
    }

    #[test]
    fn it_is_never_wider_than_the_image_nor_than_is_made() {
        assert_eq!(shown("GRAY8", 20, 20, &[0; 400], 640).width, 20);
        assert_eq!(shown("GRAY8", 20, 20, &[0; 400], 1).width, 16);
        assert_eq!(shown("GRAY8", 4000, 4, &[0; 16_000], u32::MAX).width, 1920);
        assert_eq!(shown("GRAY8", 4000, 1, &[0; 4000], 100).height, 1);
    }

    #[test]
    fn a_header_that_promises_more_than_there_is_gives_no_picture() {
        let bytes = [0_u8; 300];
        assert!(small(&header("RGB8", 10, 10, 30), &bytes, 64, Eye::Left).is_some());
        for bad in [
            header("RGB8", 10, 11, 30),
            header("RGB8", 10, 10, 29),
            header("RGB8", 10, 10, usize::MAX),
            header("RGB8", 0, 10, 30),
            header("RGB8", 10, 0, 30),
            header("RGB8", usize::MAX, 10, 30),
            header("GRAY8", 100_000, 1, 100_000),
            header("JPEG", 10, 10, 30),
            json!({ "width": -1, "height": 10, "stride": 30, "format": "RGB8" }),
            json!({ "width": 10, "height": 10, "stride": 30, "format": 77 }),
            json!({ "distance": 0.1 }),
            json!(7),
        ] {
            assert!(small(&bad, &bytes, 64, Eye::Left).is_none(), "{bad}");
        }
    }

    #[test]
    fn pictures_are_jpeg_that_a_decoder_could_read() {
        let coded = jpeg(&shown("RGB8", 64, 48, &[200; 64 * 48 * 3], 64));
        assert!(coded.starts_with(&[0xff, 0xd8]) && coded.ends_with(&[0xff, 0xd9]), "{}", coded.len());
        // Sides are in the frame header, SOF0.
        let at = coded.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
        assert_eq!(&coded[at + 5..at + 9], [0, 48, 0, 64]);
    }
}
