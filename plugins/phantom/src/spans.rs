//! Parts of a picture in which something may be that a line runs through: a tool, its shadow.
//!
//! Invariant: columns are marked generously and never too few; a row that is not marked has nothing of it.

use std::ops::Range;

use nalgebra::Point3;

use crate::camera::{Camera, Tool};
use crate::defocus;

/// Points along the tool that say where in the picture it lies.
pub(crate) const POINTS: usize = 64;

/// Columns of each row in which something may be.
pub(crate) struct Spans {
    pub(crate) rows: Vec<(u32, u32)>,
    width: usize,
}

impl Spans {
    pub(crate) fn new(height: usize) -> Spans {
        Spans { rows: vec![(0, 0); height], width: 0 }
    }

    pub(crate) fn of(&self, y: usize) -> Range<usize> {
        self.rows.get(y).map_or(0..0, |(from, to)| *from as usize..*to as usize)
    }

    /// Columns in which something may be in any of some rows.
    pub(crate) fn of_rows(&self, rows: Range<usize>) -> Range<usize> {
        let rows = rows.start.min(self.rows.len())..rows.end.min(self.rows.len());
        let marked = self.rows[rows].iter().filter(|(from, to)| from < to);
        let all = marked.copied().reduce(|one, other| (one.0.min(other.0), one.1.max(other.1)));
        all.map_or(0..0, |(from, to)| from as usize..to as usize)
    }

    pub(crate) fn clear(&mut self) {
        self.rows.fill((0, 0));
    }

    pub(crate) fn mark_tool(&mut self, camera: &Camera, tool: Option<&Tool>) {
        self.clear();
        let Some(tool) = tool else { return };
        let [front, back] = tool.core();
        let long_m = (back - front).norm();
        let points = (0..POINTS).map(|n| {
            let along = n as f64 / (POINTS - 1) as f64;
            let radius_m = tool.radius_at(along * long_m);
            let at = front + (back - front) * along;
            (at, radius_m + defocus::edge_px(camera, at.z) * -camera.eye().z / camera.focal_px)
        });
        self.mark(camera, points);
    }

    /// Marks what lies within a radius (m) of a line through points (m, world), one after the other.
    pub(crate) fn mark(&mut self, camera: &Camera, points: impl Iterator<Item = (Point3<f64>, f64)>) {
        self.width = camera.width;
        let mut before: Option<[f64; 3]> = None;
        for (point, radius) in points {
            let Some(([u, v], depth)) = camera.project(&point) else { break };
            // A tenth and two pixels more: a ball looks larger from near, and lenses bend.
            let now = [u, v, 1.1 * camera.focal_px * radius / depth + 2.0];
            let [u0, v0, r0] = before.unwrap_or(now);
            let [lowest, highest] = [(v - now[2]).min(v0 - r0), (v + now[2]).max(v0 + r0)];
            let [from, to] = [(u - now[2]).min(u0 - r0), (u + now[2]).max(u0 + r0)];
            before = Some(now);
            let inside = |at: f64, size: usize| at.clamp(0.0, size as f64) as usize;
            let (from, to) = (inside(from.floor(), self.width), inside(to.ceil() + 1.0, self.width));
            if from >= to {
                continue;
            }
            let height = self.rows.len();
            for row in &mut self.rows[inside(lowest.floor(), height)..inside(highest.ceil() + 1.0, height)] {
                let (start, end) = *row;
                let empty = start >= end;
                *row = if empty {
                    (from as u32, to as u32)
                } else {
                    (start.min(from as u32), end.max(to as u32))
                };
            }
        }
    }
}
