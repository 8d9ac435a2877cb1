//! Pictures of the eye as a stereo microscope takes them: retina, tool, its shadow, sensor noise; and the
//! disparity that a perfect matcher would find in them.
//!
//! Invariant: a picture is a function of world, rig and scene alone. What stands still is traced once, in
//! `new`; a frame shifts and zooms that (`backdrop`) and traces only the pixels where tool or shadow may be.
//! Nothing is allocated after `new`. The membrane is clear and is not drawn; disparity is that of tool and
//! ILM.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Vector3;

use crate::backdrop::{Backdrop, Warp};
use crate::camera::{Rig, Tool};
use crate::field::{Field, PARTS};
use crate::lamp::Lamp;
use crate::noise::Noise;
use crate::rows::{NOISE_PLACES, Work};
use crate::scenery::Scenery;
use crate::world::World;

/// Random numbers of the sensors.
const NOISE_STREAM: u64 = 0x6361_6d65;
/// Disparity is told in this part of a pixel: 16 bits, 0 where there is none, as KITTI stores it.
pub const DISPARITY_UNITS_PER_PX: f64 = 256.0;

/// A scene to be drawn: time, number and tool.
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
    stage: Arc<Stage>,
    work: Work,
}

/// The parts of a renderer that stand still.
struct Stage {
    world: World,
    rig: Rig,
    lamp: Lamp,
    eyes: [Backdrop; 2],
    field: Field,
    /// Standard normal, in parts of a level; half a level is in it for rounding.
    noise: Vec<i16>,
}

impl Renderer {
    /// Traces the picture at rest on all processors that the calling thread may use: some 0.6 s on two of
    /// them for 1024 × 768, so it belongs into `configure`.
    pub fn new(world: World, rig: Rig) -> Renderer {
        let lamp = Lamp::default();
        let eyes = rig.cameras.map(|camera| Backdrop::new(&world, camera, &lamp));
        let width = rig.cameras[0].width;
        let normal = world.noise(NOISE_STREAM);
        let noise = (0..NOISE_PLACES + 3 * width)
            .map(|at| {
                let level = normal.normal((at % NOISE_PLACES) as u64).clamp(-6.0, 6.0);
                (level * f64::from(PARTS)) as i16 + PARTS / 2
            })
            .collect();
        Renderer::of(Arc::new(Stage { world, rig, lamp, eyes, field: Field::new(&rig), noise }))
    }

    /// Another renderer of the same, for another thread: what stands still is shared.
    pub fn twin(&self) -> Renderer {
        Renderer::of(self.stage.clone())
    }

    fn of(stage: Arc<Stage>) -> Renderer {
        let camera = &stage.rig.cameras[0];
        let work = Work::new(camera.width, camera.height, stage.eyes[0].width);
        Renderer { stage, work }
    }

    pub fn rig(&self) -> &Rig {
        &self.stage.rig
    }

    /// Draws one eye's picture: `take` gets each row's number and its pixels, red, green, blue, from the top.
    pub fn draw(&mut self, side: Side, scene: &Scene, mut take: impl FnMut(usize, &[u8])) {
        let (stage, work) = (&*self.stage, &mut self.work);
        let begun = stage.begin(work, side, scene);
        let columns = [0..begun.eye.camera.width, 0..0];
        for y in 0..begun.eye.camera.height {
            begun.draw(work, y, &columns);
            take(y, &work.bytes);
        }
    }

    /// As [`Renderer::draw`], where the same scene without its tool was drawn before: `bare` holds its rows,
    /// one behind the other. Only what tool and shadow touch is drawn; the result is the same.
    ///
    /// # Panics
    /// `bare` is smaller than a picture.
    pub fn draw_over(&mut self, side: Side, scene: &Scene, bare: &[u8], mut take: impl FnMut(usize, &[u8])) {
        let (stage, work) = (&*self.stage, &mut self.work);
        let begun = stage.begin(work, side, scene);
        let row_bytes = 3 * begun.eye.camera.width;
        for (y, bare) in bare[..row_bytes * begun.eye.camera.height].chunks_exact(row_bytes).enumerate() {
            let touched = work.touched(y);
            if touched.iter().all(Range::is_empty) {
                take(y, bare);
                continue;
            }
            work.bytes.copy_from_slice(bare);
            begun.draw(work, y, &touched);
            take(y, &work.bytes);
        }
    }

    /// Fills `out` with the disparity of each pixel of the left picture, in [`DISPARITY_UNITS_PER_PX`]; 0
    /// outside of the round field and where the right eye does not see what the left one does. As many pixels
    /// as `out` has.
    ///
    /// Only a rectified rig has disparities; with another one all are 0.
    pub fn disparity(&mut self, scene: &Scene, out: &mut [u16]) {
        out.fill(0);
        if !self.stage.rig.rectified {
            return;
        }
        let (stage, work) = (&*self.stage, &mut self.work);
        let Stage { world, rig, lamp, eyes, field, .. } = stage;
        let shift = world.motion.shift(scene.t_s);
        let [left, right] = eyes;
        let warp = left.warp(&shift);
        work.follow(&warp, left.camera.width);
        work.mark(world, &right.camera, lamp, scene.tool.as_ref(), &shift);
        // The right eye's spans hide what lies behind; the left one's are needed to see the tool itself.
        std::mem::swap(&mut work.tool, &mut work.shadow);
        work.tool.mark_tool(&left.camera, scene.tool.as_ref());
        let from = [left.camera.eye(), right.camera.eye()];
        let width = left.camera.width;
        for (y, out) in out.chunks_mut(width).enumerate().take(left.camera.height) {
            let (tool, hides) = (work.tool.of(y), work.shadow.of(y));
            let depths = &left.depth[warp.nearest_row(y) * left.width..];
            for (x, out) in out.iter_mut().enumerate() {
                if !field.open(x as f64, y as f64) {
                    continue;
                }
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
                if column < -0.5 || column > width as f64 - 0.5 || !field.open(column, y as f64) {
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

/// One eye's picture in the making.
struct Begun<'a> {
    eye: &'a Backdrop,
    field: &'a Field,
    warp: Warp,
    scenery: Option<Scenery<'a>>,
    noise: &'a [i16],
    /// Random numbers that say at which place in the noise each row begins.
    rows: Noise,
}

impl Stage {
    fn begin<'a>(&'a self, work: &mut Work, side: Side, scene: &'a Scene) -> Begun<'a> {
        let Stage { world, lamp, eyes, field, noise, .. } = self;
        let eye = &eyes[side as usize];
        let shift = world.motion.shift(scene.t_s);
        let warp = eye.warp(&shift);
        work.follow(&warp, eye.camera.width);
        work.mark(world, &eye.camera, lamp, scene.tool.as_ref(), &shift);
        let of_tool = |tool| Scenery { eye, lamp, tool, core: tool.core(), warp, shift };
        let scenery = scene.tool.as_ref().map(of_tool);
        if let Some(scenery) = &scenery {
            work.shade.begin(scenery);
        }
        let rows = world.noise(NOISE_STREAM).part(2 * scene.number + side as u64);
        Begun { eye, field, warp, scenery, noise, rows }
    }
}

impl Begun<'_> {
    /// Draws some columns of row `y`: all that tool and shadow touch, or more.
    fn draw(&self, work: &mut Work, y: usize, columns: &[Range<usize>; 2]) {
        let lit = self.field.lit(y);
        for columns in columns {
            let seen = columns.start.max(lit.start)..columns.end.min(lit.end);
            work.retina(self.eye, &self.warp, y, seen);
        }
        if let Some(scenery) = &self.scenery {
            work.darken(scenery, y);
            work.paint(scenery, y, lit);
        }
        for columns in columns {
            work.finish(self.field, self.noise, self.rows, y, columns.clone());
        }
    }
}

#[cfg(test)]
#[path = "render_tests.rs"]
mod tests;
