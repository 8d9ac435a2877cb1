//! The calibration of a stereo camera, read from the JSON that `calibrate.py` writes, checked whole.
//!
//! Invariant: a `Calibration` that exists can rectify: focal lengths are those of cameras, rotations are
//! rotations, both new projections have the same rows, the baseline is not zero, every number is finite.

use std::fmt;
use std::path::{Path, PathBuf};

use nalgebra::Matrix3;
use serde::Deserialize;

use crate::camera::Camera;

/// Value of the key `format` of a calibration file.
pub const FORMAT: &str = "trocar-stereo-calibration";
/// Widest and highest image.
const MAX_SIDE: usize = 16_384;
/// Largest distance of R·Rᵀ from one, per entry.
const ROTATION_ERROR: f64 = 1e-6;
/// Shortest focal length, px.
const LEAST_FOCAL_PX: f64 = 1e-3;
/// Largest of all numbers: beyond it products overflow, and no camera has it.
const LARGEST: f64 = 1e9;
/// Largest difference of numbers that must be equal in both projections, as a part of the focal length.
const UNEQUAL: f64 = 1e-6;

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
    /// Column of the right principal point less that of the left one, px: depth = focal · baseline /
    /// (disparity + offset).
    pub offset_px: f64,
}

impl Calibration {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// The file cannot be read, is not such JSON, or [cannot be a calibration](CalibrationError); each error
    /// names the file.
    pub fn load(path: &Path) -> Result<Self, CalibrationError> {
        let text = std::fs::read_to_string(path)
            .map_err(|why| CalibrationError::Unreadable { path: path.into(), why: why.to_string() })?;
        Calibration::parse(&text)
            .map_err(|why| CalibrationError::File { path: path.into(), why: Box::new(why) })
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
        let differ = differences(&file.left.projection, &file.right.projection);
        if !differ.is_empty() {
            return Err(CalibrationError::Projections { differ });
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

/// Numbers in which both projections differ and must not: the name of each, and its left and right value.
/// Only the columns of the principal points and of the cameras may differ.
fn differences(left: &[[f64; 4]; 3], right: &[[f64; 4]; 3]) -> Vec<(&'static str, f64, f64)> {
    let shared = [("fx", 0, 0), ("skew", 0, 1), ("fy", 1, 1), ("cy", 1, 2), ("row of the camera", 1, 3)];
    shared
        .into_iter()
        .map(|(name, row, column)| (name, left[row][column], right[row][column]))
        .filter(|(_, l, r)| (l - r).abs() > UNEQUAL * left[0][0])
        .collect()
}

/// A mistake in a camera: the key, and why.
type Wrong = (&'static str, String);

fn camera(side: &'static str, from: &Side) -> Result<Camera, CalibrationError> {
    made(side, from).map_err(|(key, why)| CalibrationError::Camera { side, key, why })
}

fn made(side: &str, from: &Side) -> Result<Camera, Wrong> {
    numbers_are_sane(from)?;
    let count = from.distortion.len();
    if ![4, 5, 8].contains(&count) {
        let why = format!("{count} numbers; give 4 (k1 k2 p1 p2), 5 (and k3) or 8 (and k4 k5 k6)");
        return Err(("distortion", why));
    }
    let matrix = |m: &[[f64; 3]; 3]| Matrix3::from_fn(|r, c| m[r][c]);
    let [k, r] = [matrix(&from.matrix), matrix(&from.rectification)];
    let p = Matrix3::from_fn(|row, column| from.projection[row][column]);
    is_of_a_lens("matrix", &k)?;
    is_of_a_lens("projection", &p)?;
    stands_beside_the_left_one(side, from)?;
    is_rotation("rectification", &r)?;
    let mut distortion = [0.0; 8];
    distortion[..count].copy_from_slice(&from.distortion);
    Camera::new(k, distortion, r, p).ok_or_else(|| ("projection", "it is singular".into()))
}

/// All numbers are finite and not huge.
fn numbers_are_sane(from: &Side) -> Result<(), Wrong> {
    let numbers: [(&'static str, Vec<f64>); 4] = [
        ("matrix", from.matrix.concat()),
        ("distortion", from.distortion.clone()),
        ("rectification", from.rectification.concat()),
        ("projection", from.projection.concat()),
    ];
    for (key, values) in numbers {
        if let Some((n, value)) = values.iter().enumerate().find(|(_, v)| !(-LARGEST..=LARGEST).contains(*v))
        {
            let why = format!("number {n} is {value:e}, not between -{LARGEST:e} and {LARGEST:e}");
            return Err((key, why));
        }
    }
    Ok(())
}

/// The matrix has focal lengths, px, a principal point and nothing else.
fn is_of_a_lens(key: &'static str, m: &Matrix3<f64>) -> Result<(), Wrong> {
    let (x, y, least) = (m[(0, 0)], m[(1, 1)], LEAST_FOCAL_PX);
    if x < least || y < least {
        let why = format!("focal lengths {x} and {y} px are not both at least {least} px: it is singular");
        return Err((key, why));
    }
    let lower = [m[(1, 0)], m[(2, 0)], m[(2, 1)], m[(2, 2)] - 1.0];
    if lower.iter().any(|v| v.abs() > 1e-9) {
        return Err((key, "it is not of the form f 0 c, 0 f c, 0 0 1".into()));
    }
    Ok(())
}

/// Rectified images share the axes of the left camera: its column is 0, and no camera stands in front of the
/// other.
fn stands_beside_the_left_one(side: &str, from: &Side) -> Result<(), Wrong> {
    let (x, z) = (from.projection[0][3], from.projection[2][3]);
    if z != 0.0 || (side == "left" && x != 0.0) {
        let why = format!(
            "its last column, {x} and {z}, says another place than beside the left camera: calibrate again"
        );
        return Err(("projection", why));
    }
    Ok(())
}

fn is_rotation(key: &'static str, r: &Matrix3<f64>) -> Result<(), Wrong> {
    let error = (r * r.transpose() - Matrix3::identity()).abs().max();
    let determinant = r.determinant();
    if error > ROTATION_ERROR || determinant < 0.0 {
        let why =
            format!("it is no rotation: R·Rᵀ is {error:e} from one, its determinant is {determinant:.6}");
        return Err((key, why));
    }
    Ok(())
}

/// Why a calibration is not used.
#[derive(Clone, Debug, PartialEq)]
pub enum CalibrationError {
    /// No such file, or no right to read it.
    Unreadable {
        /// The path as it was given.
        path: PathBuf,
        /// The sentence of the system.
        why: String,
    },
    /// Not JSON, or a key is missing or of another type.
    Json {
        /// The sentence of the reader, with line and column.
        why: String,
    },
    /// Another kind of file, or a newer one.
    Version {
        /// The format that the file says it has.
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
        /// The reason why it cannot be.
        why: String,
    },
    /// A file was read, and cannot be used.
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        why: Box<CalibrationError>,
    },
    /// The rectified images would not have one scale, or what lies in a row of one would not lie in the same
    /// row of the other.
    Projections {
        /// Numbers that must be equal and are not: name, left and right projection, px.
        differ: Vec<(&'static str, f64, f64)>,
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
            CalibrationError::File { path, why } => write!(f, "{}: {why}", path.display()),
            CalibrationError::Projections { differ } => {
                write!(f, "projection: left and right must be equal in")?;
                for (n, (name, left, right)) in differ.iter().enumerate() {
                    let comma = if n == 0 { "" } else { "," };
                    write!(f, "{comma} {name} ({left} and {right} px)")?;
                }
                write!(f, ", or rows of the rectified images do not agree: calibrate again")
            }
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
