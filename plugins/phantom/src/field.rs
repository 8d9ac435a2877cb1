//! The microscope's round field: dark outside of it, and dimmer towards its edge.
//!
//! Invariant: it stands still in the image, the same in both eyes' images, however the eye moves. A pixel's
//! part of the light depends on its place alone, so any range of columns of a row comes out as in the whole
//! row.

use std::ops::Range;

use crate::camera::{FIELD_M, Rig, WORKING_DISTANCE_M};

/// Brightness between two levels is kept in this many parts until the noise is added.
pub(crate) const PARTS: i16 = 1 << PART_BITS;
const PART_BITS: u32 = 7;

/// Value of a sensor where there is no light, levels.
const DARK: i16 = 3;
/// Part of the light that is lost at the edge of the field; it grows with the square of the distance from the
/// middle.
const LOST: f64 = 0.38;
/// The same before the field takes light at its edge, in parts of a level.
const DARK_EDGE: f32 = DARK as f32 * PARTS as f32 / (1.0 - LOST as f32);
/// Half the width of the edge, px of a picture that is 1024 px wide.
const EDGE_PX: f64 = 2.0;
/// All light.
const WHOLE: f64 = 32767.0;

/// The field of a rig's images.
pub(crate) struct Field {
    centre_px: [f64; 2],
    radius_px: f64,
    /// Half the width of its edge, px.
    edge_px: f64,
    /// Light that is lost because of each column, three values each, of [`WHOLE`].
    columns: Vec<i16>,
    /// Columns of each row that have light, and within them those that are not of the edge.
    rows: Vec<[Range<usize>; 2]>,
    /// Part of the light that each pixel of the edge lets through, row after row, and where in them each row
    /// begins.
    edges: Vec<f32>,
    begins: Vec<usize>,
}

impl Field {
    pub(crate) fn new(rig: &Rig) -> Field {
        let (centre_px, radius_px) = rig.field_px();
        let camera = &rig.cameras[0];
        let per_1024 = camera.focal_px * FIELD_M / WORKING_DISTANCE_M / 1024.0;
        let edge_px = (EDGE_PX * per_1024).max(0.5);
        let span = |y: usize, radius: f64| {
            let half2 = radius * radius - (y as f64 - centre_px[1]).powi(2);
            if half2 <= 0.0 {
                return 0..0;
            }
            let inside = |at: f64| at.clamp(0.0, camera.width as f64) as usize;
            let half = half2.sqrt();
            inside((centre_px[0] - half).ceil())..inside((centre_px[0] + half).floor() + 1.0)
        };
        let (columns, rows) = (Vec::new(), Vec::with_capacity(camera.height));
        let (edges, begins) = (Vec::new(), Vec::with_capacity(camera.height));
        let mut field = Field { centre_px, radius_px, edge_px, columns, rows, edges, begins };
        field.columns = (0..3 * camera.width).map(|at| field.lost((at / 3) as f64, 0)).collect();
        for y in 0..camera.height {
            let (lit, whole) = (span(y, radius_px + edge_px), span(y, (radius_px - edge_px).max(0.0)));
            // A row without a whole pixel is all edge.
            let whole = if whole.is_empty() { lit.end..lit.end } else { whole };
            field.begins.push(field.edges.len());
            for x in (lit.start..whole.start).chain(whole.end..lit.end) {
                let away = (x as f64 - centre_px[0]).hypot(y as f64 - centre_px[1]);
                let open = ((radius_px - away) / edge_px / 2.0 + 0.5).clamp(0.0, 1.0) as f32;
                field.edges.push(open * open * (3.0 - 2.0 * open));
            }
            field.rows.push([lit, whole]);
        }
        field
    }

    /// Columns of row `y` that have light.
    pub(crate) fn lit(&self, y: usize) -> Range<usize> {
        self.rows[y][0].clone()
    }

    /// Is the field open at a place, px?
    pub(crate) fn open(&self, x: f64, y: f64) -> bool {
        let (x, y, radius) = (x - self.centre_px[0], y - self.centre_px[1], self.radius_px - self.edge_px);
        x * x + y * y < radius * radius
    }

    /// Takes the light that the microscope does not let through from some columns of row `y`, adds the noise
    /// and rounds to levels: `row` and `noise` are in parts of a level, half a level is in the noise for
    /// rounding.
    pub(crate) fn expose(
        &self,
        row: &mut [i16],
        noise: &[i16],
        bytes: &mut [u8],
        y: usize,
        columns: Range<usize>,
    ) {
        let [all, whole] = &self.rows[y];
        let within = |from: usize, to: usize| {
            from.clamp(columns.start, columns.end)..to.clamp(columns.start, columns.end)
        };
        let left = self.begins[y];
        let right = left + (whole.start - all.start);
        for (edge, from, begins) in [
            (within(all.start, whole.start), all.start, left),
            (within(whole.end, all.end), whole.end, right),
        ] {
            for x in edge {
                let open = self.edges[begins + x - from];
                for value in &mut row[3 * x..3 * x + 3] {
                    *value = (DARK_EDGE + (f32::from(*value) - DARK_EDGE) * open) as i16;
                }
            }
        }
        let level = |value: i16, noise: i16| (value.saturating_add(noise) >> PART_BITS).clamp(0, 255) as u8;
        let lit = within(all.start, all.end);
        for dark in [3 * columns.start..3 * lit.start, 3 * lit.end..3 * columns.end] {
            for (byte, noise) in bytes[dark.clone()].iter_mut().zip(&noise[dark]) {
                *byte = level(DARK * PARTS, *noise);
            }
        }
        let of_row = self.lost(y as f64, 1);
        let lit = 3 * lit.start..3 * lit.end;
        let lost = self.columns[lit.clone()].iter().map(|of_column| of_row.saturating_add(*of_column));
        let pixels = bytes[lit.clone()].iter_mut().zip(&row[lit.clone()]).zip(&noise[lit]);
        for (((byte, value), noise), lost) in pixels.zip(lost) {
            // Taken twice and not doubled: compilers keep that in 16 bits, eight values at a time.
            let half = ((i32::from(*value) * i32::from(lost)) >> 16) as i16;
            *byte = level(value.saturating_sub(half).saturating_sub(half), *noise);
        }
    }

    /// Light that is lost because of a place along one axis (0: x, 1: y), of [`WHOLE`].
    fn lost(&self, at: f64, axis: usize) -> i16 {
        let away = (at - self.centre_px[axis]) / self.radius_px;
        (LOST * away * away * WHOLE).min(WHOLE) as i16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_is_a_circle_with_a_soft_edge_and_dimmer_at_its_edge_than_in_its_middle() {
        let field = Field::new(&Rig::rectified(1024, 768));
        let at = |x: usize, y: usize| {
            let mut bytes = vec![0; 3 * 1024];
            field.expose(&mut [200 * PARTS; 3 * 1024], &[PARTS / 2; 3 * 1024], &mut bytes, y, 0..1024);
            bytes[3 * x]
        };
        assert!((199..=200).contains(&at(511, 383)));
        assert_eq!([at(20, 383), at(1003, 383), at(0, 0), at(1023, 767)], [DARK as u8; 4]);
        assert!((115..135).contains(&at(40, 383)), "{}", at(40, 383));
        let edge: Vec<_> = (25..37).map(|x| at(x, 383)).collect();
        assert!(edge.is_sorted() && edge.iter().filter(|v| (10..110).contains(*v)).count() >= 2, "{edge:?}");
        assert!(field.open(40.0, 383.0) && !field.open(28.0, 383.0) && !field.lit(383).contains(&20));
    }

    #[test]
    fn any_columns_come_out_as_in_the_whole_row() {
        let field = Field::new(&Rig::rectified(160, 120));
        for y in [0, 3, 60, 119] {
            let of = |columns: Range<usize>| {
                let mut bytes = vec![0; 480];
                field.expose(&mut [150 * PARTS; 480], &[PARTS / 2; 480], &mut bytes, y, columns);
                bytes
            };
            let whole = of(0..160);
            for columns in [0..7, 3..90, 80..160, 20..20, 150..160] {
                let some = of(columns.clone());
                let values = 3 * columns.start..3 * columns.end;
                assert_eq!(some[values.clone()], whole[values]);
            }
        }
    }
}
