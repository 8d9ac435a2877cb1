//! Disparity and depth as colours for people: near is red, far is blue, where nothing is known it is black.
//!
//! Invariant: colours go by 1/depth, which is disparity but for a factor, so both show one scene alike;
//! whatever the values are, they have colours. Colours: "Turbo" (A. Mikhailov, Google AI Blog, 2019), its
//! published polynomials of degree 5.

use trocar_sdk::data::{ImageView, PixelFormat};

/// Values looked at to find the range; more make no visible difference.
const SAMPLES: usize = 20_000;
/// Share of the values beyond each end of the scale, so that a few wrong ones do not take all colours.
const BEYOND: f64 = 0.02;

/// First and last colour of the map that are used: its own ends are nearly black, as is what nobody knows.
const ENDS: [f64; 2] = [0.08, 0.92];

/// Coefficients of x⁰ … x⁵ for red, green, blue.
const TURBO: [[f64; 6]; 3] = [
    [0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943],
    [0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604],
    [0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973],
];

/// All colours, far to near.
static COLORS: [[u8; 3]; 256] = colors();

const fn colors() -> [[u8; 3]; 256] {
    let mut all = [[0; 3]; 256];
    let mut n = 0;
    while n < 256 {
        let x = ENDS[0] + (ENDS[1] - ENDS[0]) * n as f64 / 255.0;
        let mut channel = 0;
        while channel < 3 {
            let (mut sum, mut power) = (0.0, 6);
            while power > 0 {
                power -= 1;
                sum = sum * x + TURBO[channel][power];
            }
            // A conversion to bytes stops at both ends.
            all[n][channel] = (sum * 255.0 + 0.5) as u8;
            channel += 1;
        }
        n += 1;
    }
    all
}

/// The colour of `part`, 0 (far) to 1 (near); beyond these as at the end.
pub fn turbo(part: f32) -> [u8; 3] {
    COLORS[(part * 255.0 + 0.5) as u8 as usize]
}

/// Which nearness has the first and which the last colour.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scale {
    far: f32,
    per_nearness: f32,
}

impl Scale {
    /// The scale that images of disparity or depth need; of any other format any one. Allocates.
    pub fn of(images: &[ImageView<'_>]) -> Scale {
        let mut seen: Vec<f32> = Vec::new();
        for image in images {
            let (format, pixels) = (image.format(), image.width() as usize * image.height() as usize);
            if !matches!(format, PixelFormat::DISPARITY16 | PixelFormat::DEPTH32F) || pixels == 0 {
                return Scale::default();
            }
            // Whole rows would repeat columns: what is skipped is no divisor of the width.
            let mut every = (pixels * images.len()).div_ceil(SAMPLES).max(1);
            while every > 1 && (image.width() as usize).is_multiple_of(every) {
                every += 1;
            }
            let mut skip = 0;
            for y in 0..image.height() {
                let row = image.row(y);
                let known =
                    (skip..image.width() as usize).step_by(every).filter_map(|x| nearness(format, row, x));
                seen.extend(known);
                let left = (image.width() as usize - skip.min(image.width() as usize)) % every;
                skip = if left == 0 { 0 } else { every - left };
            }
        }
        if seen.is_empty() {
            return Scale::default();
        }
        let at = (seen.len() as f64 * BEYOND) as usize;
        let far = *seen.select_nth_unstable_by(at, f32::total_cmp).1;
        let last = seen.len() - 1 - at;
        let near = *seen.select_nth_unstable_by(last, f32::total_cmp).1;
        let reach = near - far;
        if reach > 0.0 && reach.is_finite() {
            Scale { far, per_nearness: 1.0 / reach }
        } else {
            // All of one distance: the colour in the middle.
            Scale { far: far - 0.5, per_nearness: 1.0 }
        }
    }

    /// Appends the colours of one row of an image of disparity or depth.
    pub fn row(self, format: PixelFormat, row: &[u8], rgb: &mut Vec<u8>) {
        let pixels = row.len() / format.bytes_per_pixel().max(1);
        rgb.extend((0..pixels).flat_map(|x| match nearness(format, row, x) {
            Some(nearness) => turbo((nearness - self.far) * self.per_nearness),
            None => [0; 3],
        }));
    }
}

/// Disparity in 1/16 px, or 1/depth in 1/m; none where nothing is known.
fn nearness(format: PixelFormat, row: &[u8], x: usize) -> Option<f32> {
    match format {
        PixelFormat::DISPARITY16 => {
            let value = i16::from_ne_bytes(*row.get(2 * x..)?.first_chunk()?);
            (value >= 0).then_some(f32::from(value))
        }
        PixelFormat::DEPTH32F => {
            let value = f32::from_ne_bytes(*row.get(4 * x..)?.first_chunk()?);
            let nearness = value.recip();
            (value > 0.0 && nearness.is_finite()).then_some(nearness)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::data::StereoHeader;

    fn scale(format: PixelFormat, width: u32, bytes: &[u8]) -> Scale {
        let stride = width * format.bytes_per_pixel() as u32;
        let height = bytes.len() as u32 / stride;
        let header = StereoHeader { width, height, stride, format, ..Default::default() };
        Scale::of(&header.images(bytes).expect("fits")[..1])
    }

    #[test]
    fn turbo_goes_from_blue_over_green_to_red() {
        let [far, middle, near] = [0.0, 0.5, 1.0].map(turbo);
        assert!(far[2] > 150 && far[2] > 2 * far[0] && far[2] > 2 * far[1], "{far:?}");
        assert!(middle[1] > 240 && middle[1] > middle[0] && middle[0] > middle[2], "{middle:?}");
        assert!(near[0] > 150 && near[1] < 40 && near[2] < 10, "{near:?}");
        assert_eq!([turbo(-3.0), turbo(f32::NAN), turbo(9.0)], [turbo(0.0), turbo(0.0), turbo(1.0)]);
    }

    #[test]
    fn a_few_wild_values_leave_the_others_their_colours() {
        let values: Vec<u8> = (0..10_000)
            .flat_map(|n| (if n % 100 == 0 { 30_000i16 } else { 160 + n % 160 }).to_ne_bytes())
            .collect();
        let scale = scale(PixelFormat::DISPARITY16, 100, &values);
        assert!((scale.per_nearness - 1.0 / 155.0).abs() < 0.001, "{scale:?}");
    }

    #[test]
    fn images_without_a_range_still_have_a_scale() {
        let unknown = [-1i16; 6].map(i16::to_ne_bytes).concat();
        assert_eq!(scale(PixelFormat::DISPARITY16, 2, &unknown), Scale::default());
        assert_eq!(scale(PixelFormat::RGB8, 1, &[0; 9]), Scale::default());
        let flat = scale(PixelFormat::DEPTH32F, 2, &[0.2f32; 6].map(f32::to_ne_bytes).concat());
        let mut rgb = Vec::new();
        flat.row(PixelFormat::DEPTH32F, &0.2f32.to_ne_bytes(), &mut rgb);
        assert_eq!(rgb, turbo(0.5));
    }

    #[test]
    fn depths_that_are_none_are_black() {
        let wild = [0.1f32, 0.2, f32::NAN, f32::INFINITY, 0.0, -1.0, 1e-45].map(f32::to_ne_bytes).concat();
        let scale = scale(PixelFormat::DEPTH32F, 7, &wild);
        let mut rgb = Vec::new();
        scale.row(PixelFormat::DEPTH32F, &wild, &mut rgb);
        let black: Vec<bool> = rgb.as_chunks::<3>().0.iter().map(|c| *c == [0; 3]).collect();
        assert_eq!(black, [false, false, true, false, true, true, true], "the infinitely far is far");
    }
}
