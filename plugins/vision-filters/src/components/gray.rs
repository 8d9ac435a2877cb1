//! `gray`: colour stereo frames to brightness.
//!
//! Invariant: grey frames pass without a copy; stamps and indices are those of the source.

use trocar_sdk::FrameView;
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::gray::convert;
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

/// Makes RGB8 stereo frames GRAY8 (ITU-R BT.601); GRAY8 frames pass unchanged.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Gray {
    /// Stereo frames, RGB8 or GRAY8
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
        for _ in 0..super::BURST {
            let Some(frame) = self.image.next() else { break };
            self.tally.count(filter(&frame, &mut self.gray));
        }
        Ok(())
    }
}

fn filter(frame: &FrameView<'_, StereoHeader>, out: &mut Out<Frame<StereoHeader>>) -> Result<(), Unfit> {
    if frame.header().format == PixelFormat::GRAY8 {
        out.forward(frame);
        return Ok(());
    }
    let source = pair::images(frame)?;
    let shape = Shape { format: Format::Gray8, ..source[0].shape() };
    let mut loan = out.loan()?;
    for (from, to) in source.iter().zip(&mut pair::blank(&mut loan, frame.header(), shape)?) {
        convert(from, to);
    }
    loan.commit(2 * shape.packed_bytes(), frame.stamp());
    Ok(())
}
