//! Pictures of depth: colours in even steps of brightness, a bar that says what they mean, gaps as gaps.
//!
//! Invariant: a pixel whose depth is not known is hatched in grey, as no depth is, and takes no part in the
//! range; the ends of the bar are the ends of the range.

use trocar_imaging::letters::{self, letters};
use trocar_sdk::data::ImageView;

use crate::file::Picture;

/// Every eighth colour of "viridis", far to near (S. van der Walt and N. Smith, *A Better Default Colormap
/// for Matplotlib*, 2015; CC0). Brightness rises evenly, so that it shows the order by itself and to people
/// of any colour vision.
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 145, 140],
    [40, 174, 128],
    [93, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Colours where no depth is known: grey with lines of another grey.
pub(crate) const GAP: [[u8; 3]; 2] = [[38, 38, 38], [74, 74, 74]];
/// From one line of the hatching to the next, px.
const HATCH: usize = 8;

const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [20; 3];
/// Letters, px.
const LETTERS: u32 = 16;
/// Width of the bar, from the picture to it, and of all that is to the right of the picture, px.
const BAR: usize = 20;
const BESIDE: usize = 14;
const RIGHT: usize = 120;
/// Rows above and below the bar, for the unit and half a letter, px.
const ABOVE: usize = 30;
const BELOW: usize = 12;
/// Height of the bar at least, px.
const SHORTEST: usize = 100;
/// Rows for the sentence below, px.
const CAPTION: usize = 24;
/// Share of the depths beyond the near and the far end of the range, so that a few wrong ones do not take all
/// colours. A tool is near and may cover some of the picture; the pit of the fovea is far and small.
const BEYOND: [f64; 2] = [0.02, 0.002];
/// Steps of the bar, as near as round numbers come to it.
const STEPS: f64 = 8.0;
/// Narrowest range, m: with less, the figures of the bar do not differ.
const NARROWEST: f64 = 6e-6;

/// The plane that the colours count from, and the range that they cover.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Settings {
    /// The plane that is 0, m from the cameras; none: the median of the frame.
    pub(crate) plane_m: Option<f64>,
    /// First and last colour, m beyond the plane; none: the frame decides.
    pub(crate) range_m: Option<[f64; 2]>,
}

/// The colours of a frame: plane, range and step of the bar, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    pub(crate) plane_m: f64,
    /// Nearest and farthest, beyond the plane.
    pub(crate) range_m: [f64; 2],
    pub(crate) step_m: f64,
}

impl Scale {
    /// For images of depth. Without a depth in them, around the plane.
    pub(crate) fn of(images: &[ImageView<'_>], settings: &Settings) -> Scale {
        let rows = images.iter().flat_map(|image| (0..image.height()).map(|y| image.row(y)));
        let mut all: Vec<f64> =
            rows.flat_map(|row| row.as_chunks::<4>().0).filter_map(|pixel| depth(*pixel)).collect();
        all.sort_unstable_by(f64::total_cmp);
        let at = |part: f64| all.get((part * all.len().saturating_sub(1) as f64).round() as usize).copied();
        let plane_m = settings.plane_m.or(at(0.5)).unwrap_or(0.0);
        let ends = [at(BEYOND[0]), at(1.0 - BEYOND[1])].map(|end| end.map_or(0.0, |end| end - plane_m));
        let [near, far] = settings.range_m.unwrap_or(ends);
        let wide = (far - near).max(NARROWEST);
        let step_m = round_up(wide / STEPS);
        // The rounding errors of a float make no step more.
        let down = |at: f64| (at / step_m + 1e-3).floor() * step_m;
        let up = |at: f64| (at / step_m - 1e-3).ceil() * step_m;
        let range_m = settings.range_m.unwrap_or([down(near), up(near + wide)]);
        Scale { plane_m, range_m, step_m }
    }

    /// The colour of a depth, m from the cameras; beyond the range as at its end.
    pub(crate) fn color(&self, depth_m: f64) -> [u8; 3] {
        let [near, far] = self.range_m;
        let part = ((far - (depth_m - self.plane_m)) / (far - near)).clamp(0.0, 1.0);
        viridis(part)
    }
}

/// The colour of `part`, 0 (far) to 1 (near).
fn viridis(part: f64) -> [u8; 3] {
    let place = part * (VIRIDIS.len() - 1) as f64;
    let below = (place as usize).min(VIRIDIS.len() - 2);
    let rest = place - below as f64;
    let mix = |channel: usize| {
        let [a, b] = [VIRIDIS[below][channel], VIRIDIS[below + 1][channel]].map(f64::from);
        (a + rest * (b - a) + 0.5) as u8
    };
    [mix(0), mix(1), mix(2)]
}

/// The depth of a pixel, m; none where it is not known.
fn depth(pixel: [u8; 4]) -> Option<f64> {
    let depth_m = f64::from(f32::from_ne_bytes(pixel));
    (depth_m > 0.0 && depth_m.is_finite()).then_some(depth_m)
}

/// 1, 2 or 5 times a power of ten, at least `least`.
fn round_up(least: f64) -> f64 {
    let tens = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|n| n * tens)
        .find(|step| *step >= least * (1.0 - 1e-9))
        .unwrap_or(10.0 * tens)
}

/// Draws images of depth side by side, from the upper left corner on, with a bar at the right and a sentence
/// below.
pub(crate) fn draw(images: &[ImageView<'_>], settings: &Settings) -> Picture {
    let scale = Scale::of(images, settings);
    let width: usize = images.iter().map(|image| image.width() as usize).sum();
    let height = images.iter().map(|image| image.height() as usize).max().unwrap_or(0);
    let caption = format!("0: plane {} mm from the cameras; hatched: not known", figure(scale.plane_m * 1e3));
    let wide = (width + RIGHT).max(letters::width(&caption, LETTERS) + 8);
    let high = height.max(ABOVE + SHORTEST + BELOW) + CAPTION;
    let mut picture = Picture { width: wide as u32, height: high as u32, rgb: PAPER.repeat(wide * high) };
    let mut left = 0;
    for image in images {
        for y in 0..image.height() {
            for (x, pixel) in image.row(y).as_chunks::<4>().0.iter().enumerate() {
                let gap = GAP[usize::from((left + x + y as usize).is_multiple_of(HATCH))];
                put(
                    &mut picture,
                    left + x,
                    y as usize,
                    depth(*pixel).map_or(gap, |depth| scale.color(depth)),
                );
            }
        }
        left += image.width() as usize;
    }
    bar(&mut picture, &scale, width + BESIDE, high - CAPTION);
    text(&mut picture, 4, (high - CAPTION + 4) as i64, &caption);
    picture
}

/// The bar, near above far, with its left side at `left`, above row `end`.
fn bar(picture: &mut Picture, scale: &Scale, left: usize, end: usize) {
    let [near, far] = scale.range_m;
    let rows = end - ABOVE - BELOW;
    let place = |beyond_m: f64| (beyond_m - near) / (far - near) * (rows - 1) as f64;
    text(picture, left, 4, "depth, µm");
    for row in 0..rows {
        let beyond_m = near + (far - near) * row as f64 / (rows - 1) as f64;
        let color = scale.color(scale.plane_m + beyond_m);
        (0..BAR).for_each(|x| put(picture, left + x, ABOVE + row, color));
    }
    // Round numbers within the range, and both of its ends.
    let first = (near / scale.step_m).ceil();
    let count = ((far - near) / scale.step_m) as usize + 1;
    let round = (0..count).map(|n| (first + n as f64) * scale.step_m);
    let apart = 1.2 * f64::from(LETTERS);
    let inner = round.filter(|at| place(*at) > apart && place(*at) < (rows - 1) as f64 - apart);
    for at in [near, far].into_iter().chain(inner) {
        let row = ABOVE + place(at).round() as usize;
        (0..5).for_each(|x| put(picture, left + BAR + x, row, INK));
        text(picture, left + BAR + 8, row as i64 - i64::from(LETTERS) / 2, &figure(at * 1e6));
    }
}

/// A figure without what floats add to it.
fn figure(value: f64) -> String {
    // Adding 0 makes -0 a 0.
    format!("{}", (value * 1e3).round() / 1e3 + 0.0)
}

fn put(picture: &mut Picture, x: usize, y: usize, color: [u8; 3]) {
    let (width, height) = (picture.width as usize, picture.height as usize);
    if x < width && y < height {
        let at = 3 * (y * width + x);
        picture.rgb[at..at + 3].copy_from_slice(&color);
    }
}

fn text(picture: &mut Picture, x: usize, y: i64, words: &str) {
    for letter in letters(words, LETTERS) {
        for (row, to_y) in letter.rows().zip(y..) {
            let Ok(to_y) = usize::try_from(to_y) else { continue };
            for (n, ink) in row.iter().enumerate().filter(|(_, ink)| **ink > 0) {
                let level = |from: u8, to: u8| {
                    ((u32::from(from) * (255 - u32::from(*ink)) + u32::from(to) * u32::from(*ink)) / 255)
                        as u8
                };
                put(picture, x + letter.left + n, to_y, [0, 1, 2].map(|c| level(PAPER[c], INK[c])));
            }
        }
    }
}

#[cfg(test)]
#[path = "depth_map_tests.rs"]
mod tests;
