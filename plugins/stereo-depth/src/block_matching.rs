//! Block matching: sums of absolute differences over a window, by sliding it down and to the right.
//!
//! Invariant: a column's sum is that of the `block` newest rows, so each row enters and leaves once; no sum
//! passes 16 bits. Source: Konolige, "Small vision systems", 1997, with the texture and uniqueness checks
//! that OpenCV made usual.

#[path = "block_matching/plain.rs"]
mod plain;
#[cfg(target_arch = "x86_64")]
#[path = "block_matching/simd.rs"]
mod simd;

use trocar_imaging::simd::Avx2;

use crate::consistency::Consistency;
use crate::disparity::NONE;
use crate::prefilter::CAP;
use crate::rows::{BlockRow, Found, margin};
use crate::settings::Settings;
#[cfg(target_arch = "x86_64")]
use crate::simd::Block;
use crate::simd::sobel_row;

/// Block matching of images of one size; all memory is made at once.
pub(crate) struct BlockMatching {
    settings: Settings,
    lanes: Option<Avx2>,
    width: usize,
    height: usize,
    /// Prefiltered rows of the window and the one that leaves it: left, and right mirrored.
    left: Vec<u8>,
    right: Vec<u8>,
    /// Rows without anything, which leave before the first one does.
    nothing: Vec<u8>,
    columns: Columns,
    /// Contrast of each column of the window, and of each window whether it is enough.
    contrast: Vec<u16>,
    textured: Vec<bool>,
    found: Vec<Found>,
    consistency: Consistency,
}

/// Sums of columns for each disparity.
enum Columns {
    Plain(plain::Columns),
    #[cfg(target_arch = "x86_64")]
    Wide(Avx2, Vec<[Block; 2]>),
}

impl BlockMatching {
    /// For checked settings.
    pub(crate) fn new(settings: Settings, lanes: Option<Avx2>, width: usize, height: usize) -> Self {
        let Settings { n_disp, block, .. } = settings;
        let right = width + margin(n_disp);
        let columns = match lanes {
            #[cfg(target_arch = "x86_64")]
            Some(lanes) => Columns::Wide(lanes, vec![[Block::ZERO; 2]; width * n_disp / 32]),
            _ => Columns::Plain(plain::Columns::new(width, n_disp)),
        };
        BlockMatching {
            settings,
            lanes,
            width,
            height,
            left: vec![0; width * (block + 1)],
            right: vec![0; right * (block + 1)],
            nothing: vec![0; right],
            columns,
            contrast: vec![0; width],
            textured: vec![false; width],
            found: vec![Found::NOTHING; width],
            consistency: Consistency::new(width),
        }
    }

    /// Matches grey images with touching rows; `mirrored` is the right one, mirrored. Disparities are 1/16
    /// px.
    pub(crate) fn run(&mut self, left: &[u8], mirrored: &[u8], disparity: &mut [i16]) {
        let Settings { block, n_disp, uniqueness, consistency, .. } = self.settings;
        let (width, height, radius) = (self.width, self.height, block / 2);
        let right_width = width + margin(n_disp);
        self.reset();
        disparity.fill(NONE);
        for y in 0..height {
            let slot = y % (block + 1);
            let around = |image, flip, to: &mut [u8]| {
                let row = |y: usize| row_of(image, width, y);
                let rows = [row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1))];
                sobel_row(self.lanes, rows, flip, to);
            };
            around(left, false, &mut self.left[slot * width..][..width]);
            around(mirrored, true, &mut self.right[slot * right_width..][..width]);

            let leaving = (y >= block).then(|| (y + 1) % (block + 1));
            let enters = [row_of(&self.left, width, slot), row_of(&self.right, right_width, slot)];
            let leaves = match leaving {
                Some(slot) => [row_of(&self.left, width, slot), row_of(&self.right, right_width, slot)],
                None => [&self.nothing[..width], &self.nothing[..]],
            };
            let full = y + 1 >= block;
            let old = leaving.map(|_| leaves[0]);
            texture(&mut self.contrast, enters[0], old, &self.settings, full, &mut self.textured);
            let textured = if full { &self.textured[..] } else { &[] };
            let row = BlockRow { enters, leaves, textured, block, uniqueness };
            match &mut self.columns {
                Columns::Plain(columns) => columns.row(&row, &mut self.found),
                #[cfg(target_arch = "x86_64")]
                Columns::Wide(lanes, columns) => {
                    simd::row(*lanes, n_disp / 32, columns, &row, &mut self.found);
                }
            }
            if !full {
                continue;
            }
            if consistency >= 0 {
                self.consistency.check(&mut self.found, consistency);
            }
            let to = &mut disparity[(y - radius) * width..][..width];
            to.iter_mut().zip(&self.found).for_each(|(to, found)| *to = found.disparity);
        }
    }

    fn reset(&mut self) {
        match &mut self.columns {
            Columns::Plain(columns) => columns.reset(),
            #[cfg(target_arch = "x86_64")]
            Columns::Wide(_, columns) => columns.fill([Block::ZERO; 2]),
        }
        self.contrast.fill(0);
        // Pixels too near to the side for a window are never written.
        self.found.fill(Found::NOTHING);
    }
}

fn row_of(bytes: &[u8], width: usize, y: usize) -> &[u8] {
    &bytes[y * width..][..width]
}

/// Lets a row enter and one leave the contrast of each column, and says of each full window whether it has
/// enough.
fn texture(
    contrast: &mut [u16],
    enters: &[u8],
    leaves: Option<&[u8]>,
    settings: &Settings,
    full: bool,
    textured: &mut [bool],
) {
    let level = |value: u8| i16::from(value).abs_diff(CAP);
    contrast.iter_mut().zip(enters).for_each(|(sum, &value)| *sum += level(value));
    if let Some(leaves) = leaves {
        contrast.iter_mut().zip(leaves).for_each(|(sum, &value)| *sum -= level(value));
    }
    if !full {
        return;
    }
    let block = settings.block;
    let least = u32::from(settings.texture) * (block * block) as u32 / 100;
    let mut sum: u32 = contrast[..block - 1].iter().map(|&c| u32::from(c)).sum();
    for x in block - 1..contrast.len() {
        sum += u32::from(contrast[x]);
        textured[x - block / 2] = sum >= least;
        sum -= u32::from(contrast[x + 1 - block]);
    }
}
