//! The scenery of one camera in one picture: the eye where it stands, the tool, the lamp.
//!
//! Invariant: the same for all rows of a picture.

use nalgebra::{Point3, Vector3};

use crate::backdrop::{Backdrop, Warp};
use crate::camera::{Tool, WORKING_DISTANCE_M};
use crate::lamp::Lamp;

pub(crate) struct Scenery<'a> {
    pub(crate) eye: &'a Backdrop,
    pub(crate) lamp: &'a Lamp,
    pub(crate) tool: &'a Tool,
    /// The tool's core, the tip's end first.
    pub(crate) core: [Point3<f64>; 2],
    pub(crate) warp: Warp,
    /// Distance of the eye from its place at rest, m.
    pub(crate) shift: Vector3<f64>,
}

/// A row of pixels, and how far away the retina is there.
pub(crate) struct Line<'a> {
    scenery: &'a Scenery<'a>,
    from: Point3<f64>,
    rays: &'a [[f32; 2]],
    /// At rest, m.
    depths: &'a [f32],
}

impl<'a> Scenery<'a> {
    /// Row `y`, or the last one.
    pub(crate) fn line(&'a self, y: usize) -> Line<'a> {
        let Backdrop { camera, width, rays, depth, .. } = self.eye;
        let y = y.min(camera.height - 1);
        let row = self.warp.nearest_row(y);
        Line {
            scenery: self,
            from: camera.eye(),
            rays: &rays[y * camera.width..(y + 1) * camera.width],
            depths: &depth[row * width..(row + 1) * width],
        }
    }

    /// Pixels that a part of the tool's radius takes on the retina, at least 1.
    pub(crate) fn pixels_of_radius(&self, part: f64) -> usize {
        let radius_px = self.eye.camera.focal_px * self.tool.radius_m / WORKING_DISTANCE_M;
        ((part * radius_px) as usize).max(1)
    }
}

impl Line<'_> {
    /// Direction of the ray through column `x`, one long along the camera's axis.
    pub(crate) fn way(&self, x: usize) -> Vector3<f64> {
        let [rx, ry] = self.rays[x];
        self.scenery.eye.turn * Vector3::new(f64::from(rx), f64::from(ry), 1.0)
    }

    /// Returns the point of the retina that column `x` shows; `at_rest` is the column of the picture at rest
    /// that is nearest to its place.
    pub(crate) fn at(&self, x: usize, at_rest: usize) -> Point3<f64> {
        let depth = f64::from(self.depths[at_rest]) + self.scenery.shift.z;
        self.from + self.way(x) * depth
    }

    pub(crate) fn from(&self) -> &Point3<f64> {
        &self.from
    }
}
