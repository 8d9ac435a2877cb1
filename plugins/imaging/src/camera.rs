//! A pinhole camera with lens distortion, and where its pixels lie in its rectified image.
//!
//! Invariant: `source` is the exact formula; `rectified` is its inverse by iteration and says so where it
//! found none. Formulas: Brown's model as in OpenCV's documentation of `initUndistortRectifyMap` and
//! `undistortPoints`.

use nalgebra::{Matrix3, Vector3};

/// One camera of a calibrated pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Camera matrix, px.
    matrix: Matrix3<f64>,
    /// k1 k2 p1 p2 k3 k4 k5 k6.
    distortion: [f64; 8],
    /// Rectified pixel to ray of the camera: (P·R)⁻¹.
    ray_of: Matrix3<f64>,
    /// Ray of the camera to rectified pixel: P·R.
    pixel_of: Matrix3<f64>,
}

impl Camera {
    /// A camera of checked parts; none when the new projection is singular.
    pub(crate) fn new(
        matrix: Matrix3<f64>,
        distortion: [f64; 8],
        rectification: Matrix3<f64>,
        projection: Matrix3<f64>,
    ) -> Option<Camera> {
        let pixel_of = projection * rectification;
        Some(Camera { matrix, distortion, ray_of: pixel_of.try_inverse()?, pixel_of })
    }

    /// Returns the point of the camera's own image, px, at which the light of pixel (`u`, `v`) of the
    /// rectified image fell; not a number for a ray that cannot reach the camera.
    pub fn source(&self, u: f64, v: f64) -> (f64, f64) {
        let ray = self.ray_of * Vector3::new(u, v, 1.0);
        if ray.z <= 0.0 {
            return (f64::NAN, f64::NAN);
        }
        let (x, y) = self.distorted(ray.x / ray.z, ray.y / ray.z);
        let k = &self.matrix;
        (k[(0, 0)] * x + k[(0, 1)] * y + k[(0, 2)], k[(1, 1)] * y + k[(1, 2)])
    }

    /// Returns the place of pixel (`u`, `v`) of the camera's own image in the rectified one, px; none where
    /// the distortion has no inverse there.
    pub fn rectified(&self, u: f64, v: f64) -> Option<(f64, f64)> {
        let k = &self.matrix;
        let y0 = (v - k[(1, 2)]) / k[(1, 1)];
        let x0 = (u - k[(0, 2)] - k[(0, 1)] * y0) / k[(0, 0)];
        let (mut x, mut y) = (x0, y0);
        for _ in 0..60 {
            let (dx, dy) = self.distorted(x, y);
            (x, y) = (x + x0 - dx, y + y0 - dy);
        }
        let (dx, dy) = self.distorted(x, y);
        let error_px = ((dx - x0) * k[(0, 0)]).hypot((dy - y0) * k[(1, 1)]);
        let to = self.pixel_of * Vector3::new(x, y, 1.0);
        (error_px < 1e-6 && to.z > 0.0).then(|| (to.x / to.z, to.y / to.z))
    }

    /// The direction behind the lens of a ray with this direction before it, both as x/z and y/z.
    fn distorted(&self, x: f64, y: f64) -> (f64, f64) {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion;
        let (r2, xy) = (x * x + y * y, 2.0 * x * y);
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        (x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy)
    }
}
