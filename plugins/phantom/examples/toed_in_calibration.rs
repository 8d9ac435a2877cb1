//! Prints the calibration of the toed-in cameras, as `rectify` and `stereo_depth` read it:
//! `cargo run -p trocar-phantom --example toed_in_calibration > tests/data/calibration/phantom-toed-in.json`.
//!
//! Invariant: nothing is fitted: it is what the rig is made of, and rectified images are those of
//! `Rig::rectified`.

use nalgebra::Matrix3;
use trocar_phantom::camera::{BASELINE_M, Camera, Rig};

const WIDTH: usize = 1024;
const HEIGHT: usize = 768;

fn main() {
    let (toed_in, rectified) = (Rig::toed_in(WIDTH, HEIGHT), Rig::rectified(WIDTH, HEIGHT));
    let [left, right] = [0, 1].map(|n| side(&toed_in.cameras[n], &rectified.cameras[n], n));
    println!(
        "{{\n \"format\": \"trocar-stereo-calibration\",\n \"version\": 1,\n \"made_with\": \"toed_in_calibration\",\n \
         \"image_size\": [{WIDTH}, {HEIGHT}],\n \"left\": {left},\n \"right\": {right}\n}}"
    );
}

/// One camera, and the rectified one in its place.
fn side(of: &Camera, to: &Camera, number: usize) -> String {
    let (f, [cx, cy]) = (of.focal_px, of.centre_px);
    let matrix = Matrix3::new(f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0);
    // The axes of the rectified cameras are the world's.
    let turn = of.world_from_camera.rotation.to_rotation_matrix().into_inner();
    let (f, [cx, cy]) = (to.focal_px, to.centre_px);
    let shift = if number == 0 { 0.0 } else { -f * BASELINE_M };
    let projection = [[f, 0.0, cx, shift], [0.0, f, cy, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let lens = of.lens;
    format!(
        "{{\n  \"matrix\": {:?},\n  \"distortion\": {:?},\n  \"rectification\": {:?},\n  \"projection\": {projection:?}\n }}",
        rows(&matrix),
        [lens.k1, lens.k2, lens.p1, lens.p2],
        rows(&turn),
    )
}

fn rows(of: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| of[(r, c)]))
}
