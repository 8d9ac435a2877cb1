//! Light that the tool's shadow takes from each pixel of a picture.
//!
//! Invariant: reckoned at the corners of small squares and mixed between them, since the edge of a shadow is
//! many pixels soft; the corners' places are the same whatever part of a picture is drawn. Nothing is
//! allocated after `new`.

use crate::scenery::Scenery;
use crate::shadow;
use crate::spans::Spans;

/// Sides of the squares, in parts of the tool's radius.
const SIDE: f64 = 0.14;
/// The longest side, px.
const LONGEST: usize = 8;
/// Red, green and blue light that the middle of a shadow takes away: tissue scatters red light into it.
const TAKEN: [f32; 3] = [0.56, 0.68, 0.70];
/// All light, in the rows.
const WHOLE: f32 = 32768.0;

/// Corners above and below the row that is drawn.
pub(crate) struct Shade {
    /// Light that is taken from red, green and blue of each column, of [`WHOLE`].
    above: Vec<i16>,
    below: Vec<i16>,
    /// The squares' side, px.
    side: usize,
    /// Row of squares that `above` and `below` belong to.
    squares: Option<usize>,
}

impl Shade {
    pub(crate) fn new(width: usize) -> Shade {
        Shade { above: vec![0; 3 * width], below: vec![0; 3 * width], side: 1, squares: None }
    }

    /// Forgets the last picture.
    pub(crate) fn begin(&mut self, scenery: &Scenery<'_>) {
        self.side = scenery.pixels_of_radius(SIDE).min(LONGEST);
        self.squares = None;
    }

    /// Takes the light from `columns` of row `y`: three values of `row` each. `spans` say where the picture
    /// has shadow, `at_rest` which column of the picture at rest is nearest to each column's place.
    pub(crate) fn darken(
        &mut self,
        scenery: &Scenery<'_>,
        spans: &Spans,
        at_rest: &[usize],
        row: &mut [i16],
        y: usize,
    ) {
        let columns = spans.of(y);
        if columns.is_empty() {
            return;
        }
        let squares = y / self.side;
        if self.squares != Some(squares) {
            if squares > 0 && self.squares == Some(squares - 1) {
                std::mem::swap(&mut self.above, &mut self.below);
            } else {
                self.corners(scenery, spans, at_rest, squares);
                std::mem::swap(&mut self.above, &mut self.below);
            }
            self.corners(scenery, spans, at_rest, squares + 1);
            self.squares = Some(squares);
        }
        let down = ((y % self.side) as f32 / self.side as f32 * WHOLE) as i16;
        let columns = 3 * columns.start..3 * columns.end;
        let (above, below) = (&self.above[columns.clone()], &self.below[columns.clone()]);
        for ((value, above), below) in row[columns].iter_mut().zip(above).zip(below) {
            let taken = above + 2 * part(below - above, down);
            let half = part(*value, taken);
            *value = value.saturating_sub(half).saturating_sub(half);
        }
    }

    /// Fills `below` with what the corners at the upper edge of a row of squares tell.
    fn corners(&mut self, scenery: &Scenery<'_>, spans: &Spans, at_rest: &[usize], squares: usize) {
        self.below.fill(0);
        let (y, last) = (squares * self.side, at_rest.len() - 1);
        let reach = spans.of_rows(y.saturating_sub(self.side)..y + self.side);
        if reach.is_empty() {
            return;
        }
        // A place below the last row has what that has.
        let line = scenery.line(y);
        let dark = |x: usize| {
            let at = line.at(x, at_rest[x]);
            shadow::depth(&at, scenery.lamp, scenery.tool, &scenery.core) as f32
        };
        let mut x = reach.start / self.side * self.side;
        let mut here = dark(x);
        while x < reach.end.min(last) {
            let next = (x + self.side).min(last);
            let there = dark(next);
            if here > 0.0 || there > 0.0 {
                let (pixels, _) = self.below[3 * x..3 * next + 3].as_chunks_mut::<3>();
                for (n, pixel) in pixels.iter_mut().enumerate() {
                    let taken = here + (there - here) * (n as f32 / (next - x) as f32);
                    *pixel = TAKEN.map(|most| (taken * most * WHOLE) as i16);
                }
            }
            (x, here) = (next, there);
        }
    }
}

/// Half of so many 32768ths of a value.
#[inline]
fn part(value: i16, of_whole: i16) -> i16 {
    ((i32::from(value) * i32::from(of_whole)) >> 16) as i16
}
