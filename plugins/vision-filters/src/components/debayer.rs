//! `debayer`: the colours of a sensor with a colour filter.
//!
//! Invariant: what comes as RGB8 or GRAY8 already passes without a copy; stamps and indices are those of the
//! source.

use trocar_sdk::FrameView;
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::debayer::{neighbours, row};
use crate::view::{Format, Shape};

#[derive(Config)]
struct DebayerConfig {
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 2, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 2, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Makes BAYER_RG8 stereo frames RGB8 by bilinear interpolation; RGB8 and GRAY8 frames pass unchanged.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Debayer {
    /// Stereo frames, BAYER_RG8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames in RGB8
    #[output]
    color: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: DebayerConfig,
    /// Bytes of the output's frames.
    reserved: usize,
}

impl Component for Debayer {
    fn configure(&mut self) -> Result {
        let DebayerConfig { max_width, max_height } = self.cfg;
        let most = Shape { width: max_width as usize, height: max_height as usize, format: Format::Rgb8 };
        pair::reserve(&mut self.color, &mut self.reserved, most)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        pair::each(&mut self.image, &mut self.tally, |frame| filter(&frame, &mut self.color));
        Ok(())
    }
}

fn filter(frame: &FrameView<'_, StereoHeader>, out: &mut Out<Frame<StereoHeader>>) -> Result<(), Unfit> {
    match frame.header().format {
        PixelFormat::BAYER_RG8 => {}
        PixelFormat::RGB8 | PixelFormat::GRAY8 => return pair::forward(frame, out),
        _ => return Err(Unfit::NotBayer),
    }
    let StereoHeader { width, height, .. } = *frame.header();
    pair::raw(frame)?;
    if width < 2 || height < 2 {
        return Err(Unfit::NoPattern);
    }
    pair::convert(frame, out, PixelFormat::RGB8, |from, y, to| {
        let [above, _, below] = neighbours(height as usize, y as usize);
        row([above as u32, y, below as u32].map(|y| from.row(y)), y % 2 == 1, to);
        true
    })
}
