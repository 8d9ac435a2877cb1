//! The pixels of one row of a picture: retina at rest moved to where the eye is, shadow, tool, noise.
//!
//! Invariant: any range of columns of a row comes out as in the whole row. Nothing is allocated after `new`.

use std::ops::Range;

use nalgebra::Vector3;

use crate::backdrop::{Backdrop, Warp};
use crate::camera::{Camera, Tool};
use crate::field::{Field, PARTS};
use crate::lamp::Lamp;
use crate::noise::Noise;
use crate::scenery::Scenery;
use crate::shade::Shade;
use crate::shadow;
use crate::spans::{POINTS, Spans};
use crate::steel;
use crate::world::World;

/// Values of noise that are drawn beforehand; each row of each picture begins at another one.
pub(crate) const NOISE_PLACES: usize = 1 << 16;
/// Part of the tool's radius over which its colour changes little.
const MIXED_STEEL: f64 = 0.14;
/// Pixels are mixed of their neighbours' where the tool's part of them changes less than this.
const STEEP: f32 = 0.35;

/// Room for one row and for what is known per row.
pub(crate) struct Work {
    /// Two rows of the picture at rest, mixed.
    pub(crate) mixed: Vec<i16>,
    /// One row of the picture, in parts of a level.
    pub(crate) row: Vec<i16>,
    pub(crate) bytes: Vec<u8>,
    /// Part of the next column in each value of a row, of 32768.
    pub(crate) weights: Vec<i16>,
    /// Columns from (and to where) the place in the picture at rest is so many columns further right.
    pub(crate) runs: Vec<(usize, usize, usize)>,
    /// Column of the picture at rest nearest to each column's place.
    pub(crate) columns: Vec<usize>,
    pub(crate) tool: Spans,
    pub(crate) shadow: Spans,
    pub(crate) shade: Shade,
}

impl Work {
    /// For pictures of this size, and pictures at rest that are `at_rest` pixels wide.
    pub(crate) fn new(width: usize, height: usize, at_rest: usize) -> Work {
        Work {
            mixed: vec![0; 3 * at_rest],
            row: vec![0; 3 * width],
            bytes: vec![0; 3 * width],
            weights: vec![0; 3 * width],
            runs: Vec::with_capacity(width),
            columns: vec![0; width],
            tool: Spans::new(height),
            shadow: Spans::new(height),
            shade: Shade::new(width),
        }
    }

    /// Columns of row `y` in which tool or shadow may be: one range or two that do not meet.
    pub(crate) fn touched(&self, y: usize) -> [Range<usize>; 2] {
        let (tool, shadow) = (self.tool.of(y), self.shadow.of(y));
        if tool.is_empty() || shadow.is_empty() || tool.end < shadow.start || shadow.end < tool.start {
            return [tool, shadow];
        }
        [tool.start.min(shadow.start)..tool.end.max(shadow.end), 0..0]
    }

    /// Weights and runs of the columns, the same in all rows.
    pub(crate) fn follow(&mut self, warp: &Warp, width: usize) {
        self.runs.clear();
        for x in 0..width {
            let (column, part) = warp.column(x);
            self.columns[x] = column + usize::from(part >= 0.5);
            self.weights[3 * x..3 * x + 3].fill((part * 32767.0) as i16);
            let ahead = column.wrapping_sub(x);
            match self.runs.last_mut() {
                Some((_, end, same)) if *same == ahead => *end = x + 1,
                _ => self.runs.push((x, x + 1, ahead)),
            }
        }
    }

    /// Marks the spans in which tool and shadow may be.
    pub(crate) fn mark(
        &mut self,
        world: &World,
        camera: &Camera,
        lamp: &Lamp,
        tool: Option<&Tool>,
        shift: &Vector3<f64>,
    ) {
        self.tool.mark_tool(camera, tool);
        self.shadow.clear();
        let Some(tool) = tool else { return };
        let cast =
            shadow::of(tool, lamp, POINTS, |x, y| world.eye.surface_z(x - shift.x, y - shift.y) + shift.z);
        self.shadow.mark(camera, cast);
    }

    /// Some columns of row `y` of the retina: four pixels at rest mixed into one, first along y, then along
    /// x.
    pub(crate) fn retina(&mut self, eye: &Backdrop, warp: &Warp, y: usize, columns: Range<usize>) {
        let (row, part) = warp.row(y);
        let below = (part * f64::from(PARTS)).round() as i16;
        let above = PARTS - below;
        let values = 3 * eye.width;
        let (upper, lower) = eye.colour[row * values..].split_at(values);
        for &(start, end, ahead) in &self.runs {
            let (start, end) = (start.max(columns.start), end.min(columns.end));
            if start >= end {
                continue;
            }
            let (start, end, from) = (3 * start, 3 * end, 3 * start.wrapping_add(ahead));
            let mixed = from..from + (end - start) + 3;
            let (upper, lower) = (&upper[mixed.clone()], &lower[mixed.clone()]);
            for ((mixed, upper), lower) in self.mixed[mixed].iter_mut().zip(upper).zip(lower) {
                *mixed = i16::from(*upper) * above + i16::from(*lower) * below;
            }
            let here = &self.mixed[from..from + (end - start)];
            let next = &self.mixed[from + 3..from + 3 + (end - start)];
            let weights = &self.weights[start..end];
            for (((to, here), next), weight) in
                self.row[start..end].iter_mut().zip(here).zip(next).zip(weights)
            {
                // The upper half of the product is half of the difference's part. It is added twice and not
                // doubled: compilers keep that in 16 bits, eight values at a time.
                let half = ((i32::from(*next - *here) * i32::from(*weight)) >> 16) as i16;
                *to = here.saturating_add(half).saturating_add(half);
            }
        }
    }

    /// Takes light from the pixels of row `y` that the lamp does not reach.
    pub(crate) fn darken(&mut self, scenery: &Scenery<'_>, y: usize) {
        self.shade.darken(scenery, &self.shadow, &self.columns, &mut self.row, y);
    }

    /// Paints the pixels of row `y` where the tool is, as far as `lit` reaches. Where its outline is sharp it
    /// is found pixel by pixel; elsewhere some pixels are mixed of their neighbours. Which ones does not
    /// depend on the columns.
    pub(crate) fn paint(&mut self, scenery: &Scenery<'_>, y: usize, lit: Range<usize>) {
        let line = scenery.line(y);
        let row = &mut self.row;
        let last = row.len() / 3 - 1;
        let mut put = |x: usize, light: [f32; 3], covered: f32| {
            for (value, light) in row[3 * x..3 * x + 3].iter_mut().zip(light) {
                *value = (f32::from(*value) * (1.0 - covered) + light * f32::from(PARTS)) as i16;
            }
        };
        let span = self.tool.of(y);
        let span = span.start.max(lit.start)..span.end.min(lit.end);
        if span.is_empty() {
            return;
        }
        let apart = scenery.pixels_of_radius(MIXED_STEEL).clamp(1, 4);
        let seen = |x: usize| steel::seen(scenery, &line, x);
        let mut x = span.start / apart * apart;
        let mut here = seen(x);
        while x < span.end {
            if here.clear > apart {
                x += here.clear / apart * apart;
                if x < span.end {
                    here = seen(x);
                }
                continue;
            }
            if span.contains(&x) && here.covered > 0.0 {
                put(x, here.light, here.covered);
            }
            if x == last {
                break;
            }
            let next = (x + apart).min(last);
            let there = seen(next);
            for between in (x + 1).max(span.start)..next.min(span.end) {
                if here.covered + there.covered == 0.0 {
                    break;
                }
                if here.fine || there.fine || (here.covered - there.covered).abs() > STEEP {
                    let exact = seen(between);
                    put(between, exact.light, exact.covered);
                    continue;
                }
                let part = (between - x) as f32 / (next - x) as f32;
                let mix = |here: f32, there: f32| here + (there - here) * part;
                let light = std::array::from_fn(|i| mix(here.light[i], there.light[i]));
                put(between, light, mix(here.covered, there.covered));
            }
            (x, here) = (next, there);
        }
    }

    /// Makes bytes of some columns of row `y`: in the round field, with noise.
    pub(crate) fn finish(
        &mut self,
        field: &Field,
        noise: &[i16],
        rows: Noise,
        y: usize,
        columns: Range<usize>,
    ) {
        let at = rows.bits(y as u64) as usize % NOISE_PLACES;
        field.expose(&mut self.row, &noise[at..at + self.bytes.len()], &mut self.bytes, y, columns);
    }
}
