//! `crop`: a part of each image.
//!
//! Invariant: the part has the configured size and lies in the image whole, or the frame is left out.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::view::{Format, Shape};

#[derive(Config)]
struct CropConfig {
    /// First column of the part
    #[config(live, min = 0, max = 16383, unit = "px", default = 0)]
    x: usize,
    /// First row of the part
    #[config(live, min = 0, max = 16383, unit = "px", default = 0)]
    y: usize,
    /// Columns of the part
    #[config(min = 1, max = 16384, unit = "px", default = 640)]
    width: usize,
    /// Rows of the part
    #[config(min = 1, max = 16384, unit = "px", default = 480)]
    height: usize,
}

/// Cuts the same part out of both images.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Crop {
    /// Stereo frames, RGB8 or GRAY8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The part of both images
    #[output]
    part: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: CropConfig,
    /// Bytes of the output's frames.
    reserved: usize,
}

impl Component for Crop {
    fn configure(&mut self) -> Result {
        let CropConfig { width, height, .. } = self.cfg;
        pair::reserve(&mut self.part, &mut self.reserved, Shape { width, height, format: Format::Rgb8 })
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        pair::each(&mut self.image, &mut self.tally, |frame| filter(&frame, &mut self.part, &self.cfg));
        Ok(())
    }
}

fn filter(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    cfg: &CropConfig,
) -> Result<(), Unfit> {
    let source = pair::images(frame)?;
    let from = source[0].shape();
    let CropConfig { x, y, width, height } = *cfg;
    if x + width > from.width || y + height > from.height {
        return Err(Unfit::Part);
    }
    let shape = Shape { width, height, format: from.format };
    let columns = x * from.format.bytes()..(x + width) * from.format.bytes();
    let mut loan = out.loan()?;
    for (from, to) in source.iter().zip(&mut pair::blank(&mut loan, frame.header(), shape)?) {
        for n in 0..height {
            to.row_mut(n).copy_from_slice(&from.row(y + n)[columns.clone()]);
        }
    }
    loan.commit(2 * shape.packed_bytes(), frame.stamp());
    Ok(())
}
