//! Rows that the matchers exchange, and the choice of the best disparity in plain code.
//!
//! Invariant: `pick` is the rule; the wide one in `wide` gives the same for the same sums.

use crate::disparity::{NONE, between_lines};

/// The disparity found for a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Found {
    /// 1/16 px, or [`NONE`].
    pub(crate) disparity: i16,
    /// Cost of the disparity; 0xFFFF where there is none.
    pub(crate) cost: u16,
}

impl Found {
    /// Nothing is known.
    pub(crate) const NOTHING: Found = Found { disparity: NONE, cost: u16::MAX };
}

/// Bytes that a row of a mirrored right image has behind its end, so that every disparity of every pixel can
/// be read.
pub(crate) const fn margin(n_disp: usize) -> usize {
    n_disp + 32
}

/// One row of block matching: the row that enters the windows and the one that leaves them, left image first,
/// the right one mirrored and with a [`margin`].
pub(crate) struct BlockRow<'a> {
    pub(crate) enters: [&'a [u8]; 2],
    pub(crate) leaves: [&'a [u8]; 2],
    /// For each pixel whether its window has texture; empty while the first window is not full.
    pub(crate) textured: &'a [bool],
    pub(crate) block: usize,
    pub(crate) uniqueness: u8,
}

/// One row of semi-global matching: the census planes of both images, the right one mirrored and with a
/// [`margin`].
pub(crate) struct CensusRow<'a> {
    pub(crate) left: [&'a [u8]; 3],
    pub(crate) right: [&'a [u8]; 3],
    pub(crate) p1: u8,
    pub(crate) p2: u8,
    pub(crate) uniqueness: u8,
}

/// Largest cost that is too near to the best one. Above 16 bits nothing is.
pub(crate) fn rival_limit(least: u16, uniqueness: u8) -> u16 {
    let limit = u32::from(least) + u32::from(least) * u32::from(uniqueness) / 100;
    limit.min(u32::from(u16::MAX) - 1) as u16
}

/// The best of `sums`, one for each disparity; the smallest disparity where several are best. Nothing where
/// another one that is no neighbour costs at most `uniqueness` % more (0: not asked).
pub(crate) fn pick(sums: &[u16], uniqueness: u8) -> Found {
    let Some((best, &least)) = sums.iter().enumerate().min_by_key(|(_, sum)| **sum) else {
        return Found::NOTHING;
    };
    if uniqueness > 0 {
        let limit = rival_limit(least, uniqueness);
        if sums.iter().enumerate().any(|(d, &sum)| d.abs_diff(best) > 1 && sum <= limit) {
            return Found::NOTHING;
        }
    }
    let below = best.checked_sub(1).and_then(|d| sums.get(d)).copied();
    found(best, least, below, sums.get(best + 1).copied())
}

/// The best disparity between its neighbours; at an end of the range a missing neighbour is like the other
/// one.
#[inline(always)]
pub(crate) fn found(best: usize, least: u16, below: Option<u16>, above: Option<u16>) -> Found {
    let below_or = below.or(above).unwrap_or(least);
    let above_or = above.or(below).unwrap_or(least);
    let disparity = between_lines(best as i32, i32::from(below_or), i32::from(least), i32::from(above_or));
    Found { disparity, cost: least }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_is_taken_and_rivals_near_it_in_cost_but_not_in_disparity_forbid_it() {
        assert_eq!(pick(&[90, 50, 10, 50, 90], 10), Found { disparity: 32, cost: 10 });
        assert_eq!(pick(&[90, 50, 10, 11, 90], 10).disparity, 40, "a neighbour is no rival");
        assert_eq!(pick(&[11, 50, 10, 50, 90], 10), Found::NOTHING);
        assert_eq!(pick(&[11, 50, 10, 50, 90], 0).disparity, 32);
        assert_eq!(pick(&[12, 50, 10, 50, 90], 10).disparity, 32);
    }

    #[test]
    fn equal_costs_give_the_smaller_disparity_and_ends_have_no_half_steps() {
        assert_eq!(pick(&[5, 9, 9, 5], 0), Found { disparity: 0, cost: 5 });
        assert_eq!(pick(&[9, 7, 5], 0), Found { disparity: 32, cost: 5 });
        assert_eq!(pick(&[7], 10), Found { disparity: 0, cost: 7 });
        assert_eq!(pick(&[], 10), Found::NOTHING);
    }
}
