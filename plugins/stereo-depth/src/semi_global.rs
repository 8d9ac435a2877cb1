//! Semi-global matching: census costs, added up along five paths with penalties for steps of the disparity.
//!
//! Invariant: a cost along a path is at most 24 + `p2`, which fits seven bits; rows are worked on once, from
//! the top. Source: Hirschmüller, "Stereo processing by semiglobal matching and mutual information", PAMI
//! 2008. The paths are from the left, the right, above and both diagonals above: those that one pass down the
//! image has.

#[path = "semi_global/plain.rs"]
mod plain;
#[cfg(target_arch = "x86_64")]
#[path = "semi_global/simd.rs"]
mod simd;

use trocar_imaging::simd::Avx2;

use crate::census::REACH;
use crate::consistency::Consistency;
use crate::rows::{CensusRow, Found, margin};
use crate::settings::Settings;
use crate::simd::census_row;

/// Semi-global matching of images of one size; all memory is made at once.
pub(crate) struct SemiGlobal {
    settings: Settings,
    lanes: Option<Avx2>,
    width: usize,
    height: usize,
    /// Five rows of both images, longer to both sides by [`REACH`].
    left: Vec<u8>,
    right: Vec<u8>,
    left_census: [Vec<u8>; 3],
    right_census: [Vec<u8>; 3],
    paths: Paths,
    found: Vec<Found>,
    consistency: Consistency,
}

/// Costs along the paths.
enum Paths {
    Plain(plain::Plain),
    #[cfg(target_arch = "x86_64")]
    Wide(Avx2, simd::Wide),
}

impl SemiGlobal {
    /// For checked settings.
    pub(crate) fn new(settings: Settings, lanes: Option<Avx2>, width: usize, height: usize) -> Self {
        let n_disp = settings.n_disp;
        let paths = match lanes {
            #[cfg(target_arch = "x86_64")]
            Some(lanes) => Paths::Wide(lanes, simd::Wide::new(width, n_disp / 32)),
            _ => Paths::Plain(plain::Plain::new(width, n_disp)),
        };
        let rows = || vec![0; (width + 2 * REACH) * ROWS];
        SemiGlobal {
            settings,
            lanes,
            width,
            height,
            left: rows(),
            right: rows(),
            left_census: core::array::from_fn(|_| vec![0; width]),
            right_census: core::array::from_fn(|_| vec![0; width + margin(n_disp)]),
            paths,
            found: vec![Found::NOTHING; width],
            consistency: Consistency::new(width),
        }
    }

    /// Matches grey images with touching rows; `mirrored` is the right one, mirrored. Disparities are 1/16
    /// px.
    pub(crate) fn run(&mut self, left: &[u8], mirrored: &[u8], disparity: &mut [i16]) {
        let Settings { p1, p2, uniqueness, consistency, n_disp, .. } = self.settings;
        let (width, height) = (self.width, self.height);
        match &mut self.paths {
            Paths::Plain(paths) => paths.reset(),
            #[cfg(target_arch = "x86_64")]
            Paths::Wide(_, paths) => paths.reset(),
        }
        for y in 0..REACH.min(height) {
            widen(&left[y * width..][..width], slot_mut(&mut self.left, width, y));
            widen(&mirrored[y * width..][..width], slot_mut(&mut self.right, width, y));
        }
        for y in 0..height {
            if let Some(below) = Some(y + REACH).filter(|&below| below < height) {
                widen(&left[below * width..][..width], slot_mut(&mut self.left, width, below));
                widen(&mirrored[below * width..][..width], slot_mut(&mut self.right, width, below));
            }
            let around = |image| {
                core::array::from_fn(|dy| slot(image, width, (y + dy).saturating_sub(REACH).min(height - 1)))
            };
            let [a, b, c] = &mut self.left_census;
            census_row(self.lanes, around(&self.left), false, [a, b, c]);
            let [a, b, c] = &mut self.right_census;
            let planes = [&mut a[..width], &mut b[..width], &mut c[..width]];
            census_row(self.lanes, around(&self.right), true, planes);
            // Beyond its end the image goes on like its last pixel, so that no disparity is preferred there.
            planes_end(&mut self.right_census, width);
            let [left, right] = [&self.left_census, &self.right_census].map(|p| [&p[0][..], &p[1], &p[2]]);
            let row = CensusRow { left, right, p1, p2, uniqueness };
            match &mut self.paths {
                Paths::Plain(paths) => paths.row(&row, &mut self.found),
                #[cfg(target_arch = "x86_64")]
                Paths::Wide(lanes, paths) => {
                    simd::row(*lanes, n_disp / 32, paths, &row, &mut self.found);
                }
            }
            if consistency >= 0 {
                self.consistency.check(&mut self.found, consistency);
            }
            let to = &mut disparity[y * width..][..width];
            to.iter_mut().zip(&self.found).for_each(|(to, found)| *to = found.disparity);
        }
    }
}

/// Rows that a census reaches over.
const ROWS: usize = 2 * REACH + 1;

fn slot(rows: &[u8], width: usize, y: usize) -> &[u8] {
    &rows[(y % ROWS) * (width + 2 * REACH)..][..width + 2 * REACH]
}

fn slot_mut(rows: &mut [u8], width: usize, y: usize) -> &mut [u8] {
    &mut rows[(y % ROWS) * (width + 2 * REACH)..][..width + 2 * REACH]
}

fn planes_end(planes: &mut [Vec<u8>; 3], width: usize) {
    for plane in planes {
        let last = plane[width - 1];
        plane[width..].fill(last);
    }
}

/// A row with its ends repeated.
fn widen(row: &[u8], to: &mut [u8]) {
    let end = REACH + row.len();
    to[..REACH].fill(row[0]);
    to[REACH..end].copy_from_slice(row);
    to[end..].fill(row[row.len() - 1]);
}
