//! Cameras above the eye: pinholes with a lens, and the two of a stereo microscope.
//!
//! Invariant: `project` and `ray` are each other's inverse to 1e-6 px; pixel (0, 0) is the middle of the
//! upper left pixel, x goes right, y down, z away from the camera.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

pub use crate::tool::Tool;

/// Distance of the two eyes' pupils, m.
pub const BASELINE_M: f64 = 5e-3;
/// From the pupils to the retina's apex, m.
pub const WORKING_DISTANCE_M: f64 = 200e-3;
/// Width of what is seen there, m.
pub const FIELD_M: f64 = 10e-3;
/// Radius of the microscope's round field at the working distance, m.
pub const FIELD_RADIUS_M: f64 = 0.47 * FIELD_M;
/// Disparity of the retina's apex in the rectified rig, as a part of the width: 24 px of 1024.
const APEX_DISPARITY: f64 = 24.0 / 1024.0;

/// Brown's lens (D. C. Brown, *Decentering Distortion of Lenses*, 1966), as OpenCV names it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    pub k1: f64,
    pub k2: f64,
    pub p1: f64,
    pub p2: f64,
}

impl Lens {
    /// A lens whose corners lie 1 to 2 % beside those of a pinhole, with a little decentring, for the field
    /// of the microscope.
    pub const MICROSCOPE: Lens = Lens { k1: -14.0, k2: 900.0, p1: 0.012, p2: -0.008 };

    /// The point at which the ray through (x, y) of the plane z = 1 leaves the lens.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        [
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        ]
    }

    /// The inverse of [`Lens::distort`], by fixed-point iteration: lenses of a microscope bend little.
    pub fn straighten(&self, seen: [f64; 2]) -> [f64; 2] {
        if *self == Lens::default() {
            return seen;
        }
        let mut at = seen;
        for _ in 0..20 {
            let bent = self.distort(at);
            let (dx, dy) = (seen[0] - bent[0], seen[1] - bent[1]);
            at = [at[0] + dx, at[1] + dy];
            if dx.abs() + dy.abs() < 1e-13 {
                break;
            }
        }
        at
    }
}

/// One camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    pub focal_px: f64,
    /// The point where the axis meets the image.
    pub centre_px: [f64; 2],
    pub lens: Lens,
    pub world_from_camera: Isometry3<f64>,
}

impl Camera {
    /// The pixel on which `point` (m, world) falls, and its distance along the axis, m; `None` behind the
    /// camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<([f64; 2], f64)> {
        let p = self.world_from_camera.inverse_transform_point(point);
        if p.z <= 1e-6 {
            return None;
        }
        let [x, y] = self.lens.distort([p.x / p.z, p.y / p.z]);
        Some(([self.centre_px[0] + self.focal_px * x, self.centre_px[1] + self.focal_px * y], p.z))
    }

    /// The ray through a pixel: x and y where it meets the plane z = 1 of the camera.
    pub fn ray(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        self.lens
            .straighten([(u - self.centre_px[0]) / self.focal_px, (v - self.centre_px[1]) / self.focal_px])
    }

    /// From where the camera looks, m, in the world.
    pub fn eye(&self) -> Point3<f64> {
        Point3::from(self.world_from_camera.translation.vector)
    }

    /// The point `depth_m` along the axis on the ray (x, y), m, in the world.
    pub fn point(&self, [x, y]: [f64; 2], depth_m: f64) -> Point3<f64> {
        self.world_from_camera * Point3::new(x * depth_m, y * depth_m, depth_m)
    }
}

/// The two cameras of a stereo microscope, left first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    pub cameras: [Camera; 2],
    /// Rows of both images match, so a disparity is defined.
    pub rectified: bool,
}

impl Rig {
    /// Parallel cameras without lens errors, whose sensors are shifted to look at the same place, as
    /// rectification would make them of [`Rig::toed_in`]. Disparity (left minus right column) is `focal ·
    /// baseline / depth + centre_left − centre_right`: 24 px of 1024 at the apex, more above it.
    pub fn rectified(width: usize, height: usize) -> Rig {
        let shift = (APEX_DISPARITY * width as f64 - focal(width) * BASELINE_M / WORKING_DISTANCE_M) / 2.0;
        let camera = |side: f64| Camera {
            lens: Lens::default(),
            centre_px: [middle(width) - side * shift, middle(height)],
            ..pinhole(width, height, side, UnitQuaternion::identity())
        };
        Rig { cameras: [camera(-1.0), camera(1.0)], rectified: true }
    }

    /// Cameras that both look at the apex, through lenses: what a microscope gives before rectification.
    pub fn toed_in(width: usize, height: usize) -> Rig {
        let turn = (BASELINE_M / 2.0 / WORKING_DISTANCE_M).atan();
        let camera = |side: f64| Camera {
            lens: Lens::MICROSCOPE,
            // The left one, at −x, turns to +x.
            ..pinhole(width, height, side, UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -side * turn))
        };
        Rig { cameras: [camera(-1.0), camera(1.0)], rectified: false }
    }

    /// The microscope's round field: its middle (column and row) and its radius, px. It is the same in both
    /// images, also of a rectified rig, where the axes of the cameras are not in the middle.
    pub fn field_px(&self) -> ([f64; 2], f64) {
        let [left, right] = &self.cameras;
        let middle = [0, 1].map(|i| (left.centre_px[i] + right.centre_px[i]) / 2.0);
        (middle, left.focal_px * FIELD_RADIUS_M / WORKING_DISTANCE_M)
    }

    /// Disparity of a point `depth_m` away, px; only of a rectified rig.
    pub fn disparity_px(&self, depth_m: f64) -> f64 {
        let [left, right] = &self.cameras;
        left.focal_px * BASELINE_M / depth_m + left.centre_px[0] - right.centre_px[0]
    }
}

fn focal(width: usize) -> f64 {
    width as f64 * WORKING_DISTANCE_M / FIELD_M
}

fn middle(pixels: usize) -> f64 {
    (pixels as f64 - 1.0) / 2.0
}

/// A camera on one side (−1 left, 1 right), above the apex.
fn pinhole(width: usize, height: usize, side: f64, turn: UnitQuaternion<f64>) -> Camera {
    Camera {
        width,
        height,
        focal_px: focal(width),
        centre_px: [middle(width), middle(height)],
        lens: Lens::default(),
        world_from_camera: Isometry3::from_parts(
            Translation3::new(side * BASELINE_M / 2.0, 0.0, -WORKING_DISTANCE_M),
            turn,
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixels_ray_goes_back_to_the_pixel() {
        for rig in [Rig::rectified(1024, 768), Rig::toed_in(1024, 768)] {
            for camera in rig.cameras {
                for n in 0..200 {
                    let pixel = [f64::from(n % 20) * 53.8, f64::from(n / 20) * 85.2];
                    let (back, depth) =
                        camera.project(&camera.point(camera.ray(pixel), 0.199)).expect("before it");
                    assert!(
                        (back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-6,
                        "{pixel:?} became {back:?}"
                    );
                    assert!((depth - 0.199).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn the_lens_of_the_microscope_bends_corners_by_one_to_three_percent() {
        let camera = Rig::toed_in(1024, 768).cameras[0];
        let straight = camera.ray([0.0, 0.0]);
        let pinhole = [-camera.centre_px[0] / camera.focal_px, -camera.centre_px[1] / camera.focal_px];
        let bent = 1.0 - straight[0].hypot(straight[1]) / pinhole[0].hypot(pinhole[1]);
        assert!((0.01..0.03).contains(&bent.abs()), "{bent}");
    }

    #[test]
    fn disparity_is_the_difference_of_columns_and_rows_match() {
        let rig = Rig::rectified(1024, 768);
        for n in 0..100 {
            let f = f64::from(n);
            let point =
                Point3::new(4e-3 * (f * 0.7).sin(), 3e-3 * (f * 1.3).cos(), -8e-3 * (f * 0.21).sin().abs());
            let [left, right] = rig.cameras.map(|camera| camera.project(&point).expect("below the cameras"));
            assert!((left.0[1] - right.0[1]).abs() < 1e-9, "rows");
            assert!((left.0[0] - right.0[0] - rig.disparity_px(left.1)).abs() < 1e-9, "columns");
        }
        let apex = rig.disparity_px(WORKING_DISTANCE_M);
        assert!((apex - 24.0).abs() < 1e-9, "{apex}");
    }

    #[test]
    fn both_cameras_see_the_apex_near_the_middle() {
        for (rig, beside) in [(Rig::rectified(640, 480), 8.0), (Rig::toed_in(640, 480), 0.01)] {
            for camera in rig.cameras {
                let ([u, v], _) = camera.project(&Point3::origin()).expect("below the cameras");
                assert!((u - 319.5).abs() < beside && (v - 239.5).abs() < 0.01, "{u}, {v}");
            }
        }
    }
}
