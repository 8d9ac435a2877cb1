//! The calibration of a stereo camera, read from the JSON that `calibrate.py` writes, checked whole.
//!
//! Invariant: a `Calibration` that exists can rectify: focal lengths are positive, rotations are rotations, the new
//! projections are not singular, the baseline is not zero, every number is finite.

use std::fmt;
use std::path::{Path, PathBuf};

use nalgebra::Matrix3;
use serde::Deserialize;

use crate::camera::Camera;

/// Value of the key `format` of a calibration file.
pub const FORMAT: &str = "trocar-stereo-calibration";
/// Widest and highest image.
const MAX_SIDE: usize = 16_384;
/// How far R·Rᵀ may be from one, per entry.
const ROTATION_ERROR: f64 = 1e-6;

/// Both cameras and what rectified images of them measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Width of an image of either camera, and of a rectified one, px.
    pub width: usize,
    /// Its height, px.
    pub height: usize,
    /// Left camera, then right one.
    pub cameras: [Camera; 2],
    /// Focal length of the rectified images, px.
    pub focal_px: f64,
    /// From the left to the right camera, m.
    pub baseline_m: f64,
    /// Column of the right principal point less that of the left one, px: depth = focal · baseline / (disparity + offset).
    pub offset_px: f64,
}

impl Calibration {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// It cannot be read, is not such JSON, or [what it says](CalibrationError) cannot be.
    pub fn load(path: &Path) -> Result<Self, CalibrationError> {
        let text = std::fs::read_to_string(path)
            .map_err(|why| CalibrationError::Unreadable { path: path.into(), why: why.to_string() })?;
        Calibration::parse(&text)
    }

    /// Checks the text of a file.
    ///
    /// # Errors
    /// As [`Calibration::load`].
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let file: File =
            serde_json::from_str(text).map_err(|why| CalibrationError::Json { why: why.to_string() })?;
        if file.format != FORMAT || file.version != 1 {
            return Err(CalibrationError::Version { format: file.format, version: file.version });
        }
        let [width, height] = file.image_size;
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return Err(CalibrationError::Size { width, height });
        }
        let left = camera("left", &file.left)?;
        let right = camera("right", &file.right)?;
        let focal_px = file.left.projection[0][0];
        let other = file.right.projection[0][0];
        if (other - focal_px).abs() > 1e-6 * focal_px {
            return Err(CalibrationError::Focal { left: focal_px, right: other });
        }
        let baseline_m = -file.right.projection[0][3] / focal_px;
        if baseline_m.is_nan() || baseline_m <= 0.0 {
            return Err(CalibrationError::Baseline { baseline_m });
        }
        let offset_px = file.right.projection[0][2] - file.left.projection[0][2];
        Ok(Calibration { width, height, cameras: [left, right], focal_px, baseline_m, offset_px })
    }
}

/// The file; what else it holds (errors of the fit, who made it) is for people.
#[derive(Deserialize)]
struct File {
    format: String,
    version: u32,
    image_size: [usize; 2],
    left: Side,
    right: Side,
}

#[derive(Deserialize)]
struct Side {
    /// fx 0 cx, 0 fy cy, 0 0 1, px.
    matrix: [[f64; 3]; 3],
    /// k1 k2 p1 p2 [k3 [k4 k5 k6]].
    distortion: Vec<f64>,
    /// From the camera's axes to those of the rectified one.
    rectification: [[f64; 3]; 3],
    /// f 0 cx −f·baseline, 0 f cy 0, 0 0 1 0; px, the last column px·m.
    projection: [[f64; 4]; 3],
}

fn camera(side: &'static str, from: &Side) -> Result<Camera, CalibrationError> {
    let bad = |key, why: String| CalibrationError::Camera { side, key, why };
    let numbers: [(&'static str, Vec<f64>); 4] = [
        ("matrix", from.matrix.concat()),
        ("distortion", from.distortion.clone()),
        ("rectification", from.rectification.concat()),
        ("projection", from.projection.concat()),
    ];
    for (key, values) in numbers {
        if let Some(n) = values.iter().position(|v| !v.is_finite()) {
            return Err(bad(key, format!("number {n} is {}, not finite", values[n])));
        }
    }
    if ![4, 5, 8].contains(&from.distortion.len()) {
        return Err(bad(
            "distortion",
            format!(
                "{} numbers; give 4 (k1 k2 p1 p2), 5 (and k3) or 8 (and k4 k5 k6)",
                from.distortion.len()
            ),
        ));
    }
    let matrix = |m: &[[f64; 3]; 3]| Matrix3::from_fn(|r, c| m[r][c]);
    let [k, r] = [matrix(&from.matrix), matrix(&from.rectification)];
    let p = Matrix3::from_fn(|row, column| from.projection[row][column]);
    for (key, m) in [("matrix", &k), ("projection", &p)] {
        if m[(0, 0)] <= 0.0 || m[(1, 1)] <= 0.0 {
            let (x, y) = (m[(0, 0)], m[(1, 1)]);
            return Err(bad(
                key,
                format!("focal lengths {x} and {y} px are not both above 0: it is singular"),
            ));
        }
        let lower = [m[(1, 0)], m[(2, 0)], m[(2, 1)], m[(2, 2)] - 1.0];
        if lower.iter().any(|v| v.abs() > 1e-9) {
            return Err(bad(key, "it is not of the form f 0 c, 0 f c, 0 0 1".into()));
        }
    }
    let error = (r * r.transpose() - Matrix3::identity()).abs().max();
    if error > ROTATION_ERROR || r.determinant() < 0.0 {
        return Err(bad(
            "rectification",
            format!(
                "it is no rotation: R·Rᵀ is {error:e} from one, its determinant is {:.6}",
                r.determinant()
            ),
        ));
    }
    let mut distortion = [0.0; 8];
    distortion[..from.distortion.len()].copy_from_slice(&from.distortion);
    Camera::new(k, distortion, r, p).ok_or_else(|| bad("projection", "it is singular".into()))
}

/// Why a calibration is not used.
#[derive(Clone, Debug, PartialEq)]
pub enum CalibrationError {
    /// No such file, or no right to read it.
    Unreadable {
        /// What was asked.
        path: PathBuf,
        /// What the system said.
        why: String,
    },
    /// Not JSON, or a key is missing or of another type.
    Json {
        /// What the reader said, with line and column.
        why: String,
    },
    /// Another kind of file, or a newer one.
    Version {
        /// What it says it is.
        format: String,
        /// And its version.
        version: u32,
    },
    /// Images without pixels, or beyond what a header can say.
    Size {
        /// px.
        width: usize,
        /// px.
        height: usize,
    },
    /// Something of one camera cannot be.
    Camera {
        /// `left` or `right`.
        side: &'static str,
        /// Which of its keys.
        key: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// The rectified images would not have one scale.
    Focal {
        /// px.
        left: f64,
        /// px.
        right: f64,
    },
    /// Cameras in one place see no depth; a negative one is left and right swapped.
    Baseline {
        /// m.
        baseline_m: f64,
    },
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CalibrationError::Unreadable { path, why } => {
                write!(f, "{}: cannot be read: {why}; make one with calibrate.py", path.display())
            }
            CalibrationError::Json { why } => {
                write!(f, "no calibration: {why}; make one with calibrate.py")
            }
            CalibrationError::Version { format, version } => {
                write!(
                    f,
                    "it is \"{format}\" version {version}, not \"{FORMAT}\" version 1: make one with calibrate.py"
                )
            }
            CalibrationError::Size { width, height } => {
                write!(f, "image_size: {width} × {height} px is outside of 1 to {MAX_SIDE} px a side")
            }
            CalibrationError::Camera { side, key, why } => write!(f, "{side}.{key}: {why}"),
            CalibrationError::Focal { left, right } => write!(
                f,
                "projection: the focal lengths of the rectified images, {left} and {right} px, must be equal"
            ),
            CalibrationError::Baseline { baseline_m } => write!(
                f,
                "right.projection: a baseline of {baseline_m} m is not above 0: the cameras stand in one place, or left \
                 and right are swapped"
            ),
        }
    }
}

impl std::error::Error for CalibrationError {}

#[cfg(test)]
#[path = "calibration_tests.rs"]
mod tests;
