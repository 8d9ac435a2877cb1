//! `color`: stereo frames from one pixel format to another.
//!
//! Invariant: frames that have the wanted format already pass without a copy; stamps and indices are those of
//! the source.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::color::{To, convert_row};
use crate::view::{Format, Shape};

#[derive(Config)]
struct ColorConfig {
    /// Pixel format of the result
    #[config(live, one_of = ["rgb8", "bgr8", "gray8"], default = "rgb8")]
    to: String,
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Converts GRAY8, RGB8, BGR8, RGBA8 and YUYV stereo frames to one format.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Color {
    /// Stereo frames, GRAY8, RGB8, BGR8, RGBA8 or YUYV
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames in the format that is configured
    #[output]
    converted: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: ColorConfig,
    /// Bytes of the output's frames.
    reserved: usize,
}

impl Component for Color {
    fn configure(&mut self) -> Result {
        let ColorConfig { max_width, max_height, .. } = self.cfg;
        let most = Shape { width: max_width as usize, height: max_height as usize, format: Format::Rgb8 };
        pair::reserve(&mut self.converted, &mut self.reserved, most)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let to = match self.cfg.to.as_str() {
            "gray8" => To::Gray8,
            "bgr8" => To::Bgr8,
            _ => To::Rgb8,
        };
        pair::each(&mut self.image, &mut self.tally, |frame| filter(&frame, &mut self.converted, to));
        Ok(())
    }
}

/// Sends the frame in another format.
pub(super) fn filter(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    to: To,
) -> Result<(), Unfit> {
    if frame.header().format == to.format() {
        return pair::forward(frame, out);
    }
    pair::convert(frame, out, to.format(), |from, y, row| convert_row(from.format(), from.row(y), to, row))
}
