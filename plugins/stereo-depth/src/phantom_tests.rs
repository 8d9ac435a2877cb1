//! Gate B4: depth of tool and retina in pairs of the simulated eye, through the component, beside the truth
//! of the phantom.
//!
//! The microscope has a focal length `f` of 20 480 px, a baseline `B` of 5 mm and stands `Z` = 200 mm away:
//! `dZ = Z² / (f B) · dd` makes 391 µm of one pixel of disparity and 24 µm of the 1/16 px in which it is
//! told. So 100 µm are 0.26 px, 150 µm are 0.38 px.
//!
//! Steel has no texture. A matcher can hold on to the outline, and that of a shaft moves with its middle, not
//! with the side that faces the camera: in both eyes it is the circle across the line of sight. Streaks on
//! the steel wander with the eye that looks. So only the fine end of the taper counts, which is about as wide
//! as a window: a window there sees outline and face at once, and its depth is that of the middle between the
//! two. How much deeper the tip is follows from the tilt, which the robot knows; 50 µm of registration along
//! the shaft are 94 µm of depth at a tilt of 28°.
//!
//! The tool is tilted by 25° to 31° and comes in 15° to 30° from below the rows, as the robot brings it in.
//! Along the rows the outline of a shaft would tell nothing (at 5° block matching finds the retina instead).
//! Block matching holds the bounds (77 µm and 90 µm RMS); semi-global matching of a census does not (tip 213
//! µm): its paths carry the retina's depth into the steel.
#![allow(clippy::unwrap_used)]

use nalgebra::{Point3, UnitVector3, Vector3};
use trocar_phantom::World;
use trocar_phantom::camera::{Rig, Tool};
use trocar_phantom::render::{DISPARITY_UNITS_PER_PX, Renderer, Scene, Side};
use trocar_sdk::data::{ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;

use crate::{SCALE, StereoDepth};

/// Part of the sensor that is drawn, around the tip: pixels have their real size on the retina.
const WIDTH: usize = 384;
const HEIGHT: usize = 288;
/// Scenes, one per seed.
const SEEDS: std::ops::RangeInclusive<u64> = 1..=20;
/// Random numbers of the scenes.
const STREAM: u64 = 0x6234;
/// The robot tells the place of the tip in the picture with an error of up to so much, px (50 µm).
const REGISTRATION_PX: f64 = 5.0;
/// Part of the taper whose depths count, m along the core: there the tool is about as wide as a window of 15
/// px.
const TAPER_M: std::ops::Range<f64> = 0.0..1.2e-3;
/// So far before the tip (along the core as if it went on) no window has anything of the tool in it, m.
const AHEAD_M: f64 = 0.4e-3;
/// A window of 15 px further away from the outline has nothing of the tool in it.
const CLEAR_PX: f64 = 10.0;
/// Pixels of retina whose median counts: about 0.3 mm × 0.3 mm.
const PATCH: usize = 900;

/// A tool over the retina of a moving eye without a membrane (which is clear: cameras see the ILM).
struct View {
    world: World,
    rig: Rig,
    scene: Scene,
    tool: Tool,
    /// Error of the registration, px.
    off_px: [f64; 2],
}

impl View {
    fn of(seed: u64) -> View {
        let world = World::named("no_membrane", seed).unwrap();
        let noise = world.noise(STREAM);
        let within = |place, from: f64, to: f64| from + (to - from) * noise.uniform(place);
        let t_s = within(0, 0.0, 10.0);
        // From the right and a little from below, as the robot brings it in.
        let (tilt, turn) = (within(2, 25.0, 31.0).to_radians(), within(3, 15.0, 30.0).to_radians());
        let axis = Vector3::new(-tilt.sin() * turn.cos(), -tilt.sin() * turn.sin(), tilt.cos());
        let (x, y) = (within(4, -1.5e-3, 1.5e-3), within(5, -1.5e-3, 1.5e-3));
        let tip = Point3::new(x, y, world.surface_z(x, y, t_s) - within(6, 0.3e-3, 2e-3));
        let tool = Tool::new(tip, UnitVector3::new_normalize(axis));
        let off = |place| within(place, -REGISTRATION_PX, REGISTRATION_PX);
        View {
            world,
            rig: around(&tip),
            scene: Scene { t_s, number: seed, tool: Some(tool) },
            tool,
            off_px: [off(7), off(8)],
        }
    }

    fn matched(&self, method: &str) -> Maps {
        matched(&self.world, &self.rig, &self.scene, method)
    }

    /// Place of a pixel beside the tool: m along the core from its front end, as if it were on it; px across
    /// the core; and the radius of the tool there, px. The robot tells it, with the error of the
    /// registration.
    fn beside(&self, at: usize) -> [f64; 3] {
        let (camera, front) = (&self.rig.cameras[0], self.tool.core()[0]);
        let project = |point: Point3<f64>| camera.project(&point).unwrap();
        let (([u, v], depth), ([bu, bv], _)) =
            (project(front), project(front - self.tool.axis.as_ref() * 1e-3));
        let long = (bu - u).hypot(bv - v);
        let (du, dv) = ((bu - u) / long, (bv - v) / long);
        let x = (at % WIDTH) as f64 - u - self.off_px[0];
        let y = (at / WIDTH) as f64 - v - self.off_px[1];
        let along_m = (x * du + y * dv) / long * 1e-3;
        [along_m, y * du - x * dv, camera.focal_px * self.tool.radius_at(along_m) / depth]
    }

    /// z of the tip in the world, from the depths on its taper, m: each is that of the middle between core
    /// and face, and how much deeper the tip is the tilt tells.
    fn tip_z(&self, maps: &Maps) -> f64 {
        let taper = maps.known().filter_map(|(at, depth)| {
            let [along, across, radius] = self.beside(at);
            let core = depth + 0.5 * self.tool.radius_at(along);
            let seen = TAPER_M.contains(&along) && across.abs() < radius;
            seen.then(|| core + (along + self.tool.tip_radius_m()) * self.tool.axis.z)
        });
        self.rig.cameras[0].eye().z + median(taper.collect())
    }

    /// From a tip at `tip_z` along the tool to the retina, m: the median of those pixels of the retina that
    /// lie nearest to where the tool points, clear of the tool.
    fn distance(&self, maps: &Maps, tip_z: f64) -> f64 {
        let camera = &self.rig.cameras[0];
        let retina: Vec<_> = maps
            .known()
            .filter(|(at, _)| {
                let [along, across, radius] = self.beside(*at);
                along < -AHEAD_M || across.abs() > radius + CLEAR_PX
            })
            .collect();
        let tip = Point3::new(self.tool.tip.x, self.tool.tip.y, tip_z);
        let mut distance = 0.0;
        for _ in 0..4 {
            let ([u, v], _) = camera.project(&(tip + self.tool.axis.as_ref() * distance)).unwrap();
            let (u, v) = (u + self.off_px[0], v + self.off_px[1]);
            let away = |at: usize| ((at % WIDTH) as f64 - u).hypot((at / WIDTH) as f64 - v);
            let mut near: Vec<_> = retina.iter().map(|(at, depth)| (away(*at), *depth)).collect();
            near.select_nth_unstable_by(PATCH, |a, b| a.0.total_cmp(&b.0));
            let depth = median(near[..PATCH].iter().map(|(_, depth)| *depth).collect());
            distance = (camera.eye().z + depth - tip_z) / self.tool.axis.z;
        }
        distance
    }
}

/// Disparity and depth as the component tells them, px and m, NaN where it knows none; and the true
/// disparity, px.
fn matched(world: &World, rig: &Rig, scene: &Scene, method: &str) -> Maps {
    let [left, right] = &rig.cameras;
    let (width, height) = (left.width, left.height);
    let mut renderer = Renderer::new(*world, *rig);
    let mut pair = Vec::with_capacity(6 * width * height);
    for side in [Side::Left, Side::Right] {
        renderer.draw(side, scene, |_, row| pair.extend_from_slice(row));
    }
    let mut units = vec![0; width * height];
    renderer.disparity(scene, &mut units);
    let config = serde_json::json!({
        "method": method, "width": width, "height": height,
        "focal_px": left.focal_px, "baseline_m": trocar_phantom::camera::BASELINE_M,
        "offset_px": right.centre_px[0] - left.centre_px[0],
    });
    let mut bench = Bench::<StereoDepth>::new(config.to_string());
    let header = StereoHeader {
        width: width as u32,
        height: height as u32,
        stride: 3 * width as u32,
        format: PixelFormat::RGB8,
        right_offset: 3 * (width * height) as u64,
        ..StereoHeader::default()
    };
    bench.push_frame("rectified", header, &pair);
    bench.step(1);
    assert_eq!(bench.state().frames, 1, "{}", bench.state().problem);
    let (_, disparity, _) = bench.frames::<ImageHeader>("disparity").pop().unwrap();
    let (_, depth, _) = bench.frames::<ImageHeader>("depth").pop().unwrap();
    let disparity = disparity.as_chunks::<2>().0.iter().map(|d| i16::from_ne_bytes(*d));
    Maps {
        disparity_px: disparity
            .map(|d| if d < 0 { f64::NAN } else { f64::from(d) / f64::from(SCALE) })
            .collect(),
        depth_m: depth.as_chunks::<4>().0.iter().map(|d| f64::from(f32::from_ne_bytes(*d))).collect(),
        true_px: units.iter().map(|u| f64::from(*u) / DISPARITY_UNITS_PER_PX).collect(),
    }
}

/// The part of the whole sensor around a point.
fn around(point: &Point3<f64>) -> Rig {
    let mut rig = Rig::rectified(1024, 768);
    let ([u, v], _) = rig.cameras[0].project(point).unwrap();
    for camera in &mut rig.cameras {
        camera.centre_px[0] -= u.round() - (WIDTH / 2) as f64;
        camera.centre_px[1] -= v.round() - (HEIGHT / 2) as f64;
        (camera.width, camera.height) = (WIDTH, HEIGHT);
    }
    rig
}

struct Maps {
    disparity_px: Vec<f64>,
    depth_m: Vec<f64>,
    true_px: Vec<f64>,
}

impl Maps {
    /// Pixels whose depth is known, m.
    fn known(&self) -> impl Iterator<Item = (usize, f64)> {
        self.depth_m.iter().copied().enumerate().filter(|(_, depth)| !depth.is_nan())
    }
}

fn median(mut all: Vec<f64>) -> f64 {
    assert!(all.len() > 200, "only {} pixels are known", all.len());
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn rms(all: &[f64]) -> f64 {
    (all.iter().map(|x| x * x).sum::<f64>() / all.len() as f64).sqrt()
}

#[test]
fn depth_of_the_tools_tip_and_its_distance_from_the_retina_are_those_of_the_oct_to_a_fraction_of_a_pixel() {
    let (mut tips, mut distances) = (Vec::new(), Vec::new());
    for seed in SEEDS {
        let view = View::of(seed);
        let maps = view.matched("bm");
        let tip_z = view.tip_z(&maps);
        tips.push(tip_z - view.tool.tip.z);
        let below = view.world.below(&view.tool.tip, &view.tool.axis, view.scene.t_s).unwrap();
        distances.push(view.distance(&maps, tip_z) - below.distance_m);
    }
    assert!(rms(&tips) <= 100e-6, "depth of the tip is off by {:e} m RMS: {tips:?}", rms(&tips));
    assert!(rms(&distances) <= 150e-6, "the distance is off by {:e} m RMS: {distances:?}", rms(&distances));
}

#[test]
fn disparities_of_the_textured_retina_are_right_to_a_pixel_but_for_few() {
    for method in ["bm", "sgm"] {
        let (mut known, mut wrong, mut pixels) = (0, 0, 0);
        for seed in 1..=5 {
            let view = View { scene: Scene { tool: None, ..View::of(seed).scene }, ..View::of(seed) };
            let maps = view.matched(method);
            for (told, truth) in maps.disparity_px.iter().zip(&maps.true_px).filter(|(_, t)| **t > 0.0) {
                pixels += 1;
                known += u32::from(!told.is_nan());
                wrong += u32::from((told - truth).abs() > 1.0);
            }
        }
        let (share, dense) = (f64::from(wrong) / f64::from(known), f64::from(known) / f64::from(pixels));
        assert!(share <= 0.05 && dense > 0.85, "{method}: {share} of {dense} of the pixels are wrong");
    }
}

#[test]
fn disparities_of_the_whole_round_field_are_right_to_a_pixel_but_for_few_also_beside_a_tool() {
    let rig = Rig::rectified(1024, 768);
    let view = View::of(1);
    for method in ["bm", "sgm"] {
        let maps = matched(&view.world, &rig, &view.scene, method);
        let told = maps.disparity_px.iter().zip(&maps.true_px).filter(|(_, truth)| **truth > 0.0);
        let off: Vec<_> = told.map(|(told, truth)| (told - truth).abs()).collect();
        let known = off.iter().filter(|off| !off.is_nan()).count() as f64;
        let wrong = off.iter().filter(|off| **off > 1.0).count() as f64;
        let (share, dense) = (wrong / known, known / off.len() as f64);
        assert!(share <= 0.05 && dense > 0.9, "{method}: {share} of {dense} of the pixels are wrong");
    }
}
