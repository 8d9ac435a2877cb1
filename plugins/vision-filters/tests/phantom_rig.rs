//! Rectification of the simulated microscope's toed-in images by the calibration that is kept for them,
//! against the truth.
//!
//! Invariant: the file was written by the phantom's example `toed_in_calibration`; it says what the rig is.
#![allow(clippy::unwrap_used)]

use std::path::PathBuf;

use nalgebra::{Point3, UnitVector3, Vector3};
use trocar_imaging::Calibration;
use trocar_phantom::World;
use trocar_phantom::camera::{Rig, Tool};
use trocar_phantom::render::{Renderer, Scene, Side};
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;
use trocar_vision_filters::{RectifiedGeometry, Rectify};

const WIDTH: usize = 1024;
const HEIGHT: usize = 768;
/// So far within the edge of the round field both pictures show the eye: rectification shifts it by 12 px and
/// bends it, px.
const EDGE_PX: f64 = 35.0;
const FILE: &str = "../../tests/data/calibration/phantom-toed-in.json";

fn file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(FILE)
}

#[test]
fn points_of_the_eye_lie_where_the_rectified_rig_sees_them() {
    let calibration = Calibration::load(&file()).unwrap();
    assert_eq!((calibration.width, calibration.height), (WIDTH, HEIGHT));
    let (toed_in, rectified) = (Rig::toed_in(WIDTH, HEIGHT), Rig::rectified(WIDTH, HEIGHT));
    let (mut rows, mut count) = (0.0f64, 0);
    for n in 0..500 {
        let f = f64::from(n);
        let (x, y) = (4.5e-3 * (f * 0.7).sin(), 3.4e-3 * (f * 1.3).cos());
        let point = Point3::new(x, y, -6e-3 * (f * 0.21).sin().abs());
        let seen = [0, 1].map(|side| {
            let ([u, v], _) = toed_in.cameras[side].project(&point).unwrap();
            let (x, y) = calibration.cameras[side].rectified(u, v).unwrap();
            let ([true_x, true_y], _) = rectified.cameras[side].project(&point).unwrap();
            assert!((x - true_x).hypot(y - true_y) < 0.01, "({x}, {y}) instead of ({true_x}, {true_y})");
            y
        });
        rows = rows.max((seen[0] - seen[1]).abs());
        count += 1;
    }
    assert!(count == 500 && rows <= 0.01, "rows are up to {rows} px apart");
    // Depth from disparity needs these.
    assert!((calibration.focal_px - rectified.cameras[0].focal_px).abs() < 1e-6);
    assert!((calibration.baseline_m - 5e-3).abs() < 1e-9);
    let disparity_px = rectified.disparity_px(0.2);
    let depth_m = calibration.focal_px * calibration.baseline_m / (disparity_px + calibration.offset_px);
    assert!((depth_m - 0.2).abs() < 1e-9, "{depth_m} m");
}

/// Grey pictures of both eyes.
fn pictures(rig: Rig, scene: &Scene) -> [Vec<u8>; 2] {
    let mut renderer = Renderer::new(World::named("static", 1).unwrap(), rig);
    [Side::Left, Side::Right].map(|side| {
        let mut all = Vec::new();
        renderer.draw(side, scene, |_, row| {
            all.extend(row.as_chunks::<3>().0.iter().map(|[r, g, b]| trocar_imaging::luma(*r, *g, *b)));
        });
        all
    })
}

/// Number of rows by which `seen` lies lower than `real`, px: least squares of differences along the vertical
/// gradient (Lucas and Kanade, 1981), of a part of both pictures. The edge of the round field is no part of
/// the eye: it stays where the sensor is.
fn rows_off(seen: &[u8], real: &[u8], columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> f64 {
    let (mut up, mut down) = (0.0, 0.0);
    let (middle, radius) = Rig::rectified(WIDTH, HEIGHT).field_px();
    let inside = |x: usize, y: usize| (x as f64 - middle[0]).hypot(y as f64 - middle[1]) < radius - EDGE_PX;
    for y in rows {
        for x in columns.clone().filter(|x| inside(*x, y)) {
            let at = |y: usize| f64::from(real[y * WIDTH + x]);
            let slope = (at(y + 1) - at(y - 1)) / 2.0;
            up += slope * (at(y) - f64::from(seen[y * WIDTH + x]));
            down += slope * slope;
        }
    }
    up / down
}

#[test]
fn rectified_images_are_in_line_with_those_of_the_rectified_rig_in_all_parts() {
    let axis = UnitVector3::new_normalize(Vector3::new(-0.8, 0.25, 1.0));
    let tool = Some(Tool::new(Point3::new(0.2e-3, 0.1e-3, -0.8e-3), axis));
    let scene = Scene { t_s: 0.0, number: 3, tool };
    let config = trocar_sdk::serde_json::json!({ "calibration": file().display().to_string() });
    let mut bench = Bench::<Rectify>::new(config);
    let header = StereoHeader {
        width: WIDTH as u32,
        height: HEIGHT as u32,
        stride: WIDTH as u32,
        format: PixelFormat::GRAY8,
        right_offset: (WIDTH * HEIGHT) as u64,
        ..Default::default()
    };
    bench.push_frame("image", header, &pictures(Rig::toed_in(WIDTH, HEIGHT), &scene).concat());
    bench.step(1);
    let (header, bytes, _) = bench.frames::<StereoHeader>("rectified").remove(0);
    assert_eq!((header.width as usize, header.height as usize), (WIDTH, HEIGHT));
    let told: RectifiedGeometry = bench.read("rectified_camera/geometry", ()).unwrap();
    assert!((told.baseline - 5e-3).abs() < 1e-9, "{told:?}");
    let seen = header.images(&bytes).unwrap();
    for (eye, real) in pictures(Rig::rectified(WIDTH, HEIGHT), &scene).iter().enumerate() {
        let seen: Vec<u8> = (0..HEIGHT as u32).flat_map(|y| seen[eye].row(y).to_vec()).collect();
        // The rim has places that the toed-in camera does not see.
        for part in 0..12 {
            let (x, y) = (40 + part % 4 * 236, 40 + part / 4 * 229);
            let off = rows_off(&seen, real, x..x + 236, y..y + 229);
            assert!(off.abs() <= 0.3, "eye {eye}: {off} px at {x}, {y}");
        }
    }
}
