//! The mark of a stale picture: a red frame around each image, and how old it is.
//!
//! Invariant: only pixels of the picture are written, however small it is.

use std::ops::Range;

use trocar_imaging::letters::{SIZES, letters, width};

use crate::freshness::Stale;

const RED: [u8; 3] = [255, 0, 0];
const WHITE: [u8; 3] = [255; 3];

/// Marks `images` images of one size that stand side by side in `rgb`, rows touching, `wide` × `high` px
/// together.
pub(crate) fn draw(rgb: &mut [u8], (wide, high): (usize, usize), images: usize, stale: Stale) {
    let each = wide / images.max(1);
    let border = (each.min(high) / 48).clamp(1, 16);
    let text = format!("no picture for {:.1} s", stale.age_s);
    let fits =
        |size: &&u32| width(&text, **size) + 4 * border <= each && **size as usize + 4 * border <= high;
    let size = SIZES.iter().rev().find(fits).copied();
    let mut paint = Paint { rgb, wide };
    for left in (0..images).map(|n| n * each) {
        let right = left + each;
        paint.fill(left..right, 0..border.min(high), RED);
        paint.fill(left..right, high.saturating_sub(border)..high, RED);
        paint.fill(left..(left + border).min(right), 0..high, RED);
        paint.fill(right.saturating_sub(border)..right, 0..high, RED);
        // An image too small for letters has its frame.
        let Some(size) = size else { continue };
        let (x, y) = (left + border, border);
        paint.fill(x..x + width(&text, size) + 2 * border, y..y + size as usize + 2 * border, RED);
        for letter in letters(&text, size) {
            for (row, inks) in letter.rows().enumerate() {
                for (column, ink) in inks.iter().enumerate() {
                    paint.cover(x + border + letter.left + column, y + border + row, *ink);
                }
            }
        }
    }
}

struct Paint<'a> {
    rgb: &'a mut [u8],
    wide: usize,
}

impl Paint<'_> {
    fn fill(&mut self, columns: Range<usize>, rows: Range<usize>, color: [u8; 3]) {
        for y in rows {
            let row =
                self.rgb.get_mut(3 * (y * self.wide + columns.start)..3 * (y * self.wide + columns.end));
            row.into_iter().flat_map(|row| row.as_chunks_mut::<3>().0).for_each(|pixel| *pixel = color);
        }
    }

    /// Lets white cover a pixel, `ink` of 255 parts.
    fn cover(&mut self, x: usize, y: usize, ink: u8) {
        let Some(pixel) =
            self.rgb.get_mut(3 * (y * self.wide + x)..).and_then(|rest| rest.first_chunk_mut::<3>())
        else {
            return;
        };
        for (level, white) in pixel.iter_mut().zip(WHITE) {
            *level =
                ((u32::from(*level) * u32::from(255 - ink) + u32::from(white) * u32::from(ink)) / 255) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marked(wide: usize, high: usize, images: usize) -> Vec<[u8; 3]> {
        let mut rgb = vec![9; 3 * wide * high];
        draw(&mut rgb, (wide, high), images, Stale { age_s: 1.26 });
        rgb.as_chunks::<3>().0.to_vec()
    }

    #[test]
    fn each_image_has_a_frame_and_the_text_and_keeps_its_middle() {
        let pixels = marked(800, 300, 2);
        for left in [0, 400] {
            for (x, y) in [(0, 0), (399, 0), (0, 299), (399, 299), (200, 1), (1, 150), (398, 150), (200, 298)]
            {
                assert_eq!(pixels[800 * y + left + x], RED, "({x}, {y}) of the image at {left}");
            }
            assert_eq!(pixels[800 * 150 + left + 200], [9; 3]);
            let white = (0..60).flat_map(|y| (0..400).map(move |x| (x, y)));
            let white = white.filter(|(x, y)| pixels[800 * y + left + x] == WHITE).count();
            assert!(white > 200, "{white} white pixels of text at {left}");
        }
    }

    #[test]
    fn a_picture_without_room_for_letters_has_its_frame() {
        for (wide, high, images) in [(1, 1, 1), (2, 1, 2), (5, 3, 1), (16, 16, 1), (300, 2, 2), (1, 0, 1)] {
            let pixels = marked(wide, high, images);
            assert!(pixels.first().is_none_or(|pixel| *pixel == RED), "{wide} × {high}");
        }
        assert_eq!(marked(16, 16, 1)[16 * 8 + 8], [9; 3]);
    }
}
