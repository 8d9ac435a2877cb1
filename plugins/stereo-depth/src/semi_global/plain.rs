//! Semi-global matching without special instructions: the definition of what the wide one computes.
//!
//! Invariant: a path that enters the image begins with the costs alone: before it there are zeros.

use crate::rows::{CensusRow, Found, pick};

/// Costs along the three paths from above, of the row above and of this one, with a pixel of zeros at both
/// ends.
pub(crate) struct Plain {
    n_disp: usize,
    above: [Vec<u8>; 3],
    here: [Vec<u8>; 3],
    costs: Vec<u8>,
    sums: Vec<u16>,
    /// Costs of the path along the row: before, and here.
    along: [Vec<u8>; 2],
}

impl Plain {
    pub(crate) fn new(width: usize, n_disp: usize) -> Self {
        let path = || vec![0; (width + 2) * n_disp];
        Plain {
            n_disp,
            above: core::array::from_fn(|_| path()),
            here: core::array::from_fn(|_| path()),
            costs: vec![0; width * n_disp],
            sums: vec![0; width * n_disp],
            along: core::array::from_fn(|_| vec![0; n_disp]),
        }
    }

    pub(crate) fn reset(&mut self) {
        self.above.iter_mut().for_each(|path| path.fill(0));
    }

    /// Works on one row.
    pub(crate) fn row(&mut self, row: &CensusRow<'_>, to: &mut [Found]) {
        let (n_disp, width) = (self.n_disp, to.len());
        let of = |x: usize| x * n_disp..(x + 1) * n_disp;
        let [before, along] = &mut self.along;
        before.fill(0);
        for x in 0..width {
            let costs = &mut self.costs[of(x)];
            for (d, cost) in costs.iter_mut().enumerate() {
                let at = width - 1 - x + d;
                let differ = |plane: usize| (row.left[plane][x] ^ row.right[plane][at]).count_ones();
                *cost = (differ(0) + differ(1) + differ(2)) as u8;
            }
            let sums = &mut self.sums[of(x)];
            sums.fill(0);
            step(before, costs, row, along, sums);
            core::mem::swap(before, along);
            // From the left above, straight above, the right above: columns are one further on for the zeros.
            for (path, from) in [x, x + 1, x + 2].into_iter().enumerate() {
                step(&self.above[path][of(from)], costs, row, &mut self.here[path][of(x + 1)], sums);
            }
        }
        before.fill(0);
        for x in (0..width).rev() {
            step(before, &self.costs[of(x)], row, along, &mut self.sums[of(x)]);
            core::mem::swap(before, along);
            to[x] = pick(&self.sums[of(x)][..=x.min(n_disp - 1)], row.uniqueness);
        }
        core::mem::swap(&mut self.above, &mut self.here);
    }
}

/// One step of a path: equation 13 of the paper. Adds what comes out to `sums`.
fn step(before: &[u8], costs: &[u8], row: &CensusRow<'_>, to: &mut [u8], sums: &mut [u16]) {
    let least = before.iter().copied().min().unwrap_or(0);
    let far = least + row.p2;
    for d in 0..costs.len() {
        let below = if d > 0 { before[d - 1] } else { u8::MAX };
        let above = before.get(d + 1).copied().unwrap_or(u8::MAX);
        let near = below.min(above).saturating_add(row.p1);
        to[d] = costs[d] + (before[d].min(near).min(far) - least);
        sums[d] += u16::from(to[d]);
    }
}
