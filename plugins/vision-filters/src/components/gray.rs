//! `gray`: colour stereo frames to brightness; `color` with one result.
//!
//! Invariant: grey frames pass without a copy; stamps and indices are those of the source.

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::color::filter;
use super::pair::{self, Tally};
use crate::color::To;
use crate::view::{Format, Shape};

#[derive(Config)]
struct GrayConfig {
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Makes stereo frames GRAY8 (ITU-R BT.601); GRAY8 frames pass unchanged.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Gray {
    /// Stereo frames, GRAY8, RGB8, BGR8, RGBA8 or YUYV
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames in GRAY8
    #[output]
    gray: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: GrayConfig,
    /// Bytes of the output's frames.
    reserved: usize,
}

impl Component for Gray {
    fn configure(&mut self) -> Result {
        let GrayConfig { max_width, max_height } = self.cfg;
        let most = Shape { width: max_width as usize, height: max_height as usize, format: Format::Gray8 };
        pair::reserve(&mut self.gray, &mut self.reserved, most)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        pair::each(&mut self.image, &mut self.tally, |frame| filter(&frame, &mut self.gray, To::Gray8));
        Ok(())
    }
}
