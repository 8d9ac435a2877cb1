//! Leaves out what is dark: outside of a microscope's round field there is nothing to be matched but noise.
//!
//! Invariant: a pixel whose window has a dark pixel has no disparity; nothing is allocated after `new`.

use crate::NONE;

/// Dark pixels near each pixel of a row, counted row by row.
pub(crate) struct Dark {
    /// Dark pixels of each column in the rows of the window.
    columns: Vec<u16>,
}

impl Dark {
    pub(crate) fn new(width: usize) -> Dark {
        Dark { columns: vec![0; width] }
    }

    /// Takes the disparity of each pixel that has one darker than `least` levels within `reach` px, in rows
    /// and columns.
    pub(crate) fn leave_out(&mut self, grey: &[u8], least: u8, reach: usize, disparity: &mut [i16]) {
        let width = self.columns.len();
        let rows: usize = grey.len() / width.max(1);
        let row = |y: usize| &grey[y * width..(y + 1) * width];
        let is_dark = |level: u8| u16::from(level < least);
        self.columns.fill(0);
        for y in 0..reach.min(rows) {
            self.columns.iter_mut().zip(row(y)).for_each(|(count, level)| *count += is_dark(*level));
        }
        for y in 0..rows {
            if y + reach < rows {
                self.columns
                    .iter_mut()
                    .zip(row(y + reach))
                    .for_each(|(count, level)| *count += is_dark(*level));
            }
            if y > reach {
                self.columns
                    .iter_mut()
                    .zip(row(y - reach - 1))
                    .for_each(|(count, level)| *count -= is_dark(*level));
            }
            let found = &mut disparity[y * width..(y + 1) * width];
            let mut near: u32 = self.columns[..reach.min(width)].iter().map(|count| u32::from(*count)).sum();
            for (x, disparity) in found.iter_mut().enumerate() {
                near += self.columns.get(x + reach).map_or(0, |count| u32::from(*count));
                near -= if x > reach { u32::from(self.columns[x - reach - 1]) } else { 0 };
                if near > 0 {
                    *disparity = NONE;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_the_pixels_whose_window_has_a_dark_one_lose_their_disparity() {
        let mut rng = fastrand::Rng::with_seed(3);
        for (width, height, reach) in [(40, 30, 7), (33, 5, 4), (9, 50, 15), (32, 32, 0)] {
            let grey: Vec<u8> =
                (0..width * height).map(|_| if rng.u32(0..150) == 0 { 9 } else { 10 }).collect();
            let mut found = vec![16; width * height];
            Dark::new(width).leave_out(&grey, 10, reach, &mut found);
            for (at, disparity) in found.iter().enumerate() {
                let (x, y) = (at % width, at / width);
                let near = (y.saturating_sub(reach)..(y + reach + 1).min(height)).any(|y| {
                    (x.saturating_sub(reach)..(x + reach + 1).min(width)).any(|x| grey[y * width + x] < 10)
                });
                assert_eq!(
                    *disparity,
                    if near { NONE } else { 16 },
                    "at {x}, {y} of {width} × {height}, reach {reach}"
                );
            }
        }
    }

    #[test]
    fn nothing_is_dark_at_zero() {
        let mut found = vec![16; 64];
        Dark::new(8).leave_out(&[0; 64], 0, 3, &mut found);
        assert_eq!(found, [16; 64]);
    }
}
