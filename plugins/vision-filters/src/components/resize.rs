//! `resize`: stereo frames to a set size.
//!
//! Invariant: a step allocates nothing, whatever size comes.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::resize::{Method, Resizer};
use crate::view::{Format, Shape};

/// Longest side of an image that is brought to another size, px.
const MAX_SIDE: usize = 16_384;

#[derive(Config)]
struct ResizeConfig {
    /// Width of the result
    #[config(min = 1, max = 16384, unit = "px", default = 160)]
    width: u32,
    /// Height of the result
    #[config(min = 1, max = 16384, unit = "px", default = 120)]
    height: u32,
    /// `area` is the mean of what a pixel covers, for shrinking; `bilinear` is smooth when enlarging
    #[config(live, one_of = ["area", "bilinear"], default = "area")]
    method: String,
    /// Width that is expected to come; another one works too, its first frame takes longer
    #[config(min = 1, max = 16384, unit = "px", default = 640)]
    from_width: u32,
    /// Height that is expected to come
    #[config(min = 1, max = 16384, unit = "px", default = 480)]
    from_height: u32,
}

/// Brings both images of a stereo frame to one size, in their own format.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Resize {
    /// Stereo frames, RGB8 or GRAY8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames, `width` × `height`
    #[output]
    resized: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: ResizeConfig,
    /// Bytes of the output's frames.
    reserved: usize,
    /// For each format, grey first.
    resizers: Option<[Resizer; 2]>,
}

impl Component for Resize {
    fn configure(&mut self) -> Result {
        let ResizeConfig { from_width, from_height, .. } = self.cfg;
        let to_side = self.cfg.width.max(self.cfg.height) as usize;
        let resizers = self
            .resizers
            .take()
            .filter(|[r, _]| r.room() == (MAX_SIDE, to_side))
            .unwrap_or_else(|| [Format::Gray8; 2].map(|_| Resizer::with_room(MAX_SIDE, to_side)));
        let resizers = self.resizers.insert(resizers);
        let (width, height) = (from_width as usize, from_height as usize);
        for format in [Format::Gray8, Format::Rgb8] {
            self.cfg.prepare(&mut resizers[slot(format)], Shape { width, height, format });
        }
        let (width, height) = (self.cfg.width as usize, self.cfg.height as usize);
        pair::reserve(&mut self.resized, &mut self.reserved, Shape { width, height, format: Format::Rgb8 })
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let Some(resizers) = &mut self.resizers else { return Ok(()) };
        pair::each(&mut self.image, &mut self.tally, |frame| {
            filter(&frame, &mut self.resized, resizers, &self.cfg)
        });
        Ok(())
    }
}

fn slot(format: Format) -> usize {
    usize::from(format == Format::Rgb8)
}

impl ResizeConfig {
    /// False when the image is too large.
    fn prepare(&self, resizer: &mut Resizer, from: Shape) -> bool {
        let method = if self.method == "bilinear" { Method::Bilinear } else { Method::Area };
        resizer.prepare(from, self.width as usize, self.height as usize, method)
    }
}

fn filter(
    frame: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    resizers: &mut [Resizer; 2],
    cfg: &ResizeConfig,
) -> Result<(), Unfit> {
    let source = pair::images(frame)?;
    let from = source[0].shape();
    let resizer = &mut resizers[slot(from.format)];
    if resizer.from() != from && !cfg.prepare(resizer, from) {
        return Err(Unfit::Side);
    }
    let shape = resizer.to();
    let mut loan = out.loan()?;
    for (from, to) in source.iter().zip(&mut pair::blank(&mut loan, frame.header(), shape)?) {
        if !resizer.run(from, to) {
            return Err(Unfit::Short);
        }
    }
    loan.commit(2 * shape.packed_bytes(), frame.stamp());
    Ok(())
}
