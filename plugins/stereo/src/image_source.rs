//! `image_source`: plays stereo pairs of a folder, again and again, at the rate of its execution.
//!
//! Invariant: an index is used up whether or not its pair could be sent, so a reader sees every pair that is
//! missing.

use std::path::Path;

use trocar_sdk::data::{CameraGeometry, PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use crate::pairs::{Format, Pairs, Want};

/// Frames of the output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 6;

#[derive(Config)]
pub(crate) struct ImageSourceConfig {
    /// Folder with left*/right* PNG or JPEG files, read when configured; relative to the directory the host
    /// runs in
    directory: String,
    /// `as_stored` is GRAY8 when every file is grey, else RGB8
    #[config(one_of = ["as_stored", "rgb8"], default = "as_stored")]
    format: String,
}

/// Plays the stereo pairs of a folder in the order of their names, from the first again after the last.
#[derive(Component)]
#[component(model = "stream", rate_hz = 30, safety = "sensor")]
pub struct ImageSource {
    /// One pair per step
    #[output]
    image: Out<Frame<StereoHeader>>,
    /// Pairs not sent since Start.
    #[event("camera")]
    frame_dropped: Event<u64>,
    /// Pairs sent since Start.
    #[state]
    emitted: u64,
    /// Pairs not sent since Start because readers held all frames.
    #[state]
    left_out: u64,
    /// Pairs in the folder.
    #[state]
    pairs: u64,
    #[state]
    geometry: CameraGeometry,
    #[config]
    cfg: ImageSourceConfig,
    loaded: Option<Pairs>,
}

/// Size and rate of the pairs, and what became of them.
#[provides("camera")]
impl ImageSource {
    /// Size and rate of the pairs.
    #[read]
    fn camera_geometry(s: &ImageSourceState) -> CameraGeometry {
        s.geometry
    }

    /// Pairs sent since Start.
    #[read]
    fn emitted(s: &ImageSourceState) -> u64 {
        s.emitted
    }
}

impl Component for ImageSource {
    fn configure(&mut self) -> Result {
        let want = if self.cfg.format == "rgb8" { Want::Rgb8 } else { Want::AsStored };
        let loaded =
            Pairs::load(Path::new(&self.cfg.directory), want).map_err(|why| format!("directory: {why}"))?;
        self.image.reserve(loaded.pairs[0].bytes.len(), SLOTS)?;
        self.pairs = loaded.pairs.len() as u64;
        self.geometry = CameraGeometry { width: loaded.width as u32, height: loaded.height as u32, fps: 0.0 };
        self.loaded = Some(loaded);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.emitted, self.left_out) = (0, 0);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let Some(loaded) = &self.loaded else { return Ok(()) };
        let index = self.emitted + self.left_out;
        let pair = &loaded.pairs[(index % self.pairs) as usize];
        if tick.period_s() > 0.0 {
            self.geometry.fps = 1.0 / tick.period_s();
        }
        let Ok(mut loan) = self.image.loan() else {
            self.left_out += 1;
            self.frame_dropped.emit(self.left_out);
            return Ok(());
        };
        let (format, pixel) = match loaded.format {
            Format::Gray8 => (PixelFormat::GRAY8, 1),
            Format::Rgb8 => (PixelFormat::RGB8, 3),
        };
        *loan.header_mut() = StereoHeader {
            stamp: tick.now(),
            index,
            width: loaded.width as u32,
            height: loaded.height as u32,
            stride: (loaded.width * pixel) as u32,
            format,
            right_offset: pair.bytes.len() as u64 / 2,
        };
        if let Some(room) = loan.bytes_mut().get_mut(..pair.bytes.len()) {
            room.copy_from_slice(&pair.bytes);
        }
        loan.commit(pair.bytes.len(), tick.now());
        self.emitted += 1;
        Ok(())
    }
}

#[cfg(test)]
#[path = "image_source_tests.rs"]
mod tests;
