//! The component `picture_writer`: the newest frame of a video as a file, whenever it is asked for one.
//!
//! Invariant: frames pass without being copied; only `save` copies, the one frame that it writes.

use trocar_imaging::pixels::{Part, rgb};
use trocar_sdk::data::{ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use crate::depth_map::{self, Settings};
use crate::file::{self, Picture, SaveRequest, SavedPicture};
use crate::saving::Saving;

#[derive(Config)]
struct PictureWriterConfig {
    /// Which images of a pair are written: both side by side, or one
    #[config(live, one_of = ["both", "left", "right"], default = "both")]
    part: String,
    /// Plane that pictures of depth count from, as distance from the cameras; none: the median of the frame
    #[config(live, unit = "m", default = None)]
    plane_m: Option<f64>,
    /// First and last colour of pictures of depth, counted from that plane; nothing: the frame decides
    #[config(live, unit = "m", default = [])]
    depth_range_m: Vec<f64>,
}

/// Writes the newest frame to a PNG file when asked to. Depth becomes colours with a bar in µm beside a
/// plane: near is bright, far is dark, unknown is hatched. Disparity becomes colours over the range of the
/// frame: near is red, far is blue, unknown is black.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"), max_step_ms = 10_000)]
pub struct PictureWriter {
    /// Pairs
    #[input(optional)]
    frame: In<Frame<StereoHeader>>,
    /// Single images; of both inputs the frame with the later stamp is written
    #[input(optional)]
    picture: In<Frame<ImageHeader>>,
    /// Frames seen since Start.
    #[state]
    frames: u64,
    /// Files written since Start.
    #[state]
    saved: u64,
    #[config]
    cfg: PictureWriterConfig,
    #[host]
    host: Host,
    saving: Saving,
}

#[provides("ctl")]
impl PictureWriter {
    /// Writes the newest frame to a new file, and answers when that is there.
    #[command]
    fn save(&mut self, request: &SaveRequest) -> Result<SavedPicture> {
        let path = file::named(&request.path)?;
        let (header, bytes, stamp) = self.newest().ok_or(
            "no frame has come yet: connect `frame` or `picture`, start what sends them, and ask again",
        )?;
        let part = Part::ALL.into_iter().find(|part| part.name() == self.cfg.part).unwrap_or(Part::Both);
        let age = self.host.now().seconds_since(stamp);
        let name = self.host.instance_name().rsplit('/').next().unwrap_or_default();
        let settings = self.cfg.depth();
        let saved = self.saving.run(name, move || {
            if header.format == PixelFormat::DEPTH32F {
                let images = header.images(&bytes);
                let images = images.map_err(|why| format!("the newest frame cannot be shown: {why}"))?;
                return file::write(&path, &depth_map::draw(part.of(&header, &images), &settings));
            }
            let mut picture = Picture { width: 0, height: 0, rgb: Vec::new() };
            (picture.width, picture.height) = rgb(&header, &bytes, part, &mut picture.rgb)
                .map_err(|why| format!("the newest frame cannot be shown: {why}"))?;
            file::write(&path, &picture)
        })?;
        self.saved += 1;
        Ok(SavedPicture { age, ..saved })
    }
}

impl PictureWriter {
    /// A copy of the newest frame of both inputs, and its stamp.
    fn newest(&mut self) -> Option<(StereoHeader, Vec<u8>, Stamp)> {
        let pair = self.frame.latest();
        let single = self.picture.latest();
        let later = single.as_ref().map(|frame| frame.stamp()) > pair.as_ref().map(|frame| frame.stamp());
        match (pair, single) {
            (Some(frame), single) if single.is_none() || !later => {
                Some((*frame.header(), frame.bytes().to_vec(), frame.stamp()))
            }
            (_, Some(frame)) => Some((one_for_both(frame.header()), frame.bytes().to_vec(), frame.stamp())),
            (_, None) => None,
        }
    }
}

/// A single image as a pair: it is for both eyes.
fn one_for_both(of: &ImageHeader) -> StereoHeader {
    let ImageHeader { stamp, index, width, height, stride, format } = *of;
    StereoHeader { stamp, index, width, height, stride, format, right_offset: 0 }
}

impl PictureWriterConfig {
    /// Settings of depth images.
    fn depth(&self) -> Settings {
        let range_m = self.depth_range_m.first_chunk().copied();
        Settings { plane_m: self.plane_m, range_m }
    }

    /// # Errors
    /// `depth_range_m` is no range.
    fn check(&self) -> Result<(), String> {
        match self.depth_range_m[..] {
            [] => Ok(()),
            [near, far] if near.is_finite() && far.is_finite() && far - near >= 1e-6 => Ok(()),
            _ => Err(format!(
                "depth_range_m: {:?} is no range: give two numbers, the second at least 1e-6 m above the first, or none",
                self.depth_range_m
            )),
        }
    }
}

impl Component for PictureWriter {
    fn configure(&mut self) -> Result {
        if self.cfg.plane_m.is_some_and(|plane_m| !plane_m.is_finite()) {
            return Err("plane_m: not a finite number: give the distance of the plane in m".into());
        }
        Ok(self.cfg.check()?)
    }

    fn start(&mut self) -> Result {
        (self.frames, self.saved) = (0, 0);
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.saving = Saving::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        self.frames += u64::from(self.frame.fresh().is_some()) + u64::from(self.picture.fresh().is_some());
        Ok(())
    }
}

#[cfg(test)]
#[path = "picture_writer_tests.rs"]
mod tests;
