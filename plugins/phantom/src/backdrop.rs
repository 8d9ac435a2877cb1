//! The retina as one camera sees it at rest: colour and depth of each pixel, and how both move with the eye.
//!
//! Invariant: computed once, pixel by pixel, from the same surface and texture that every other device uses.
//! An eye that moves by some 100 µm at 200 mm moves its image by less than a pixel, and by nearly the same at
//! neighbouring pixels: so the picture at rest is shifted and zoomed (`Warp`), which is exact to 0.02 px for
//! the motions of the worlds, instead of being traced again.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::camera::{Camera, WORKING_DISTANCE_M};
use crate::defocus;
use crate::glints;
use crate::lamp::Lamp;
use crate::noise::Noise;
use crate::retina::Retina;
use crate::world::World;

/// Pixels beyond each border that are there for an eye that moves.
pub(crate) const MARGIN: usize = 40;

/// Threads that trace a picture, at most.
const MOST_THREADS: usize = 8;
/// A ray has met the surface when a round changes less, m; and it has after so many.
const NEAR_ENOUGH_M: f64 = 20e-9;
const ROUNDS: usize = 6;

/// Random numbers of the texture's finest detail.
const DETAIL_STREAM: u64 = 0x6465_7461;
/// Sides of the squares of the finest detail, m, and how much brighter or darker they are: what a photograph
/// with 9 µm pixels leaves out.
const DETAIL: [(f64, f32); 2] = [(28e-6, 0.07), (14e-6, 0.05)];

/// Red, green and blue of the photograph in the light of the pipe: warmer than that of the camera it was
/// taken with.
const TISSUE: [f32; 3] = [1.12, 1.02, 0.86];

/// The picture at rest, with [`MARGIN`] more pixels on each side.
pub(crate) struct Backdrop {
    pub(crate) camera: Camera,
    /// Columns of the camera's axes in the world.
    pub(crate) turn: Matrix3<f64>,
    /// Pixels in a row of the picture at rest.
    pub(crate) width: usize,
    /// Rows of it.
    pub(crate) height: usize,
    /// Red, green, blue of each of its pixels.
    pub(crate) colour: Vec<u8>,
    /// Along the camera's axis, m.
    pub(crate) depth: Vec<f32>,
    /// Ray through each pixel of the camera, without the margin.
    pub(crate) rays: Vec<[f32; 2]>,
}

impl Backdrop {
    pub(crate) fn new(world: &World, camera: Camera, lamp: &Lamp) -> Backdrop {
        let (width, height) = (camera.width + 2 * MARGIN, camera.height + 2 * MARGIN);
        let turn = camera.world_from_camera.rotation.to_rotation_matrix().into_inner();
        let backdrop = Backdrop {
            camera,
            turn,
            width,
            height,
            colour: Vec::with_capacity(3 * width * height),
            depth: Vec::with_capacity(width * height),
            rays: Vec::with_capacity(camera.width * camera.height),
        };
        // Read once here and not by each thread.
        Retina::shared();
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
        let rows = height.div_ceil(threads);
        let trace = |n: usize| {
            let mut band = Band::default();
            (n * rows..((n + 1) * rows).min(height)).for_each(|y| band.trace(&backdrop, world, lamp, y));
            band
        };
        let bands: Vec<Band> = std::thread::scope(|scope| {
            let others: Vec<_> = (1..threads).map(|n| scope.spawn(move || trace(n))).collect();
            // A thread that panicked has found what this one would have.
            let traced = |thread: std::thread::ScopedJoinHandle<'_, Band>| match thread.join() {
                Ok(band) => band,
                Err(panic) => std::panic::resume_unwind(panic),
            };
            std::iter::once(trace(0)).chain(others.into_iter().map(traced)).collect()
        });
        let mut blurs_px = Vec::with_capacity(width * height);
        let mut whole = bands.into_iter().fold(backdrop, |mut whole, band| {
            whole.colour.extend(band.colour);
            whole.depth.extend(band.depth);
            whole.rays.extend(band.rays);
            blurs_px.extend(band.blurs_px);
            whole
        });
        defocus::blur(&mut whole.colour, &blurs_px, width);
        whole
    }

    /// Finds the picture of an eye that stands `shift` (m) from its place in the picture at rest.
    pub(crate) fn warp(&self, shift: &Vector3<f64>) -> Warp {
        // Two points beside the apex tell shift and zoom of each axis.
        let reach = 3e-3;
        let seen = |x: f64, y: f64, by: &Vector3<f64>| {
            self.camera.project(&(Point3::new(x, y, 0.0) + by)).map_or([0.0; 2], |(pixel, _)| pixel)
        };
        let axis = |one: [f64; 2], other: [f64; 2], i: usize| {
            let (still, moved) = (
                [seen(one[0], one[1], &Vector3::zeros())[i], seen(other[0], other[1], &Vector3::zeros())[i]],
                [seen(one[0], one[1], shift)[i], seen(other[0], other[1], shift)[i]],
            );
            let zoom = (still[1] - still[0]) / (moved[1] - moved[0]);
            (zoom, still[0] - zoom * moved[0])
        };
        Warp {
            x: axis([-reach, 0.0], [reach, 0.0], 0),
            y: axis([0.0, -reach], [0.0, reach], 1),
            limits: [self.width, self.height],
        }
    }
}

/// Some rows of a picture at rest.
#[derive(Default)]
struct Band {
    colour: Vec<u8>,
    depth: Vec<f32>,
    rays: Vec<[f32; 2]>,
    /// Blur of each pixel, px.
    blurs_px: Vec<f32>,
}

impl Band {
    /// Adds a row. It depends on no other, so pictures are the same however many threads trace them.
    fn trace(&mut self, of: &Backdrop, world: &World, lamp: &Lamp, y: usize) {
        let (camera, eye, detail) = (&of.camera, of.camera.eye(), world.noise(DETAIL_STREAM));
        let (mut far, mut before) = (WORKING_DISTANCE_M, WORKING_DISTANCE_M);
        for x in 0..of.width {
            let [rx, ry] = camera.ray([x as f64 - MARGIN as f64, y as f64 - MARGIN as f64]);
            let inside = |at: usize, size: usize| (MARGIN..MARGIN + size).contains(&at);
            if inside(x, camera.width) && inside(y, camera.height) {
                self.rays.push([rx as f32, ry as f32]);
            }
            let way = of.turn * Vector3::new(rx, ry, 1.0);
            // The retina is flat beside the rays, so each round leaves less than a twentieth of the height;
            // it goes on as it came, so mostly one is enough.
            (far, before) = (2.0 * far - before, far);
            for _ in 0..ROUNDS {
                let at = eye + way * far;
                let off = (world.eye.surface_z(at.x, at.y) - at.z) / way.z;
                far += off;
                if off.abs() < NEAR_ENOUGH_M {
                    break;
                }
            }
            let at = eye + way * far;
            let slopes = slopes(world, &at);
            let normal = Vector3::new(slopes[0], slopes[1], -1.0).normalize();
            let light = lamp.ambient + (1.0 - lamp.ambient) * lamp.light(&at, &normal);
            let (u, v) = world.eye.along(at.x, at.y);
            let shade = light as f32 * fine(detail, u, v);
            let tint = Retina::shared().colour_at(u, v);
            let glint = glints::at([&at, &eye], [u, v], slopes, lamp, detail);
            self.colour.extend([0, 1, 2].map(|i| {
                let value = TISSUE[i] * tint[i] * shade + glint[i];
                (value + 0.5).clamp(0.0, 255.0) as u8
            }));
            self.depth.push(far as f32);
            self.blurs_px.push(defocus::blur_px(camera, at.z) as f32);
        }
    }
}

/// Place in the picture at rest of each pixel now: `zoom · pixel + offset`, along each axis alone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    x: (f64, f64),
    y: (f64, f64),
    limits: [usize; 2],
}

impl Warp {
    /// Column of the picture at rest left of column `x`'s place, and how far between it and the next one.
    pub(crate) fn column(&self, x: usize) -> (usize, f64) {
        place(self.x, x, self.limits[0])
    }

    /// Row of the picture at rest that is nearest to the place of row `y`.
    pub(crate) fn nearest_row(&self, y: usize) -> usize {
        let (row, down) = self.row(y);
        row + usize::from(down >= 0.5)
    }

    /// As [`Warp::column`], of rows.
    pub(crate) fn row(&self, y: usize) -> (usize, f64) {
        place(self.y, y, self.limits[1])
    }
}

fn place((zoom, offset): (f64, f64), at: usize, limit: usize) -> (usize, f64) {
    let place = (zoom * at as f64 + offset + MARGIN as f64).clamp(0.0, limit as f64 - 1.0);
    let whole = (place as usize).min(limit - 2);
    (whole, place - whole as f64)
}

/// Slopes of globe and pit over x and y; vessels are in the photograph already.
fn slopes(world: &World, at: &Point3<f64>) -> [f64; 2] {
    let eye = &world.eye;
    let (radius, r2) = (eye.globe_radius_m, at.x * at.x + at.y * at.y);
    let globe = -1.0 / (radius * radius - r2).max(1e-8).sqrt();
    let width2 = eye.pit_radius_m * eye.pit_radius_m;
    let pit = -2.0 / width2 * eye.pit_depth_m * (-r2 / width2).exp();
    // They are these times x and y.
    [at.x * (globe + pit), at.y * (globe + pit)]
}

/// Brightness of the finest detail at `u`, `v` m along the retina, about 1: smoothed random squares.
fn fine(noise: Noise, u: f64, v: f64) -> f32 {
    let mut sum = 1.0;
    for (layer, (side, strength)) in (0..).zip(DETAIL) {
        let noise = noise.part(layer);
        let (x, y) = (u / side, v / side);
        let (column, row) = (x.floor(), y.floor());
        let (fx, fy) = ((x - column) as f32, (y - row) as f32);
        let at = |dx: i64, dy: i64| {
            let place = ((column as i64 + dx) as u64).wrapping_mul(0x1_0000_0001);
            noise.uniform(place.wrapping_add((row as i64 + dy) as u64)) as f32 - 0.5
        };
        let upper = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
        let lower = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
        sum += 2.0 * strength * (upper * (1.0 - fy) + lower * fy);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rig;

    #[test]
    fn the_depth_of_a_pixel_leads_to_the_surface() {
        let world = World::named("static", 1).expect("a name");
        let lamp = Lamp::default();
        for camera in Rig::toed_in(64, 48).cameras {
            let backdrop = Backdrop::new(&world, camera, &lamp);
            for (n, [x, y]) in backdrop.rays.iter().enumerate() {
                let at = (n / 64 + MARGIN) * backdrop.width + n % 64 + MARGIN;
                let point = camera.point([f64::from(*x), f64::from(*y)], f64::from(backdrop.depth[at]));
                let off = point.z - world.eye.surface_z(point.x, point.y);
                assert!(off.abs() < 0.1e-6, "{off:e} m at pixel {n}");
            }
        }
    }

    #[test]
    fn shift_and_zoom_follow_the_motion_of_the_eye_to_a_fiftieth_of_a_pixel() {
        let world = World::named("static", 1).expect("a name");
        for rig in [Rig::rectified(1024, 768), Rig::toed_in(1024, 768)] {
            for camera in rig.cameras {
                // The pixels are not needed, only how they move.
                let (turn, at_rest) = (Matrix3::identity(), Vec::new());
                let backdrop = Backdrop {
                    camera,
                    turn,
                    width: 1024 + 2 * MARGIN,
                    height: 768 + 2 * MARGIN,
                    colour: Vec::new(),
                    depth: at_rest,
                    rays: Vec::new(),
                };
                for shift in [160e-6, -160e-6].map(|z| Vector3::new(0.0, 0.0, z)) {
                    let warp = backdrop.warp(&shift);
                    for n in 0..100 {
                        let (x, y) = (f64::from(n % 10) * 1e-3 - 4.5e-3, f64::from(n / 10) * 0.7e-3 - 3.2e-3);
                        let point = Point3::new(x, y, world.eye.surface_z(x, y));
                        let (still, _) = camera.project(&point).expect("below");
                        let (moved, _) = camera.project(&(point + shift)).expect("below");
                        let told = [warp.x.0 * moved[0] + warp.x.1, warp.y.0 * moved[1] + warp.y.1];
                        let off = (told[0] - still[0]).hypot(told[1] - still[1]);
                        assert!(off < 0.02, "{off} px at {x}, {y}");
                    }
                }
            }
        }
    }
}
