//! Axes and a scale bar in a picture whose pixels have a known size, such as a B-scan.
//!
//! Invariant: only pixels inside the picture are written; a bar is as long as its label says, to the nearest
//! pixel; nothing is allocated.

use std::fmt::{self, Write};

use trocar_imaging::letters;

use crate::overlay::{Color, line, text};
use crate::pip::Rect;
use crate::view::ViewMut;

const INK: Color = [235, 235, 235, 255];
const SHADE: Color = [0, 0, 0, 130];
/// Letters, px.
const LETTERS: u32 = 16;
/// Length of a tick, px.
const TICK: f64 = 5.0;
/// From one tick to the next at least, px: down, and across.
const APART: [f64; 2] = [48.0, 72.0];
/// Smaller pictures have no room for axes, px.
const SMALLEST: (usize, usize) = (96, 64);
/// Longest scale bar, part of the width.
const LONGEST: f64 = 0.3;
/// Thickness of the bar, and from it to the edges, px.
const BAR: f64 = 3.0;
const MARGIN: f64 = 10.0;

/// Size of a pixel as it is shown, m; 0 where it is not known, and that axis is not drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSize {
    /// From one column to the next.
    pub column_m: f64,
    /// From one row to the next.
    pub row_m: f64,
}

/// A scale bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Length that the bar stands for, m: 1, 2 or 5 times a power of ten.
    pub length_m: f64,
    /// Its length, px.
    pub px: f64,
}

/// The longest bar of at most `most_px` pixels of `pixel_m`, m.
pub fn bar(pixel_m: f64, most_px: f64) -> Option<Bar> {
    let most_m = pixel_m * most_px;
    if !(most_m > 1e-12 && most_m < 1e6) {
        return None;
    }
    let tens = 10f64.powf(most_m.log10().floor());
    let length_m = [5.0, 2.0, 1.0].into_iter().map(|n| n * tens).find(|length_m| *length_m <= most_m)?;
    Some(Bar { length_m, px: length_m / pixel_m })
}

/// From one tick of an axis to the next, m: 1, 2 or 5 times a power of ten, and at least `least_px` pixels.
fn step(pixel_m: f64, least_px: f64) -> Option<f64> {
    // The longest bar of a length is at least 1/2.5 of it.
    [1.0, 2.0, 2.5]
        .into_iter()
        .find_map(|times| bar(pixel_m, times * least_px).filter(|bar| bar.px >= least_px))
        .map(|bar| bar.length_m)
}

/// A length as people read it: µm below a millimetre, else mm.
struct Label {
    bytes: [u8; 32],
    used: usize,
}

impl Label {
    fn of(length_m: f64) -> Label {
        let mut label = Label { bytes: [0; 32], used: 0 };
        // Lengths are few digits times a power of ten; the rounding takes what floats add.
        let um = (length_m * 1e9).round() / 1e3;
        let _ = if um < 999.5 { write!(label, "{um} µm") } else { write!(label, "{} mm", um / 1e3) };
        label
    }

    fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..self.used]).unwrap_or_default()
    }
}

impl Write for Label {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.bytes.get_mut(self.used..self.used + text.len()).ok_or(fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.used += text.len();
        Ok(())
    }
}

/// Draws axes along the left and the lower side of a picture that covers `rect` of an image, and a scale bar
/// above its lower right corner. The axis down counts from the first row, the axis across from the first
/// column.
pub fn draw(image: &mut ViewMut<'_>, rect: Rect, size: PixelSize) {
    if rect.width < SMALLEST.0 || rect.height < SMALLEST.1 {
        return;
    }
    down(image, rect, size.row_m);
    across(image, rect, size.column_m);
}

/// The axis down the left side.
fn down(image: &mut ViewMut<'_>, rect: Rect, pixel_m: f64) {
    let Some(step_m) = step(pixel_m, APART[0]) else { return };
    let (left, top, height) = (rect.x as f64, rect.y as f64, rect.height as f64);
    line(image, (left + 1.0, top + 1.0), (left + 1.0, top + height - 2.0), 1.0, INK);
    let high = f64::from(LETTERS);
    for n in 1..rect.height {
        let at = n as f64 * step_m / pixel_m;
        // The axis across has the last rows.
        if at + high > height - 2.0 * high {
            return;
        }
        line(image, (left + 1.0, top + at), (left + 1.0 + TICK, top + at), 1.0, INK);
        write(image, (left + TICK + 5.0, top + at - 0.5 * high), &Label::of(n as f64 * step_m));
    }
}

/// The axis across the lower side, and the bar above it.
fn across(image: &mut ViewMut<'_>, rect: Rect, pixel_m: f64) {
    let Some(step_m) = step(pixel_m, APART[1]) else { return };
    let (left, width) = (rect.x as f64, rect.width as f64);
    let bottom = (rect.y + rect.height) as f64 - 2.0;
    let high = f64::from(LETTERS);
    line(image, (left + 1.0, bottom), (left + width - 2.0, bottom), 1.0, INK);
    for n in 1..rect.width {
        let (at, label) = (n as f64 * step_m / pixel_m, Label::of(n as f64 * step_m));
        let half = 0.5 * letters::width(label.as_str(), LETTERS) as f64;
        if at + half > width - 2.0 {
            break;
        }
        line(image, (left + at, bottom - TICK), (left + at, bottom), 1.0, INK);
        write(image, (left + at - half, bottom - TICK - high), &label);
    }
    let Some(Bar { length_m, px }) = bar(pixel_m, LONGEST * width) else { return };
    let (end, low) = (left + width - MARGIN, bottom - TICK - high - MARGIN);
    let label = Label::of(length_m);
    let half = 0.5 * letters::width(label.as_str(), LETTERS) as f64;
    fill(image, (end - px.round(), low - BAR), (px.round(), BAR), INK);
    // The label stays inside where it is wider than the bar.
    let middle = (end - 0.5 * px).min(left + width - 2.0 - half);
    write(image, (middle - half, low - BAR - high), &label);
}

/// A filled rectangle, `size` px.
fn fill(image: &mut ViewMut<'_>, (x, y): (f64, f64), (width, height): (f64, f64), color: Color) {
    for row in 0..height as usize {
        let y = y.round() + row as f64;
        // A line of one pixel ends half a pixel beyond its ends.
        line(image, (x.round(), y), (x.round() + width - 1.0, y), 1.0, color);
    }
}

/// A label with a shade behind it, so that it can be read on bright tissue.
fn write(image: &mut ViewMut<'_>, (x, y): (f64, f64), label: &Label) {
    let wide = letters::width(label.as_str(), LETTERS) as f64;
    fill(image, (x, y + 1.0), (wide, f64::from(LETTERS) - 2.0), SHADE);
    text(image, (x.round() as i64, y.round() as i64), LETTERS, INK, label.as_str());
}

#[cfg(test)]
#[path = "scale_tests.rs"]
mod tests;
