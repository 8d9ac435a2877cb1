//! Left and right must agree: of pixels that claim the same partner only the cheapest is believed.
//!
//! Invariant: disparities are only taken away, never changed. The rule is that of OpenCV's
//! `validateDisparity`.

use crate::disparity::{NONE, SCALE};
use crate::rows::Found;

/// Compares the two directions of one row.
#[derive(Clone, Debug)]
pub(crate) struct Consistency {
    /// For each pixel of the right image the cheapest one of the left that claims it.
    right: Vec<Found>,
}

impl Consistency {
    pub(crate) fn new(width: usize) -> Self {
        Consistency { right: vec![Found::NOTHING; width] }
    }

    /// Takes away what differs by more than `limit_px` from what its partner says.
    pub(crate) fn check(&mut self, row: &mut [Found], limit_px: i16) {
        self.right.fill(Found::NOTHING);
        for (x, pixel) in row.iter().enumerate() {
            if pixel.disparity < 0 {
                continue;
            }
            let whole = (pixel.disparity + SCALE / 2) / SCALE;
            let Some(partner) = x.checked_sub(whole as usize).and_then(|at| self.right.get_mut(at)) else {
                continue;
            };
            if pixel.cost < partner.cost {
                *partner = Found { disparity: whole, cost: pixel.cost };
            }
        }
        for (x, pixel) in row.iter_mut().enumerate() {
            if pixel.disparity < 0 {
                continue;
            }
            // Both whole disparities beside it must be denied: between them lies a slanted surface's own.
            let denied = |whole: i16| {
                let partner = x.checked_sub(whole as usize).and_then(|at| self.right.get(at));
                partner.is_some_and(|p| p.disparity != NONE && (p.disparity - whole).abs() > limit_px)
            };
            if denied(pixel.disparity / SCALE) && denied((pixel.disparity + SCALE - 1) / SCALE) {
                *pixel = Found::NOTHING;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(disparities: &[(i16, u16)], limit_px: i16) -> Vec<i16> {
        let mut row: Vec<Found> = disparities
            .iter()
            .map(|&(d, cost)| Found { disparity: if d < 0 { NONE } else { d * SCALE }, cost })
            .collect();
        Consistency::new(row.len()).check(&mut row, limit_px);
        row.iter().map(|f| if f.disparity == NONE { -1 } else { f.disparity / SCALE }).collect()
    }

    #[test]
    fn of_two_pixels_with_one_partner_the_cheaper_one_stays() {
        // Pixels 3 and 5 both claim pixel 2 of the right image.
        assert_eq!(
            checked(&[(-1, 0), (-1, 0), (-1, 0), (1, 9), (-1, 0), (3, 5)], 1),
            [-1, -1, -1, -1, -1, 3]
        );
        assert_eq!(
            checked(&[(-1, 0), (-1, 0), (-1, 0), (1, 4), (-1, 0), (3, 5)], 1),
            [-1, -1, -1, 1, -1, -1]
        );
        assert_eq!(checked(&[(-1, 0), (-1, 0), (-1, 0), (1, 4), (-1, 0), (3, 5)], 2), [-1, -1, -1, 1, -1, 3]);
    }

    #[test]
    fn a_partner_beyond_the_image_denies_nothing() {
        assert_eq!(checked(&[(5, 1), (0, 2)], 1), [5, 0]);
    }
}
