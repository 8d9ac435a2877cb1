//! Pictures of the eye as a stereo microscope takes them: retina, tool, its shadow, sensor noise; and the disparity that a
//! perfect matcher would find in them.
//!
//! Invariant: a picture is a function of world, rig and scene alone. What stands still is traced once, in `new`; a frame
//! shifts and zooms that (`backdrop`) and traces only the pixels where tool or shadow may be. Nothing is allocated after `new`.
//! The membrane is clear and is not drawn; disparity is that of tool and ILM.

use nalgebra::{Point3, Vector3};

use crate::backdrop::{Backdrop, Lamp, Warp};
use crate::camera::{Camera, Rig, Tool, WORKING_DISTANCE_M};
use crate::noise::Noise;
use crate::shadow;
use crate::spans::{POINTS, Spans};
use crate::world::World;

/// Random numbers of the sensors.
const NOISE_STREAM: u64 = 0x6361_6d65;
/// Values of noise that are drawn beforehand; each row of each picture begins at another one.
const NOISE_PLACES: usize = 1 << 16;
/// Brightness between two levels is kept in this many parts until the noise is added.
const PARTS: i16 = 1 << PART_BITS;
const PART_BITS: u32 = 7;
/// Colour of the steel, and how it shines.
const STEEL: [f64; 3] = [150.0, 155.0, 162.0];
const SHINE: f64 = 110.0;
/// Parts of the tool's radius over which its colour and the edge of its shadow change little.
const MIXED_STEEL: f64 = 0.1;
const MIXED_SHADOW: f64 = 0.15;
/// Light that is left in the middle of a shadow.
const IN_SHADOW: f32 = 0.3;
/// Disparity is told in this part of a pixel: 16 bits, 0 where there is none, as KITTI stores it.
pub const DISPARITY_UNITS_PER_PX: f64 = 256.0;

/// What is to be seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene {
    /// Time of the world, s: where the eye stands.
    pub t_s: f64,
    /// Number of the picture: decides its noise.
    pub number: u64,
    pub tool: Option<Tool>,
}

/// Left or right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Left = 0,
    Right = 1,
}

/// Draws pictures of one world through one rig.
pub struct Renderer {
    world: World,
    rig: Rig,
    lamp: Lamp,
    eyes: [Backdrop; 2],
    /// Standard normal, in parts of a level; half a level is in it for rounding.
    noise: Vec<i16>,
    work: Work,
}

/// Room for one row and for what is known per row.
struct Work {
    /// Two rows of the picture at rest, mixed.
    mixed: Vec<i16>,
    /// One row of the picture, in parts of a level.
    row: Vec<i16>,
    bytes: Vec<u8>,
    /// Part of the next column in each value of a row, of 32768.
    weights: Vec<i16>,
    /// Columns from (and to where) the place in the picture at rest is so many columns further right.
    runs: Vec<(usize, usize, usize)>,
    /// Column of the picture at rest nearest to each column's place.
    columns: Vec<usize>,
    tool: Spans,
    shadow: Spans,
}

impl Renderer {
    /// Traces the picture at rest: some 0.7 s for 1024 × 768, so it belongs into `configure`.
    pub fn new(world: World, rig: Rig) -> Renderer {
        let lamp = Lamp::default();
        let eyes = rig.cameras.map(|camera| Backdrop::new(&world, camera, &lamp));
        let (width, height) = (rig.cameras[0].width, rig.cameras[0].height);
        let normal = world.noise(NOISE_STREAM);
        let noise = (0..NOISE_PLACES + 3 * width)
            .map(|at| {
                let level = normal.normal((at % NOISE_PLACES) as u64).clamp(-6.0, 6.0);
                (level * f64::from(PARTS)) as i16 + PARTS / 2
            })
            .collect();
        let work = Work {
            mixed: vec![0; 3 * eyes[0].width],
            row: vec![0; 3 * width],
            bytes: vec![0; 3 * width],
            weights: vec![0; 3 * width],
            runs: Vec::with_capacity(width),
            columns: vec![0; width],
            tool: Spans::new(height),
            shadow: Spans::new(height),
        };
        Renderer { world, rig, lamp, eyes, noise, work }
    }

    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Draws one eye's picture: `take` gets each row's number and its pixels, red, green, blue, from the top.
    pub fn draw(&mut self, side: Side, scene: &Scene, mut take: impl FnMut(usize, &[u8])) {
        let Renderer { world, lamp, eyes, noise, work, .. } = self;
        let eye = &eyes[side as usize];
        let shift = world.motion.shift(scene.t_s);
        let warp = eye.warp(&shift);
        work.follow(&warp, eye.camera.width);
        work.mark(world, &eye.camera, lamp, scene, &shift);
        let rows = world.noise(NOISE_STREAM).part(2 * scene.number + side as u64);
        for y in 0..eye.camera.height {
            work.retina(eye, &warp, y);
            if let Some(tool) = &scene.tool {
                work.darken(eye, warp.nearest_row(y), lamp, tool, &shift, y);
                work.paint(eye, lamp, tool, y);
            }
            work.finish(noise, rows, y);
            take(y, &work.bytes);
        }
    }

    /// Fills `out` with the disparity of each pixel of the left picture, in [`DISPARITY_UNITS_PER_PX`]; 0 where the right
    /// eye does not see what the left one does. As many pixels as `out` has.
    ///
    /// Only a rectified rig has disparities; with another one all are 0.
    pub fn disparity(&mut self, scene: &Scene, out: &mut [u16]) {
        out.fill(0);
        if !self.rig.rectified {
            return;
        }
        let Renderer { world, rig, lamp, eyes, work, .. } = self;
        let shift = world.motion.shift(scene.t_s);
        let [left, right] = &*eyes;
        let warp = left.warp(&shift);
        work.follow(&warp, left.camera.width);
        work.mark(world, &right.camera, lamp, scene, &shift);
        // The right eye's spans hide what lies behind; the left one's are needed to see the tool itself.
        std::mem::swap(&mut work.tool, &mut work.shadow);
        work.tool.mark_tool(&left.camera, scene.tool.as_ref());
        let from = [left.camera.eye(), right.camera.eye()];
        let width = left.camera.width;
        for (y, out) in out.chunks_mut(width).enumerate().take(left.camera.height) {
            let (tool, hides) = (work.tool.of(y), work.shadow.of(y));
            let depths = &left.depth[warp.nearest_row(y) * left.width..];
            for (x, out) in out.iter_mut().enumerate() {
                let ray = left.rays[y * width + x];
                let mut depth = f64::from(depths[work.columns[x]]) + shift.z;
                let on_tool = scene.tool.as_ref().filter(|_| tool.contains(&x)).and_then(|tool| {
                    let way = left.turn * Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0);
                    let length = way.norm();
                    tool.meet(&from[0], &(way / length)).map(|far| far / length)
                });
                depth = on_tool.unwrap_or(depth);
                let disparity = rig.disparity_px(depth);
                let column = x as f64 - disparity;
                if column < -0.5 || column > width as f64 - 0.5 {
                    continue;
                }
                if let Some(tool) =
                    scene.tool.as_ref().filter(|_| hides.contains(&(column.max(0.0) as usize)))
                {
                    let at = left.camera.point([f64::from(ray[0]), f64::from(ray[1])], depth);
                    let far = (at - from[1]).norm();
                    let hidden = tool.meet(&from[1], &((at - from[1]) / far));
                    if hidden.is_some_and(|before| before < far - 20e-6) {
                        continue;
                    }
                }
                // Rounded, and 0 for what does not fit.
                let units = (disparity * DISPARITY_UNITS_PER_PX + 0.5) as u32;
                *out = u16::try_from(units).unwrap_or(0);
            }
        }
        std::mem::swap(&mut work.tool, &mut work.shadow);
    }
}

impl Work {
    /// Weights and runs of the columns, the same in all rows.
    fn follow(&mut self, warp: &Warp, width: usize) {
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
    fn mark(&mut self, world: &World, camera: &Camera, lamp: &Lamp, scene: &Scene, shift: &Vector3<f64>) {
        self.tool.mark_tool(camera, scene.tool.as_ref());
        self.shadow.clear();
        let Some(tool) = &scene.tool else { return };
        let cast = shadow::of(tool, &lamp.at, POINTS, |x, y| {
            world.eye.surface_z(x - shift.x, y - shift.y) + shift.z
        });
        self.shadow.mark(camera, cast);
    }

    /// Row `y` of the retina: four pixels at rest mixed into one, first along y, then along x.
    fn retina(&mut self, eye: &Backdrop, warp: &Warp, y: usize) {
        let (row, part) = warp.row(y);
        let below = (part * f64::from(PARTS)).round() as i16;
        let above = PARTS - below;
        let values = 3 * eye.width;
        let (upper, lower) = eye.colour[row * values..].split_at(values);
        for ((mixed, upper), lower) in self.mixed.iter_mut().zip(upper).zip(lower) {
            *mixed = i16::from(*upper) * above + i16::from(*lower) * below;
        }
        for &(start, end, ahead) in &self.runs {
            let (start, end, from) = (3 * start, 3 * end, 3 * start.wrapping_add(ahead));
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

    /// Takes light from the pixels of row `y` that the lamp does not reach. Edges are softer than a few pixels: between those
    /// the shadow is mixed.
    fn darken(
        &mut self,
        eye: &Backdrop,
        row: usize,
        lamp: &Lamp,
        tool: &Tool,
        shift: &Vector3<f64>,
        y: usize,
    ) {
        let core = tool.core();
        let from = eye.camera.eye();
        let rays = &eye.rays[y * eye.camera.width..(y + 1) * eye.camera.width];
        let (depths, columns) = (&eye.depth[row * eye.width..(row + 1) * eye.width], &self.columns);
        let dark = |x: usize| {
            let [rx, ry] = rays[x];
            let depth = f64::from(depths[columns[x]]) + shift.z;
            let at = from + eye.turn * (Vector3::new(f64::from(rx), f64::from(ry), 1.0) * depth);
            shadow::depth(&at, &lamp.at, &core, tool.radius_m) as f32
        };
        let row = &mut self.row;
        let mut put = |x: usize, dark: f32| {
            if dark > 0.0 {
                let left = (256.0 * (1.0 - (1.0 - IN_SHADOW) * dark)) as i32;
                for value in &mut row[3 * x..3 * x + 3] {
                    *value = ((i32::from(*value) * left) >> 8) as i16;
                }
            }
        };
        let span = self.shadow.of(y);
        let Some(mut last) = span.clone().next() else { return };
        let mut a = dark(last);
        put(last, a);
        while last + 1 < span.end {
            let next = (last + every(eye, tool, MIXED_SHADOW)).min(span.end - 1);
            let b = dark(next);
            for x in last + 1..next {
                put(x, a + (b - a) * ((x - last) as f32 / (next - last) as f32));
            }
            put(next, b);
            (last, a) = (next, b);
        }
    }

    /// Paints the pixels of row `y` where the tool is. Its outline is found pixel by pixel; within it the colours of some pixels
    /// are mixed of their neighbours'.
    fn paint(&mut self, eye: &Backdrop, lamp: &Lamp, tool: &Tool, y: usize) {
        let from = eye.camera.eye();
        let rays = &eye.rays[y * eye.camera.width..(y + 1) * eye.camera.width];
        let colour = |x: usize| {
            let [rx, ry] = rays[x];
            let way = (eye.turn * Vector3::new(f64::from(rx), f64::from(ry), 1.0)).normalize();
            tool.meet(&from, &way).map(|far| steel(lamp, tool, &(from + way * far), &way))
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
        while last + 1 < span.end {
            let next = (last + every(eye, tool, MIXED_STEEL)).min(span.end - 1);
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

    /// Adds the noise of row `y` and rounds to levels.
    fn finish(&mut self, noise: &[i16], rows: Noise, y: usize) {
        let at = rows.bits(y as u64) as usize % NOISE_PLACES;
        let noise = &noise[at..at + self.row.len()];
        for ((byte, value), noise) in self.bytes.iter_mut().zip(&self.row).zip(noise) {
            *byte = (value.saturating_add(*noise) >> PART_BITS).clamp(0, 255) as u8;
        }
    }
}

/// Over how many pixels something about the tool may be mixed that changes over this part of its radius; 1 where it is small.
fn every(eye: &Backdrop, tool: &Tool, part: f64) -> usize {
    let radius_px = eye.camera.focal_px * tool.radius_m / WORKING_DISTANCE_M;
    ((part * radius_px) as usize).clamp(1, 8)
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

#[cfg(test)]
#[path = "render_tests.rs"]
mod tests;
