//! Aligned columns for people.
//!
//! Invariant: colour never changes the alignment; widths count characters, not bytes; a cell never holds text
//! that a terminal would obey.

use anstyle::Style;

use super::{out, style};

/// Spaces between two columns.
const GAP: usize = 2;

/// Rows of cells under one heading.
pub(super) struct Table {
    heads: Vec<&'static str>,
    rows: Vec<Vec<(String, Style)>>,
}

impl Table {
    pub(super) fn new(heads: &[&'static str]) -> Self {
        Self { heads: heads.to_vec(), rows: Vec::new() }
    }

    pub(super) fn row<const N: usize>(&mut self, cells: [String; N]) {
        self.styled(cells.map(|c| (c, style::PLAIN)));
    }

    pub(super) fn styled(&mut self, cells: impl IntoIterator<Item = (String, Style)>) {
        let cells = cells.into_iter();
        self.rows.push(cells.map(|(cell, style)| (out::harmless(&cell).into_owned(), style)).collect());
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    fn widths(&self) -> Vec<usize> {
        let width = |column: usize| {
            let cells = self.rows.iter().filter_map(|r| r.get(column)).map(|(c, _)| c.chars().count());
            cells.chain([self.heads[column].chars().count()]).max().unwrap_or(0)
        };
        (0..self.heads.len()).map(width).collect()
    }

    /// Without the last columns that do not fit whole; the first one stays.
    pub(super) fn within(mut self, columns: usize) -> Self {
        let (mut fit, mut end) = (0, 0);
        for width in self.widths() {
            end += width;
            if end > columns && fit > 0 {
                break;
            }
            fit += 1;
            end += GAP;
        }
        self.heads.truncate(fit);
        self.rows.iter_mut().for_each(|row| row.truncate(fit));
        self
    }

    /// The whole table, each line indented by `indent` spaces.
    pub(super) fn render(&self, indent: usize, colour: bool) -> String {
        let widths = self.widths();
        let heads = self.heads.iter().map(|h| ((*h).to_owned(), style::HEAD)).collect();
        let mut text = String::new();
        for row in std::iter::once(&heads).chain(&self.rows) {
            text.extend(std::iter::repeat_n(' ', indent));
            for (i, (cell, paint)) in row.iter().enumerate() {
                text.push_str(&style::paint(cell, *paint, colour));
                if i + 1 < row.len() {
                    let gap = widths[i].saturating_sub(cell.chars().count()) + GAP;
                    text.extend(std::iter::repeat_n(' ', gap));
                }
            }
            text.push('\n');
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_align_with_and_without_colour() {
        let mut table = Table::new(&["NAME", "RATE"]);
        table.row(["µ".to_owned(), "1 kHz".to_owned()]);
        table.styled([("longer".to_owned(), style::GOOD), ("2 Hz".to_owned(), style::PLAIN)]);
        let plain = table.render(2, false);
        assert_eq!(plain, "  NAME    RATE\n  µ       1 kHz\n  longer  2 Hz\n");
        let bare: String = strip(&table.render(2, true));
        assert_eq!(bare, plain, "colour must not move a column");
    }

    #[test]
    fn columns_that_do_not_fit_whole_are_left_out_from_the_last_one_on() {
        let table = || {
            let mut table = Table::new(&["NAME", "RATE", "LOAD"]);
            table.row(["robot".to_owned(), "1 kHz".to_owned(), "3 %".to_owned()]);
            table
        };
        let all = table().render(0, false);
        assert_eq!(table().within(18).render(0, false), all);
        assert_eq!(table().within(17).render(0, false), "NAME   RATE\nrobot  1 kHz\n");
        assert_eq!(table().within(3).render(0, false), "NAME\nrobot\n", "the screen cuts what is left");
    }

    fn strip(text: &str) -> String {
        let mut out = String::new();
        let mut inside = false;
        for c in text.chars() {
            match c {
                '\x1b' => inside = true,
                'm' if inside => inside = false,
                c if !inside => out.push(c),
                _ => {}
            }
        }
        out
    }
}
