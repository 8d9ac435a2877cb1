//! The pixels of one row of a picture: retina at rest moved to where the eye is, shadow, tool, noise.
//!
//! Invariant: any range of columns of a row comes out as in the whole row. Nothing is allocated after `new`.

use std::ops::Range;

use nalgebra::{Point3, Vector3};

use crate::backdrop::{Backdrop, Warp};
use crate::camera::{Camera, Tool};
use crate::lamp::Lamp;
use crate::noise::Noise;
use crate::render::Scene;
use crate::scenery::Scenery;
use crate::shade::Shade;
use crate::shadow;
use crate::spans::{POINTS, Spans};
use crate::world::World;

/// Values of noise that are drawn beforehand; each row of each picture begins at another one.
pub(crate) const NOISE_PLACES: usize = 1 << 16;
/// Brightness between two levels is kept in this many parts until the noise is added.
pub(crate) const PARTS: i16 = 1 << PART_BITS;
const PART_BITS: u32 = 7;
/// Colour of the steel, and how it shines.
const STEEL: [f64; 3] = [150.0, 155.0, 162.0];
const SHINE: f64 = 110.0;
/// Part of the tool's radius over which its colour changes little.
const MIXED_STEEL: f64 = 0.1;

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

    /// Where tool and shadow may be.
    pub(crate) fn mark(
        &mut self,
        world: &World,
        camera: &Camera,
        lamp: &Lamp,
        scene: &Scene,
        shift: &Vector3<f64>,
    ) {
        self.tool.mark_tool(camera, scene.tool.as_ref());
        self.shadow.clear();
        let Some(tool) = &scene.tool else { return };
        let cast = shadow::of(tool, &lamp.at, POINTS, |x, y| {
            world.eye.surface_z(x - shift.x, y - shift.y) + shift.z
        });
        self.shadow.mark(camera, cast);
    }

    /// Some columns of row `y` of the retina: four pixels at rest mixed into one, first along y, then along x.
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
                // The upper half of the product is half of the difference's part.
                let half = ((i32::from(*next - *here) * i32::from(*weight)) >> 16) as i16;
                *to = *here + 2 * half;
            }
        }
    }

    /// Takes light from the pixels of row `y` that the lamp does not reach.
    pub(crate) fn darken(&mut self, scenery: &Scenery<'_>, y: usize) {
        self.shade.darken(scenery, &self.shadow, &self.columns, &mut self.row, y);
    }

    /// Paints the pixels of row `y` where the tool is. Its outline is found pixel by pixel; within it the colours of some pixels
    /// are mixed of their neighbours'.
    pub(crate) fn paint(&mut self, scenery: &Scenery<'_>, y: usize) {
        let line = scenery.line(y);
        let Scenery { tool, lamp, .. } = scenery;
        let colour = |x: usize| {
            let way = line.way(x).normalize();
            tool.meet(line.from(), &way).map(|far| steel(lamp, tool, &(line.from() + way * far), &way))
        };
        let row = &mut self.row;
        let mut put = |x: usize, colour: [f32; 3]| {
            for (value, colour) in row[3 * x..3 * x + 3].iter_mut().zip(colour) {
                *value = (colour.min(255.0) * f32::from(PARTS)) as i16;
            }
        };
        let span = self.tool.of(y);
        let Some(mut last) = span.clone().next() else { return };
        let mut a = colour(last);
        if let Some(a) = a {
            put(last, a);
        }
        let apart = scenery.pixels_of_radius(MIXED_STEEL).min(8);
        while last + 1 < span.end {
            let next = (last + apart).min(span.end - 1);
            let b = colour(next);
            for x in last + 1..next {
                let part = (x - last) as f32 / (next - last) as f32;
                let between = match (a, b) {
                    (Some(a), Some(b)) => Some(std::array::from_fn(|i| a[i] + (b[i] - a[i]) * part)),
                    (None, None) => None,
                    _ => colour(x),
                };
                if let Some(between) = between {
                    put(x, between);
                }
            }
            if let Some(b) = b {
                put(next, b);
            }
            (last, a) = (next, b);
        }
    }

    /// Adds the noise to some columns of row `y` and rounds to levels.
    pub(crate) fn finish(&mut self, noise: &[i16], rows: Noise, y: usize, columns: Range<usize>) {
        let at = rows.bits(y as u64) as usize % NOISE_PLACES;
        let columns = 3 * columns.start..3 * columns.end;
        let noise = &noise[at + columns.start..at + columns.end];
        for ((byte, value), noise) in
            self.bytes[columns.clone()].iter_mut().zip(&self.row[columns]).zip(noise)
        {
            *byte = (value.saturating_add(*noise) >> PART_BITS).clamp(0, 255) as u8;
        }
    }
}

/// Colour of the tool where it is seen along `way`: Lambert's cosine and a highlight (J. Blinn, *Models of light reflection for
/// computer synthesized pictures*, 1977).
fn steel(lamp: &Lamp, tool: &Tool, at: &Point3<f64>, way: &Vector3<f64>) -> [f32; 3] {
    let normal = tool.normal(at);
    let to_lamp = (lamp.at - at).normalize();
    let half = (to_lamp - way).normalize();
    let light = lamp.ambient + (1.0 - lamp.ambient) * normal.dot(&to_lamp).max(0.0);
    // The microscope's own light makes the upper side visible.
    let light = light + 0.35 * (-normal.dot(way)).max(0.0);
    let shine = SHINE * normal.dot(&half).max(0.0).powi(24);
    STEEL.map(|steel| (steel * light + shine) as f32)
}
