//! Picture in picture: lays a small image into a big one.
//!
//! Invariant: wherever the inset is asked to go, only pixels of the big image are written, and as much of the
//! inset as fits is visible.

use crate::gray::{convert_row, luma};
use crate::overlay::mix;
use crate::view::{Format, View, ViewMut};

/// Pixels of the big image that an inset covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Returns the place of an inset of `inset` (width, height) pixels that is to start at (`x`, `y`) of a `big`
/// image: moved so that it fits; cut to the big image's size when it is larger.
pub fn place(x: i64, y: i64, inset: (usize, usize), big: (usize, usize)) -> Rect {
    let side = |at: i64, size: usize, room: usize| {
        let size = size.min(room);
        (usize::try_from(at.max(0)).unwrap_or(usize::MAX).min(room - size), size)
    };
    let ((x, width), (y, height)) = (side(x, inset.0, big.0), side(y, inset.1, big.1));
    Rect { x, y, width, height }
}

/// Lays `inset` into `big` with its upper left corner asked to be at (`x`, `y`); formats are converted. Of
/// 255 parts `part` are the inset's, the others those of what is below. Returns the pixels covered.
pub fn lay(inset: &View<'_>, big: &mut ViewMut<'_>, x: i64, y: i64, part: u32) -> Rect {
    let (from, to) = (inset.shape(), big.shape());
    let rect = place(x, y, (from.width, from.height), (to.width, to.height));
    let columns = rect.x * to.format.bytes()..(rect.x + rect.width) * to.format.bytes();
    for n in 0..rect.height {
        let src = &inset.row(n)[..rect.width * from.format.bytes()];
        let dst = &mut big.row_mut(rect.y + n)[columns.clone()];
        if part >= 255 {
            convert_row(from.format, src, to.format, dst);
        } else {
            mix_row(from.format, src, to.format, dst, part);
        }
    }
    rect
}

/// As [`convert_row`], with what is below showing through.
fn mix_row(from: Format, src: &[u8], to: Format, dst: &mut [u8], part: u32) {
    match (from, to) {
        (Format::Rgb8, Format::Gray8) => {
            for (to, from) in dst.iter_mut().zip(src.as_chunks::<3>().0) {
                *to = mix(*to, luma(from[0], from[1], from[2]), part);
            }
        }
        (Format::Gray8, Format::Rgb8) => {
            for (to, &from) in dst.as_chunks_mut::<3>().0.iter_mut().zip(src) {
                *to = to.map(|below| mix(below, from, part));
            }
        }
        (Format::Gray8, Format::Gray8) | (Format::Rgb8, Format::Rgb8) => {
            dst.iter_mut().zip(src).for_each(|(to, &from)| *to = mix(*to, from, part));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Format, Shape};

    fn gray(width: usize, height: usize) -> Shape {
        Shape { width, height, format: Format::Gray8 }
    }

    #[test]
    fn an_inset_that_fits_goes_where_it_was_asked() {
        let mut big = [0; 12];
        let covered = lay(
            &View::packed(gray(2, 2), &[1, 2, 3, 4]).expect("fits"),
            &mut ViewMut::packed(gray(4, 3), &mut big).expect("fits"),
            1,
            1,
            255,
        );
        assert_eq!(big, [0, 0, 0, 0, 0, 1, 2, 0, 0, 3, 4, 0]);
        assert_eq!(covered, Rect { x: 1, y: 1, width: 2, height: 2 });
    }

    #[test]
    fn an_inset_asked_outside_is_moved_to_the_nearest_place_that_fits() {
        let rect = |x, y| place(x, y, (2, 2), (4, 3));
        assert_eq!(rect(-5, -1), Rect { x: 0, y: 0, width: 2, height: 2 });
        assert_eq!(rect(9, 9), Rect { x: 2, y: 1, width: 2, height: 2 });
        assert_eq!(rect(i64::MAX, i64::MIN), Rect { x: 2, y: 0, width: 2, height: 2 });
    }

    #[test]
    fn an_inset_larger_than_the_image_is_cut() {
        let mut big = [0; 2];
        lay(
            &View::packed(gray(3, 2), &[1, 2, 3, 4, 5, 6]).expect("fits"),
            &mut ViewMut::packed(gray(2, 1), &mut big).expect("fits"),
            1,
            1,
            255,
        );
        assert_eq!(big, [1, 2]);
    }

    #[test]
    fn formats_are_converted_on_the_way() {
        let colour = Shape { format: Format::Rgb8, ..gray(2, 1) };
        let mut big = [0; 6];
        lay(
            &View::packed(gray(1, 1), &[50]).expect("fits"),
            &mut ViewMut::packed(colour, &mut big).expect("fits"),
            1,
            0,
            255,
        );
        assert_eq!(big, [0, 0, 0, 50, 50, 50]);
        let mut big = [0; 2];
        lay(
            &View::packed(colour, &[255, 0, 0, 0, 0, 255]).expect("fits"),
            &mut ViewMut::packed(gray(2, 1), &mut big).expect("fits"),
            0,
            0,
            255,
        );
        assert_eq!(big, [77, 29]);
    }

    #[test]
    fn an_inset_that_hides_half_lets_half_of_what_is_below_through() {
        let mut big = [100, 200];
        let half = |inset: &[u8], format, big: &mut [u8], to| {
            let (small, wide) = (Shape { format, ..gray(1, 1) }, Shape { format: to, ..gray(1, 1) });
            lay(
                &View::packed(small, inset).expect("fits"),
                &mut ViewMut::packed(wide, big).expect("fits"),
                0,
                0,
                128,
            );
        };
        half(&[0], Format::Gray8, &mut big[..1], Format::Gray8);
        half(&[255, 255, 255], Format::Rgb8, &mut big[1..], Format::Gray8);
        assert_eq!(big, [50, 228]);
        let mut colour = [0, 100, 200];
        half(&[100], Format::Gray8, &mut colour, Format::Rgb8);
        assert_eq!(colour, [50, 100, 150]);
        half(&[200, 100, 0], Format::Rgb8, &mut colour, Format::Rgb8);
        assert_eq!(colour, [125, 100, 75]);
    }

    #[test]
    fn any_place_and_size_writes_only_the_covered_pixels() {
        let mut rng = fastrand::Rng::with_seed(6);
        for _ in 0..2_000 {
            let (w, h, iw, ih) = (rng.usize(1..9), rng.usize(1..9), rng.usize(1..12), rng.usize(1..12));
            let (x, y) = (rng.i64(-15..15), rng.i64(-15..15));
            let (mut big, inset) = (vec![0; w * h], vec![1; iw * ih]);
            let rect = lay(
                &View::packed(gray(iw, ih), &inset).expect("fits"),
                &mut ViewMut::packed(gray(w, h), &mut big).expect("fits"),
                x,
                y,
                255,
            );
            for (n, &pixel) in big.iter().enumerate() {
                let inside = (rect.x..rect.x + rect.width).contains(&(n % w))
                    && (rect.y..rect.y + rect.height).contains(&(n / w));
                assert_eq!(pixel == 1, inside, "pixel {n} of {w}×{h}, {iw}×{ih} at ({x},{y})");
            }
            assert_eq!((rect.width, rect.height), (iw.min(w), ih.min(h)));
        }
    }
}
