//! The colours of a sensor with one value per pixel behind a filter of rows R G R G … and G B G B ….
//!
//! Invariant: bilinear: a missing colour is the mean of its two or four nearest, rounded half up; outside of
//! the image lies its mirror image, which keeps the pattern.

use crate::simd::{self, Avx2};

/// Fills a row of RGB pixels. `rows` are the one above, the row itself and the one below; `odd` when it is
/// one of the G B rows. All three have at least two pixels, and `dst` as many.
pub fn row(rows: [&[u8]; 3], odd: bool, dst: &mut [u8]) {
    row_with(Avx2::detect(), rows, odd, dst);
}

fn row_with(lanes: Option<Avx2>, rows: [&[u8]; 3], odd: bool, dst: &mut [u8]) {
    let width = rows[1].len();
    let pixels = dst.as_chunks_mut::<3>().0;
    if width < 2 || pixels.len() < width || rows.iter().any(|row| row.len() < width) {
        return;
    }
    // Left of the first pixel lies the second one, right of the last one the last but one.
    pixels[0] = pixel(rows, [1, 0, 1], true, odd);
    let end = width - 1;
    pixels[end] = pixel(rows, [end - 1, end, end - 1], end.is_multiple_of(2), odd);
    let done = match lanes {
        Some(lanes) if end > 2 => {
            simd::debayer(lanes, rows.map(|row| &row[..width]), odd, &mut pixels[2..end])
        }
        _ => 0,
    };
    for x in (1..end).take(1).chain(2 + done..end) {
        pixels[x] = pixel(rows, [x - 1, x, x + 1], x.is_multiple_of(2), odd);
    }
}

/// One pixel: `x` are the columns left of it, its own, right of it; `even` when its own is.
#[inline(always)]
fn pixel(rows: [&[u8]; 3], [l, x, r]: [usize; 3], even: bool, odd: bool) -> [u8; 3] {
    let at = |row: usize, x: usize| u16::from(rows[row][x]);
    let own = rows[1][x];
    let mean2 = |a: u16, b: u16| ((a + b + 1) >> 1) as u8;
    let mean4 = |a: u16, b: u16, c: u16, d: u16| ((a + b + c + d + 2) >> 2) as u8;
    let sides = || mean2(at(1, l), at(1, r));
    let ends = || mean2(at(0, x), at(2, x));
    let cross = || mean4(at(0, x), at(1, l), at(1, r), at(2, x));
    let corners = || mean4(at(0, l), at(0, r), at(2, l), at(2, r));
    match (odd, even) {
        (false, true) => [own, cross(), corners()],
        (false, false) => [sides(), own, ends()],
        (true, true) => [ends(), own, sides()],
        (true, false) => [corners(), cross(), own],
    }
}

/// Rows above and below `y`, and itself, in an image of `height` rows, mirrored at its ends.
pub fn neighbours(height: usize, y: usize) -> [usize; 3] {
    let last = height.saturating_sub(1);
    let above = if y == 0 { 1.min(last) } else { y - 1 };
    let below = if y >= last { last.saturating_sub(1) } else { y + 1 };
    [above, y, below]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The image's colours, all rows.
    fn debayered(width: usize, height: usize, src: &[u8]) -> Vec<u8> {
        let mut out = vec![9; 3 * src.len()];
        for (y, to) in out.chunks_mut(3 * width).enumerate() {
            row(neighbours(height, y).map(|y| &src[y * width..][..width]), y % 2 == 1, to);
        }
        out
    }

    /// A picture as a sensor behind a colour filter sees it.
    fn mosaic(width: usize, height: usize, picture: impl Fn(usize, usize) -> [u8; 3]) -> Vec<u8> {
        let channel = |x: usize, y: usize| match (y % 2, x % 2) {
            (0, 0) => 0,
            (1, 1) => 2,
            _ => 1,
        };
        (0..width * height).map(|n| picture(n % width, n / width)[channel(n % width, n / width)]).collect()
    }

    #[test]
    fn a_picture_of_one_colour_comes_back_at_every_size() {
        for (width, height) in [(2, 2), (3, 3), (4, 5), (5, 4), (8, 2), (9, 7)] {
            let out = debayered(width, height, &mosaic(width, height, |_, _| [200, 100, 50]));
            assert!(out.chunks(3).all(|p| p == [200, 100, 50]), "{width}×{height}: {out:?}");
        }
    }

    #[test]
    fn a_slope_comes_back_inside_of_the_rim() {
        let picture = |x: usize, y: usize| [(4 * x + 2 * y) as u8, (3 * x + y) as u8, (2 * x + 6 * y) as u8];
        let out = debayered(12, 9, &mosaic(12, 9, picture));
        for y in 1..8 {
            for x in 1..11 {
                assert_eq!(out[3 * (12 * y + x)..][..3], picture(x, y), "({x}, {y})");
            }
        }
    }

    #[test]
    fn rows_are_the_same_with_and_without_wide_instructions_at_every_length() {
        let mut rng = fastrand::Rng::with_seed(4);
        for width in (2..80).chain([641]) {
            let level = |rng: &mut fastrand::Rng| if rng.bool() { 255 } else { rng.u8(..) };
            let sensor: Vec<u8> = std::iter::repeat_with(|| level(&mut rng)).take(3 * width).collect();
            let rows = [0, 1, 2].map(|y| &sensor[y * width..][..width]);
            for odd in [false, true] {
                let (mut wide, mut plain) = (vec![1; 3 * width], vec![2; 3 * width]);
                row_with(Avx2::detect(), rows, odd, &mut wide);
                row_with(None, rows, odd, &mut plain);
                assert_eq!(wide, plain, "{width} pixels");
            }
        }
    }

    #[test]
    fn missing_colours_are_means_of_the_nearest_rounded_half_up() {
        #[rustfmt::skip]
        let sensor = [
            10, 20, 31,
            40, 50, 60,
            70, 81, 90,
        ];
        let out = debayered(3, 3, &sensor);
        // The middle is blue: red from the corners, green from the cross.
        assert_eq!(out[12..15], [50, 50, 50]);
        // Above it: green, red from the sides (10, 31), blue from below and its mirror.
        assert_eq!(out[3..6], [21, 20, 50]);
    }
}
