//! Letters as dots of ink, for whoever draws text into an image.
//!
//! Invariant: allocates nothing; letters outside of Latin-1 are `?`, and all of one size are equally wide.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, RasterizedChar, get_raster, get_raster_width};

/// Heights of letters there are, px.
pub const SIZES: [u32; 3] = [16, 24, 32];

/// One letter of a line of text.
pub struct Letter {
    /// Column where it begins, px from the begin of the text.
    pub left: usize,
    raster: RasterizedChar,
}

impl Letter {
    /// Its rows from above: the ink of each pixel, 0 (none) to 255.
    pub fn rows(&self) -> impl Iterator<Item = &[u8]> {
        self.raster.rows()
    }
}

/// The letters of a line of text, `size` px high (the nearest of [`SIZES`]).
pub fn letters(text: &str, size: u32) -> impl Iterator<Item = Letter> {
    let height = raster_height(size);
    let raster = move |letter| get_raster(letter, FontWeight::Regular, height);
    let drawn = text.chars().filter_map(move |letter| raster(letter).or_else(|| raster('?')));
    drawn.scan(0, |next, raster| {
        let left = *next;
        *next += raster.width();
        Some(Letter { left, raster })
    })
}

/// Width of a line of text, px, whatever its letters.
pub fn width(text: &str, size: u32) -> usize {
    text.chars().count() * get_raster_width(FontWeight::Regular, raster_height(size))
}

fn raster_height(size: u32) -> RasterHeight {
    match size {
        ..=19 => RasterHeight::Size16,
        20..=27 => RasterHeight::Size24,
        _ => RasterHeight::Size32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stand_side_by_side_and_are_as_wide_as_is_said() {
        for size in SIZES {
            let all: Vec<Letter> = letters("Ag 語", size).collect();
            let each = width("A", size);
            assert_eq!(all.iter().map(|l| l.left).collect::<Vec<_>>(), [0, each, 2 * each, 3 * each]);
            assert_eq!(width("Ag 語", size), 4 * each);
            let question = letters("?", size).next().expect("a letter");
            let ink = |n: usize| all[n].rows().flatten().map(|ink| u32::from(*ink)).sum::<u32>();
            assert!(letters("µ", size).next().is_some_and(|micro| !micro.rows().eq(question.rows())));
            assert!(ink(0) > 0 && ink(2) == 0, "{size}");
            assert!(all[3].rows().eq(question.rows()), "what there is no letter for");
            assert!(
                all.iter().all(|l| l.rows().count() as u32 == size && l.rows().all(|row| row.len() == each))
            );
        }
    }
}
