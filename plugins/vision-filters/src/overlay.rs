//! Text, lines and pictures drawn into images, with transparency.
//!
//! Invariant: wherever an item is asked to go, only pixels of the image are written; nothing is allocated.

pub use trocar_imaging::letters::SIZES;
use trocar_imaging::letters::{Letter, letters};

use crate::gray::luma;
use crate::view::{Format, ViewMut};

/// Red, green, blue, and how much of it covers what is below: 255 all of it.
pub type Color = [u8; 4];

/// A picture with transparency, four bytes per pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// px.
    pub width: usize,
    /// px.
    pub height: usize,
    /// Red, green, blue, opacity of each pixel, row after row.
    pub rgba: Vec<u8>,
}

/// Writes one line of text with the upper left corner at (`x`, `y`) px, letters `size` px high (the nearest
/// of [`SIZES`]). Letters outside of Latin-1 become `?`.
pub fn text(image: &mut ViewMut<'_>, (x, y): (i64, i64), size: u32, color: Color, text: &str) {
    for letter in letters(text, size) {
        let left = x + letter.left as i64;
        if left >= image.shape().width as i64 {
            return;
        }
        draw_letter(image, (left, y), color, &letter);
    }
}

fn draw_letter(image: &mut ViewMut<'_>, (x, y): (i64, i64), color: Color, letter: &Letter) {
    for (row, to) in letter.rows().zip(y..) {
        for (&ink, to_x) in row.iter().zip(x..) {
            put(image, to_x, to, color, ink);
        }
    }
}

/// Draws a line from `from` to `to`, px, `width` px wide, with smooth sides.
pub fn line(image: &mut ViewMut<'_>, from: (f64, f64), to: (f64, f64), width: f64, color: Color) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy);
    let steep = dy.abs() > dx.abs();
    // Along the longer side pixel by pixel, across it as far as the width reaches.
    let ((a0, c0), (along, across)) = if steep { ((from.1, from.0), (dy, dx)) } else { (from, (dx, dy)) };
    let (slope, reach) = if along == 0.0 {
        (0.0, width / 2.0 + 1.0)
    } else {
        (across / along, (width / 2.0 + 1.0) * length / along.abs())
    };
    let shape = image.shape();
    let (side, other) = if steep { (shape.height, shape.width) } else { (shape.width, shape.height) };
    let (first, last) = (a0.min(a0 + along) - width / 2.0 - 1.0, a0.max(a0 + along) + width / 2.0 + 1.0);
    let within = |v: f64, side: usize| v.clamp(0.0, side as f64) as i64;
    for a in within(first.floor(), side)..within(last.ceil() + 1.0, side) {
        let centre = c0 + (a as f64 - a0) * slope;
        for c in within((centre - reach).floor(), other)..within((centre + reach).ceil() + 1.0, other) {
            let (x, y) = if steep { (c, a) } else { (a, c) };
            let (px, py) = (x as f64 - from.0, y as f64 - from.1);
            let t =
                if length > 0.0 { ((px * dx + py * dy) / (length * length)).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (px - t * dx).hypot(py - t * dy);
            let ink = (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0);
            put(image, x, y, color, (ink * 255.0).round() as u8);
        }
    }
}

/// Lays a picture with its upper left corner at (`x`, `y`) px; `alpha` as the opacity of a [`Color`].
pub fn picture(image: &mut ViewMut<'_>, (x, y): (i64, i64), alpha: u8, picture: &Picture) {
    let pixels = picture.rgba.as_chunks::<4>().0;
    for (row, to_y) in pixels.chunks(picture.width.max(1)).zip(y..) {
        for (&[r, g, b, opacity], to_x) in row.iter().zip(x..) {
            put(image, to_x, to_y, [r, g, b, opacity], alpha);
        }
    }
}

/// Lets `color` cover the pixel at (`x`, `y`), `ink` of 255 parts; outside of the image it does nothing.
#[inline]
fn put(image: &mut ViewMut<'_>, x: i64, y: i64, color: Color, ink: u8) {
    let shape = image.shape();
    let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
    if x >= shape.width || y >= shape.height || ink == 0 {
        return;
    }
    let [r, g, b, opacity] = color;
    let part = (u32::from(opacity) * u32::from(ink) + 127) / 255;
    let row = image.row_mut(y);
    match shape.format {
        Format::Gray8 => row[x] = mix(row[x], luma(r, g, b), part),
        Format::Rgb8 => {
            for (to, level) in row[3 * x..3 * x + 3].iter_mut().zip([r, g, b]) {
                *to = mix(*to, level, part);
            }
        }
    }
}

/// `part` of 255 parts of `over`, the rest `below`.
#[inline]
pub(crate) fn mix(below: u8, over: u8, part: u32) -> u8 {
    ((u32::from(below) * (255 - part) + u32::from(over) * part + 127) / 255) as u8
}

#[cfg(test)]
#[path = "overlay_tests.rs"]
mod tests;
