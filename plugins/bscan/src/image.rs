//! Images of A-scans: one that grows along a line, and one that rolls with time.
//!
//! Invariant: room is made once; a column is the mean of the A-scans that fell into it, and one without any
//! stays black.

use crate::ascans::{AScan, Grey};

/// Sum of the A-scans of a column.
#[derive(Clone, Debug, Default)]
struct Column {
    sum: Vec<f32>,
    lines: u32,
}

impl Column {
    fn new(rows: usize) -> Column {
        Column { sum: vec![0.0; rows], lines: 0 }
    }

    fn add(&mut self, ascan: AScan<'_>) {
        match ascan {
            AScan::Bytes(bytes) => {
                self.sum.iter_mut().zip(bytes).for_each(|(sum, grey)| *sum += f32::from(*grey));
            }
            AScan::Decibels(bytes, Grey { low_db, high_db }) => {
                let scale = 255.0 / (high_db - low_db);
                for (sum, db) in self.sum.iter_mut().zip(bytes.as_chunks::<4>().0) {
                    *sum += ((f32::from_ne_bytes(*db) - low_db) * scale).clamp(0.0, 255.0);
                }
            }
        }
        self.lines += 1;
    }

    fn clear(&mut self) {
        self.sum.fill(0.0);
        self.lines = 0;
    }

    /// Writes the mean into one column of an image, and begins anew.
    fn flush(&mut self, pixels: &mut [u8], width: usize, column: usize) -> u32 {
        let share = 1.0 / self.lines.max(1) as f32;
        for (sum, row) in self.sum.iter_mut().zip(pixels.chunks_exact_mut(width)) {
            row[column] = (*sum * share + 0.5) as u8;
            *sum = 0.0;
        }
        std::mem::take(&mut self.lines)
    }
}

/// An image along a line.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    pixels: Vec<u8>,
    rows: usize,
    width: usize,
    column: Column,
    /// The column that grows.
    current: Option<usize>,
    filled: usize,
}

impl Scan {
    /// Room for `max_columns` times `rows` pixels.
    pub fn new(max_columns: usize, rows: usize) -> Scan {
        Scan { pixels: vec![0; max_columns * rows], rows, column: Column::new(rows), ..Scan::default() }
    }

    /// Begins a black image of `width` columns, at most as many as there is room for.
    pub fn begin(&mut self, width: usize) {
        self.width = width.min(self.pixels.len() / self.rows.max(1));
        self.pixels[..self.width * self.rows].fill(0);
        self.column.clear();
        (self.current, self.filled) = (None, 0);
    }

    /// Adds an A-scan to `column`; one that lies behind the column that grows, or outside of the image, is
    /// left out. Returns the column that was ended by it, and the number of its A-scans.
    pub fn add(&mut self, column: usize, ascan: AScan<'_>) -> Option<(usize, u32)> {
        if column >= self.width || self.current.is_some_and(|current| column < current) {
            return None;
        }
        let ended = if self.current == Some(column) { None } else { self.end() };
        self.current = Some(column);
        self.column.add(ascan);
        ended
    }

    /// Ends the column that grows.
    pub fn end(&mut self) -> Option<(usize, u32)> {
        let column = self.current.take()?;
        let width = self.width;
        let lines = self.column.flush(&mut self.pixels[..width * self.rows], width, column);
        self.filled += 1;
        Some((column, lines))
    }

    /// A-scans of the column that grows.
    pub fn lines(&self) -> u32 {
        self.column.lines
    }

    /// Columns with A-scans in them.
    pub fn filled(&self) -> usize {
        self.filled
    }

    pub fn width(&self) -> usize {
        self.width
    }

    /// Row after row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels[..self.width * self.rows]
    }
}

/// An image whose columns are the last moments, the newest at the right.
#[derive(Clone, Debug, Default)]
pub struct Rolling {
    pixels: Vec<u8>,
    width: usize,
    column: Column,
    next: usize,
    each: u32,
}

impl Rolling {
    /// `width` columns of `each` A-scans.
    pub fn new(width: usize, rows: usize, each: u32) -> Rolling {
        let column = Column::new(rows);
        Rolling { pixels: vec![0; width * rows], width, column, next: 0, each: each.max(1) }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.pixels.fill(0);
        self.column.clear();
        self.next = 0;
    }

    /// Adds an A-scan; gives of how many A-scans the column is that was ended by it.
    pub fn add(&mut self, ascan: AScan<'_>) -> Option<u32> {
        self.column.add(ascan);
        if self.column.lines < self.each {
            return None;
        }
        let lines = self.column.flush(&mut self.pixels, self.width, self.next);
        self.next = (self.next + 1) % self.width;
        Some(lines)
    }

    /// A-scans of the column that grows.
    pub fn lines(&self) -> u32 {
        self.column.lines
    }

    /// The image from its oldest column to its newest, row after row, into `to`.
    pub fn write(&self, to: &mut [u8]) {
        for (from, to) in self.pixels.chunks_exact(self.width).zip(to.chunks_exact_mut(self.width)) {
            let (newer, older) = from.split_at(self.next);
            let (left, right) = to.split_at_mut(older.len());
            left.copy_from_slice(older);
            right.copy_from_slice(newer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_is_the_mean_of_its_a_scans_and_one_without_any_is_black() {
        let mut scan = Scan::new(10, 2);
        scan.begin(4);
        assert_eq!(scan.add(0, AScan::Bytes(&[10, 0])), None);
        assert_eq!(scan.add(0, AScan::Bytes(&[20, 1])), None);
        assert_eq!(scan.add(2, AScan::Bytes(&[30, 40])), Some((0, 2)));
        assert_eq!(scan.add(1, AScan::Bytes(&[99, 99])), None, "behind the one that grows");
        assert_eq!(scan.add(4, AScan::Bytes(&[99, 99])), None, "outside");
        assert_eq!((scan.end(), scan.end()), (Some((2, 1)), None));
        assert_eq!((scan.pixels(), scan.filled()), (&[15, 0, 30, 0, 1, 0, 40, 0][..], 2));
        scan.begin(2);
        assert_eq!(scan.pixels(), [0; 4]);
    }

    #[test]
    fn decibels_become_grey_within_their_range_and_short_a_scans_leave_the_rest_black() {
        let mut scan = Scan::new(1, 4);
        scan.begin(1);
        let bytes: Vec<u8> = [40.0f32, 70.0, 200.0].iter().flat_map(|db| db.to_ne_bytes()).collect();
        scan.add(0, AScan::Decibels(&bytes, Grey { low_db: 50.0, high_db: 90.0 }));
        scan.end();
        assert_eq!(scan.pixels(), [0, 128, 255, 0]);
    }

    #[test]
    fn the_rolling_image_ends_with_the_newest_column() {
        let mut rolling = Rolling::new(3, 1, 2);
        let mut image = [0; 3];
        for n in 0..10u8 {
            rolling.add(AScan::Bytes(&[n]));
        }
        rolling.write(&mut image);
        assert_eq!(image, [5, 7, 9]);
    }
}
