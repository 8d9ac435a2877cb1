//! `stereo_depth`: disparity and depth of rectified stereo frames, on a branch beside the display path.
//!
//! Invariant: only the newest frame is worked on; memory is made in `configure`, never in a step.

use std::path::Path;

use trocar_imaging::Calibration;
use trocar_sdk::FrameView;
use trocar_sdk::data::{Distance, ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use crate::disparity::Depth;
use crate::matcher::Matcher;
use crate::settings::{Method, Settings};

/// Frames of an output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 5;

#[derive(Config)]
struct StereoDepthConfig {
    /// `bm` is fast and blind where there is no texture; `sgm` is denser and slower
    #[config(live, one_of = ["bm", "sgm"], default = "sgm")]
    method: String,
    /// Disparities looked at, from 0; a multiple of 32
    #[config(live, min = 32, max = 256, unit = "px", default = 96)]
    n_disp: usize,
    /// Side of the window of `bm`; odd
    #[config(live, min = 5, max = 31, unit = "px", default = 15)]
    block: usize,
    /// Penalty of `sgm` for a step of one disparity
    #[config(live, min = 1, max = 103, default = 8)]
    p1: u8,
    /// Its penalty for a larger step; at least `p1`
    #[config(live, min = 1, max = 103, default = 40)]
    p2: u8,
    /// By how much the best disparity must be better than every other one, %; 0: not asked
    #[config(live, min = 0, max = 50, default = 10)]
    uniqueness: u8,
    /// Least contrast in the window of `bm`, 1/100 of a level per pixel
    #[config(live, min = 0, max = 3000, default = 5)]
    texture: u16,
    /// Most that left and right may disagree; -1: not compared
    #[config(live, min = -1, max = 64, unit = "px", default = 1)]
    consistency: i16,
    /// Depth is not known where the left image is darker than so many levels, and as far around as the window
    /// reaches: outside of the round field of a microscope. 0: nowhere
    #[config(live, min = 0, max = 255, default = 0)]
    dark: u8,
    /// Width of an image; frames of another one are left out
    #[config(min = 32, max = 16384, unit = "px", default = 1024)]
    width: usize,
    /// Height of an image
    #[config(min = 32, max = 16384, unit = "px", default = 768)]
    height: usize,
    /// The file that `rectify` uses, for the scale of depth; empty: the next three say it
    #[config(default = "")]
    calibration: String,
    /// Focal length of the rectified images; 0: not known, there is disparity only
    #[config(min = 0, unit = "px", default = 0.0)]
    focal_px: f64,
    /// From the left to the right camera
    #[config(min = 0, unit = "m", default = 0.0)]
    baseline_m: f64,
    /// Column of the right principal point less that of the left one
    #[config(unit = "px", default = 0.0)]
    offset_px: f64,
}

/// A pixel of the left image.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Pixel {
    /// Column.
    #[unit("px")]
    pub u: u32,
    /// Row.
    #[unit("px")]
    pub v: u32,
}

/// Finds disparity and depth of the newest rectified pair.
#[derive(Component)]
#[component(model = "on_signal", provides("map"), max_step_ms = 500)]
pub struct StereoDepth {
    /// Rectified stereo frames, RGB8 or GRAY8
    #[input]
    rectified: In<Frame<StereoHeader>>,
    /// From the left to the right image, DISPARITY16
    #[output]
    disparity: Out<Frame<ImageHeader>>,
    /// Along the optical axis of the left camera, DEPTH32F
    #[output]
    depth: Out<Frame<ImageHeader>>,
    /// Pairs worked on since Start.
    #[state]
    frames: u64,
    /// Pairs left out since Start.
    #[state]
    rejected: u64,
    /// Why the last one was left out; empty when none was.
    #[state]
    problem: Text<96>,
    /// Share of the last map's pixels with a disparity, 0 to 1.
    #[state]
    density: f64,
    #[config]
    cfg: StereoDepthConfig,
    matcher: Option<Matcher>,
    /// Pixels of the outputs' frames.
    reserved: usize,
    scale: Option<Depth>,
    /// The last map, 1/16 px.
    map: Vec<i16>,
    /// When its pair was taken; not valid before the first one.
    taken: Stamp,
}

#[provides("map")]
impl StereoDepth {
    /// Depth of a pixel of the last map, m; not valid where nothing is known.
    #[command]
    fn depth_at(&mut self, at: Pixel) -> Result<Distance> {
        let StereoDepthConfig { width, height, .. } = self.cfg;
        if at.u as usize >= width || at.v as usize >= height {
            let (u, v) = (at.u, at.v);
            return Err(format!(
                "depth_at: ({u}, {v}) px is outside of the image: u is 0 to {}, v 0 to {}",
                width - 1,
                height - 1
            )
            .into());
        }
        let Some(scale) = &self.scale else {
            return Err(
                "depth_at: the cameras are not known: configure calibration, or focal_px and baseline_m"
                    .into(),
            );
        };
        if !self.taken.is_valid() {
            return Err("depth_at: no pair has come yet: connect rectified and start the source".into());
        }
        let depth_m = self.map.get(at.v as usize * width + at.u as usize).map_or(f32::NAN, |&d| scale.of(d));
        Ok(if depth_m.is_nan() {
            Distance::default()
        } else {
            Distance {
                stamp: self.taken,
                distance: f64::from(depth_m),
                velocity: f64::NAN,
                sigma: f64::NAN,
                valid: true.into(),
                ..Distance::default()
            }
        })
    }
}

impl Component for StereoDepth {
    fn configure(&mut self) -> Result {
        // All checks that can refuse come before the first change: a refused setting leaves all as it was.
        let scale = self.cfg.scale()?;
        let StereoDepthConfig { width, height, .. } = self.cfg;
        let settings = self.cfg.settings();
        if !self.matcher.as_ref().is_some_and(|m| m.size() == (width, height) && *m.settings() == settings) {
            self.matcher = Some(Matcher::new(width, height, settings)?);
        }
        self.scale = scale;
        let pixels = width * height;
        if self.reserved != pixels {
            self.disparity.reserve(2 * pixels, SLOTS)?;
            self.depth.reserve(4 * pixels, SLOTS)?;
            self.map = vec![crate::NONE; pixels];
            (self.reserved, self.taken) = (pixels, Stamp::default());
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.frames, self.rejected, self.density) = (0, 0, 0.0);
        (self.problem, self.taken) = (Text::default(), Stamp::default());
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let Some(frame) = self.rectified.fresh() else { return Ok(()) };
        let Some(matcher) = &mut self.matcher else { return Ok(()) };
        match work(&frame, matcher, &mut self.map) {
            Ok(()) => {
                self.taken = frame.stamp();
                self.density = share_known(&self.map);
                let sent =
                    send_disparity(&frame, &self.map, &mut self.disparity).and_then(|()| match &self.scale {
                        Some(scale) => send_depth(&frame, &self.map, scale, &mut self.depth),
                        None => Ok(()),
                    });
                match sent {
                    Ok(()) => self.frames += 1,
                    Err(NoFrame(_)) => {
                        self.rejected += 1;
                        self.problem = Text::new(
                            "all frames of an output are held by readers: let fewer or faster ones read",
                        );
                    }
                }
            }
            Err(why) => {
                self.rejected += 1;
                self.problem = Text::new(why);
            }
        }
        Ok(())
    }
}

fn work(
    frame: &FrameView<'_, StereoHeader>,
    matcher: &mut Matcher,
    map: &mut [i16],
) -> Result<(), &'static str> {
    if ![PixelFormat::GRAY8, PixelFormat::RGB8].contains(&frame.header().format) {
        return Err("pixel format is not GRAY8 or RGB8: convert it before");
    }
    let Ok([left, right]) = frame.images() else {
        return Err("size, stride or right_offset do not fit the bytes: repair the source");
    };
    if matcher.run(&left, &right, map) {
        Ok(())
    } else {
        Err("not width x height: configure the size that comes")
    }
}

fn share_known(map: &[i16]) -> f64 {
    // Counted row by row of 256 in small numbers, which the compiler adds up in vectors.
    let known: usize = map.chunks(256).map(|row| row.iter().filter(|&&d| d >= 0).count()).sum();
    known as f64 / map.len().max(1) as f64
}

fn header(of: &StereoHeader, format: PixelFormat) -> ImageHeader {
    let StereoHeader { stamp, index, width, height, .. } = *of;
    ImageHeader { stamp, index, width, height, stride: width * format.bytes_per_pixel() as u32, format }
}

fn send_disparity(
    of: &FrameView<'_, StereoHeader>,
    map: &[i16],
    out: &mut Out<Frame<ImageHeader>>,
) -> Result<(), NoFrame> {
    let mut loan = out.loan()?;
    *loan.header_mut() = header(of.header(), PixelFormat::DISPARITY16);
    let to = loan.bytes_mut().as_chunks_mut::<2>().0;
    to.iter_mut().zip(map).for_each(|(to, d)| *to = d.to_ne_bytes());
    loan.commit(2 * map.len(), of.stamp());
    Ok(())
}

fn send_depth(
    of: &FrameView<'_, StereoHeader>,
    map: &[i16],
    scale: &Depth,
    out: &mut Out<Frame<ImageHeader>>,
) -> Result<(), NoFrame> {
    let mut loan = out.loan()?;
    *loan.header_mut() = header(of.header(), PixelFormat::DEPTH32F);
    let to = loan.bytes_mut().as_chunks_mut::<4>().0;
    to.iter_mut().zip(map).for_each(|(to, &d)| *to = scale.of(d).to_ne_bytes());
    loan.commit(4 * map.len(), of.stamp());
    Ok(())
}

impl StereoDepthConfig {
    fn settings(&self) -> Settings {
        let Self { n_disp, block, p1, p2, uniqueness, texture, consistency, dark, .. } = *self;
        let method = if self.method == "bm" { Method::Bm } else { Method::Sgm };
        Settings { method, n_disp, block, p1, p2, uniqueness, texture, consistency, dark }
    }

    /// The depth of a disparity, when the cameras are known.
    fn scale(&self) -> Result<Option<Depth>> {
        let Self { focal_px, baseline_m, offset_px, n_disp, width, height, .. } = *self;
        if self.calibration.is_empty() {
            return match (focal_px > 0.0, baseline_m > 0.0) {
                (true, true) => Ok(Some(Depth::new(n_disp, focal_px, baseline_m, offset_px))),
                (false, false) => Ok(None),
                _ => Err(format!(
                    "focal_px: {focal_px} px and baseline_m: {baseline_m} m: depth needs both above 0; give both, or \
                     neither for disparity only"
                )
                .into()),
            };
        }
        if focal_px != 0.0 || baseline_m != 0.0 || offset_px != 0.0 {
            return Err(
                "calibration: it says focal_px, baseline_m and offset_px, too: give one or the other".into(),
            );
        }
        let c =
            Calibration::load(Path::new(&self.calibration)).map_err(|why| format!("calibration: {why}"))?;
        if (c.width, c.height) != (width, height) {
            return Err(format!(
                "calibration: it is of images of {} × {} px, and width and height say {width} × {height}: set them to \
                 the calibration's, or calibrate at this size",
                c.width, c.height
            )
            .into());
        }
        Ok(Some(Depth::new(n_disp, c.focal_px, c.baseline_m, c.offset_px)))
    }
}

#[cfg(test)]
#[path = "component_tests.rs"]
mod tests;
