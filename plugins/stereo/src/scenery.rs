//! The geometry of the simulated source's cameras, as its readers need it.
//!
//! Invariant: functions of a rig alone.

use trocar_phantom::camera::{BASELINE_M, Lens, Rig};
use trocar_sdk::prelude::*;

/// The way from a disparity to a distance, and from a pixel to a direction.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct StereoGeometry {
    #[unit("px")]
    pub focal_px: f64,
    /// From the left camera to the right one.
    #[unit("m")]
    pub baseline_m: f64,
    /// Offset of a rectified pair: distance = focal_px · baseline_m / (disparity + offset_px), disparity
    /// being the left column less the right one; 0 for any other pair.
    #[unit("px")]
    pub offset_px: f64,
    /// Point where the axis meets the left image: column, row.
    #[unit("px")]
    pub centre_left_px: [f64; 2],
    /// As above, of the right image.
    #[unit("px")]
    pub centre_right_px: [f64; 2],
    /// Lens errors k1, k2, p1, p2 of both cameras, as OpenCV names them.
    pub lens: [f64; 4],
}

/// The geometry of a rig.
pub(crate) fn geometry(rig: &Rig) -> StereoGeometry {
    let [left, right] = &rig.cameras;
    let Lens { k1, k2, p1, p2 } = left.lens;
    StereoGeometry {
        focal_px: left.focal_px,
        baseline_m: BASELINE_M,
        offset_px: if rig.rectified { right.centre_px[0] - left.centre_px[0] } else { 0.0 },
        centre_left_px: left.centre_px,
        centre_right_px: right.centre_px,
        lens: [k1, k2, p1, p2],
    }
}
