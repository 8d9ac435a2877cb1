//! The pigment epithelium in the image of a scan: the deepest border that is bright above darker tissue.
//!
//! Invariant: room is made once; a column without such a border takes the row between those beside it.

/// Rows above and below a border that are darker than it.
const BESIDE: usize = 6;
/// By how many grey levels they are at least, the mean of three rows.
const LEAST: u16 = 16;
/// Columns to each side of which half see the epithelium where one does: what lies alone is an error.
const NEIGHBOURS: usize = 3;
/// They differ by so many rows at most, and by so many more from one column to the next: the tip goes back
/// fast where a membrane begins.
const APART: [usize; 2] = [2, 6];
/// Columns to each side whose mean a column takes.
const MEAN: usize = 1;

/// Finds the epithelium, column by column.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    /// The image with its rows and columns exchanged, so that a column lies in one piece.
    columns: Vec<u8>,
    max_rows: usize,
    seen: Vec<Option<u16>>,
    /// Rows that are believed, and straight lines between them.
    between: Vec<f32>,
    rows: Vec<Option<u16>>,
}

impl Layer {
    /// Room for images of `max_columns` times `max_rows` pixels.
    pub(crate) fn new(max_columns: usize, max_rows: usize) -> Layer {
        Layer {
            columns: vec![0; max_columns * max_rows],
            max_rows,
            seen: Vec::with_capacity(max_columns),
            between: Vec::with_capacity(max_columns),
            rows: Vec::with_capacity(max_columns),
        }
    }

    /// The row of the epithelium in each column of an image, which is given row after row; `None` for columns
    /// that are black, and for all when none has it. An image larger than there is room for has no columns.
    pub(crate) fn trace<'a>(
        &mut self,
        width: usize,
        height: usize,
        rows: impl Iterator<Item = &'a [u8]>,
    ) -> &[Option<u16>] {
        self.seen.clear();
        self.rows.clear();
        let fits = width <= self.seen.capacity() && height <= self.max_rows;
        if !fits || width * height > self.columns.len() {
            return &self.rows;
        }
        for (y, row) in rows.take(height).enumerate() {
            row.iter().take(width).enumerate().for_each(|(x, grey)| self.columns[x * height + y] = *grey);
        }
        for x in 0..width {
            let seen = self.see(x, height);
            self.seen.push(seen);
        }
        self.fill();
        for x in 0..width {
            let around = &self.between[x.saturating_sub(MEAN)..(x + MEAN + 1).min(width)];
            let mean = around.iter().sum::<f32>() / around.len() as f32;
            let there = !mean.is_nan() && !self.is_black(x, height);
            self.rows.push(there.then_some((mean + 0.5) as u16));
        }
        &self.rows
    }

    fn column(&self, x: usize, height: usize) -> &[u8] {
        &self.columns[x * height..(x + 1) * height]
    }

    fn is_black(&self, x: usize, height: usize) -> bool {
        self.column(x, height).iter().all(|grey| *grey == 0)
    }

    /// The deepest border of a column.
    fn see(&self, x: usize, height: usize) -> Option<u16> {
        let column = self.column(x, height);
        if height <= 2 * BESIDE + 2 {
            return None;
        }
        let at = |row: usize| column[row - 1..=row + 1].iter().map(|grey| u16::from(*grey)).sum::<u16>();
        let border = |row: &usize| {
            let (row, here) = (*row, at(*row));
            let beside = at(row - BESIDE).max(at(row + BESIDE));
            here >= at(row - 1) && here >= at(row + 1) && here >= beside + 3 * LEAST
        };
        (BESIDE + 1..height - BESIDE - 1).rev().find(border).and_then(|row| u16::try_from(row).ok())
    }

    /// Is what a column saw also what most of those beside it saw?
    fn believed(&self, x: usize) -> Option<u16> {
        let here = self.seen[x]?;
        let (from, to) = (x.saturating_sub(NEIGHBOURS), (x + NEIGHBOURS + 1).min(self.seen.len()));
        let (mut near, mut all) = (0, 0);
        for (column, row) in (from..to).zip(&self.seen[from..to]).filter(|(column, _)| *column != x) {
            let Some(row) = row else { continue };
            all += 1;
            let [apart, slope] = APART;
            near += usize::from(usize::from(row.abs_diff(here)) <= apart + slope * column.abs_diff(x));
        }
        (2 * near >= all).then_some(here)
    }

    /// Goes straight from each column that is believed to the next, and on as it is at both ends; NaN when
    /// none is.
    fn fill(&mut self) {
        self.between.clear();
        let mut last: Option<f32> = None;
        for x in 0..self.seen.len() {
            let Some(row) = self.believed(x).map(f32::from) else { continue };
            let from = last.unwrap_or(row);
            let gap = x - self.between.len() + 1;
            (1..=gap).for_each(|n| self.between.push(from + (row - from) * n as f32 / gap as f32));
            last = Some(row);
        }
        self.between.resize(self.seen.len(), last.unwrap_or(f32::NAN));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEIGHT: usize = 100;

    /// A column with borders at rows, bright above dim tissue.
    fn column(borders: &[usize]) -> [u8; HEIGHT] {
        let mut column = [20; HEIGHT];
        for row in borders {
            column[row - 1..=row + 1].copy_from_slice(&[120, 220, 120]);
        }
        column
    }

    fn trace(columns: &[[u8; HEIGHT]]) -> Vec<Option<u16>> {
        let rows: Vec<Vec<u8>> = (0..HEIGHT).map(|y| columns.iter().map(|c| c[y]).collect()).collect();
        let mut layer = Layer::new(columns.len(), HEIGHT);
        layer.trace(columns.len(), HEIGHT, rows.iter().map(Vec::as_slice)).to_vec()
    }

    #[test]
    fn the_deepest_border_is_found_whatever_lies_above_it() {
        let columns: Vec<_> = (0..40).map(|x| column(&[30 + x / 4, 45, 70])).collect();
        assert_eq!(trace(&columns), [Some(70); 40]);
    }

    #[test]
    fn a_border_that_rises_and_falls_is_followed() {
        let row = |x: usize| 60 + (10.0 * (x as f64 / 12.0).sin()) as usize;
        let columns: Vec<_> = (0..120).map(|x| column(&[30, row(x)])).collect();
        for (x, seen) in trace(&columns).into_iter().enumerate() {
            let off = seen.map(|seen| f64::from(seen) - row(x) as f64);
            assert!(off.is_some_and(|off| off.abs() <= 3.0), "column {x}: {off:?} rows off");
        }
    }

    #[test]
    fn a_border_that_falls_by_six_rows_a_column_is_followed() {
        let row = |x: usize| 45 + (x.clamp(20, 26) - 20) * 6;
        let columns: Vec<_> = (0..50).map(|x| column(&[20, row(x)])).collect();
        for (x, seen) in trace(&columns).into_iter().enumerate() {
            let off = seen.map(|seen| f64::from(seen) - row(x) as f64);
            assert!(off.is_some_and(|off| off.abs() <= 3.0), "column {x}: {off:?} rows off");
        }
    }

    #[test]
    fn a_shadow_takes_the_row_of_what_is_beside_it_and_one_wrong_column_changes_nothing() {
        let mut columns = vec![column(&[30, 70]); 60];
        columns[20..40].fill([20; HEIGHT]);
        columns[50] = column(&[30, 90]);
        assert_eq!(trace(&columns), [Some(70); 60]);
    }

    #[test]
    fn black_columns_have_no_row_and_noise_alone_has_none_either() {
        let mut columns = vec![column(&[70]); 20];
        columns[10..].fill([0; HEIGHT]);
        let seen = trace(&columns);
        assert_eq!((&seen[..10], &seen[10..]), (&[Some(70); 10][..], &[None; 10][..]));
        assert_eq!(trace(&[[20; HEIGHT]; 5]), [None; 5]);
    }

    #[test]
    fn an_image_that_has_no_room_or_no_rows_for_a_border_has_no_layer() {
        let mut layer = Layer::new(2, 10);
        let row = [9; 3];
        assert!(layer.trace(3, 1, [&row[..]].into_iter()).is_empty());
        assert_eq!(layer.trace(2, 1, [&row[..]].into_iter()), [None; 2]);
        assert!(layer.trace(0, 0, std::iter::empty()).is_empty());
        assert!(layer.trace(1, 11, std::iter::empty()).is_empty());
    }
}
