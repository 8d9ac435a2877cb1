//! The canvas of charts: pixels in memory, with the letters of a bitmap font instead of the system's.
//!
//! Invariant: whatever is drawn, only pixels of the canvas are written.

use std::convert::Infallible;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendTextStyle, DrawingBackend, DrawingErrorKind};

use crate::file::Picture;

type Drawn<T = ()> = Result<T, DrawingErrorKind<Infallible>>;

/// A picture that is drawn on.
pub(crate) struct Canvas<'a>(pub(crate) &'a mut Picture);

impl Canvas<'_> {
    fn put(&mut self, (x, y): BackendCoord, color: BackendColor, ink: f64) {
        let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y)) else { return };
        if x >= self.0.width || y >= self.0.height {
            return;
        }
        let at = 3 * (y as usize * self.0.width as usize + x as usize);
        let Some(pixel) = self.0.rgb.get_mut(at..at + 3) else { return };
        let part = color.alpha * ink;
        let (r, g, b) = color.rgb;
        for (to, over) in pixel.iter_mut().zip([r, g, b]) {
            *to = (f64::from(*to) * (1.0 - part) + f64::from(over) * part + 0.5) as u8;
        }
    }
}

/// The size there is for a wanted one, px.
fn height(size: f64) -> RasterHeight {
    if size < 20.0 { RasterHeight::Size16 } else { RasterHeight::Size24 }
}

/// Width and height of a text, px.
fn extent(text: &str, size: f64) -> (i32, i32) {
    let height = height(size);
    let width = get_raster_width(FontWeight::Regular, height);
    (text.chars().count() as i32 * width as i32, height.val() as i32)
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.0.width, self.0.height)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, at: BackendCoord, color: BackendColor) -> Drawn {
        self.put(at, color, 1.0);
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Drawn {
        let (size, color, turned) = (height(style.size()), style.color(), style.transform());
        let (width, high) = extent(text, style.size());
        let left = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Center => -width / 2,
            HPos::Right => -width,
        };
        let top = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Center => -high / 2,
            VPos::Bottom => -high,
        };
        for (n, letter) in text.chars().enumerate() {
            let raster = |letter| get_raster(letter, FontWeight::Regular, size);
            // The font has Latin-1, and so one of the two letters that are written for micro.
            let letter = if letter == 'μ' { 'µ' } else { letter };
            let Some(glyph) = raster(letter).or_else(|| raster('?')) else { continue };
            for (y, row) in glyph.rows().enumerate() {
                for (x, ink) in row.iter().enumerate().filter(|(_, ink)| **ink > 0) {
                    let along = left + (n * glyph.width() + x) as i32;
                    let (dx, dy) = turned.transform(along, top + y as i32);
                    self.put((at.0 + dx, at.1 + dy), color, f64::from(*ink) / 255.0);
                }
            }
        }
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(&self, text: &str, style: &S) -> Drawn<(u32, u32)> {
        let (width, height) = extent(text, style.size());
        Ok((width.unsigned_abs(), height.unsigned_abs()))
    }
}
