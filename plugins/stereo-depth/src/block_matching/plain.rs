//! Block matching without special instructions: the definition of what the wide one computes.
//!
//! Invariant: `sums` is the sum of the newest `block` columns; disparities that reach beyond the right image
//! are left out.

use crate::rows::{BlockRow, Found, pick};

/// Sums of columns, `n_disp` for each pixel, and those of the window.
pub(crate) struct Columns {
    n_disp: usize,
    columns: Vec<u16>,
    sums: Vec<u16>,
}

impl Columns {
    pub(crate) fn new(width: usize, n_disp: usize) -> Self {
        Columns { n_disp, columns: vec![0; width * n_disp], sums: vec![0; n_disp] }
    }

    pub(crate) fn reset(&mut self) {
        self.columns.fill(0);
    }

    /// Lets a row enter and one leave; fills `to` where windows are full.
    pub(crate) fn row(&mut self, row: &BlockRow<'_>, to: &mut [Found]) {
        let (n_disp, block, width) = (self.n_disp, row.block, row.enters[0].len());
        self.sums.fill(0);
        for x in 0..width {
            let at = width - 1 - x;
            let (before, here) = self.columns.split_at_mut(x * n_disp);
            let column = &mut here[..n_disp];
            let right = |bytes: &'_ [u8], d: usize| bytes[at + d];
            for (d, sum) in column.iter_mut().enumerate() {
                *sum += u16::from(row.enters[0][x].abs_diff(right(row.enters[1], d)));
                *sum -= u16::from(row.leaves[0][x].abs_diff(right(row.leaves[1], d)));
            }
            self.sums.iter_mut().zip(&*column).for_each(|(sum, column)| *sum += column);
            if x >= block {
                let left = &before[(x - block) * n_disp..][..n_disp];
                self.sums.iter_mut().zip(left).for_each(|(sum, column)| *sum -= column);
            }
            if x + 1 < block || row.textured.is_empty() {
                continue;
            }
            let centre = x - block / 2;
            to[centre] = if row.textured[centre] {
                let most = (centre - block / 2).min(n_disp - 1);
                pick(&self.sums[..=most], row.uniqueness)
            } else {
                Found::NOTHING
            };
        }
    }
}
