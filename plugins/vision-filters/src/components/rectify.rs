//! `rectify`: takes the lens distortion out of stereo frames and turns both images so that their rows agree.
//!
//! Invariant: a calibration that cannot be used is refused by `configure`; frames of another size are left
//! out.

use std::path::Path;

use trocar_imaging::Calibration;
use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::remap::Remap;
use crate::view::{Format, Shape};

#[derive(Config)]
struct RectifyConfig {
    /// JSON file that `calibrate.py` made; relative to the directory the host runs in
    calibration: String,
}

/// Geometry of rectified images.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct RectifiedGeometry {
    /// Focal length of both images.
    #[unit("px")]
    pub focal: f64,
    /// From the left to the right camera.
    #[unit("m")]
    pub baseline: f64,
    /// Column of the right principal point less that of the left one.
    #[unit("px")]
    pub offset: f64,
}

/// Rectifies stereo frames, RGB8 or GRAY8, by the calibration of their camera.
#[derive(Component)]
#[component(model = "on_signal", provides("rectified_camera"))]
pub struct Rectify {
    /// Frames as the camera sees them
    #[input]
    image: In<Frame<StereoHeader>>,
    /// Frames whose rows agree: what lies in a row of the left image lies in the same one of the right
    #[output]
    rectified: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[state]
    geometry: RectifiedGeometry,
    #[config]
    cfg: RectifyConfig,
    /// Bytes of the output's frames.
    reserved: usize,
    /// Left, right.
    maps: Option<[Remap; 2]>,
}

#[provides("rectified_camera")]
impl Rectify {
    /// Focal length and baseline of the rectified frames.
    #[read]
    fn geometry(s: &RectifyState) -> RectifiedGeometry {
        s.geometry
    }
}

impl Component for Rectify {
    fn configure(&mut self) -> Result {
        let c = Calibration::load(Path::new(&self.cfg.calibration))
            .map_err(|why| format!("calibration: {why}"))?;
        pair::reserve(
            &mut self.rectified,
            &mut self.reserved,
            Shape { width: c.width, height: c.height, format: Format::Rgb8 },
        )?;
        let [left, right] = &c.cameras;
        self.maps =
            Some([left, right].map(|camera| Remap::new(c.width, c.height, |u, v| camera.source(u, v))));
        self.geometry = RectifiedGeometry { focal: c.focal_px, baseline: c.baseline_m, offset: c.offset_px };
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let Some(maps) = &self.maps else { return Ok(()) };
        pair::each(&mut self.image, &mut self.tally, |frame| filter(&frame, &mut self.rectified, maps));
        Ok(())
    }
}

fn filter(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    maps: &[Remap; 2],
) -> Result<(), Unfit> {
    let source = pair::images(frame)?;
    let shape = source[0].shape();
    if (shape.width, shape.height) != maps[0].size() {
        return Err(Unfit::Calibration);
    }
    let mut loan = out.loan()?;
    let mut images = pair::blank(&mut loan, frame.header(), shape)?;
    for ((from, to), map) in source.iter().zip(&mut images).zip(maps) {
        if !map.run(from, to) {
            return Err(Unfit::Calibration);
        }
    }
    loan.commit(2 * shape.packed_bytes(), frame.stamp());
    Ok(())
}
