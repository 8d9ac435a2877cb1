//! `pip`: picture in picture, for both eyes.
//!
//! Invariant: an old inset is hidden, never shown as if it were new; without an inset frames pass without a copy.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::gray::convert;
use crate::pip::lay;
use crate::view::{Format, Shape};

#[derive(Config)]
struct PipConfig {
    /// Column of the inset's left edge; moved so that the inset fits
    #[config(live, min = 0, max = 16384, unit = "px", default = 16)]
    x: i64,
    /// Row of the inset's upper edge
    #[config(live, min = 0, max = 16384, unit = "px", default = 16)]
    y: i64,
    /// Whether the inset is shown
    #[config(live, default = true)]
    visible: bool,
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Lays the newest inset into each image; formats may differ, the result has the image's.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Pip {
    /// The big picture
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The small picture; larger ones are cut
    #[input(optional)]
    inset: In<Frame<StereoHeader>>,
    /// The big picture with the small one in it
    #[output]
    composed: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    /// Whether the frame before had an inset in it.
    #[state]
    inset_shown: Flag,
    #[config]
    cfg: PipConfig,
    /// Bytes of the output's frames.
    reserved: usize,
}

impl Component for Pip {
    fn configure(&mut self) -> Result {
        let PipConfig { max_width, max_height, .. } = self.cfg;
        let most = Shape { width: max_width as usize, height: max_height as usize, format: Format::Rgb8 };
        pair::reserve(&mut self.composed, &mut self.reserved, most)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        for _ in 0..super::BURST {
            let Some(main) = self.image.next() else { break };
            let inset = if self.cfg.visible { self.inset.latest() } else { None };
            let inset = inset.filter(|i| !i.is_stale());
            self.inset_shown = inset.is_some().into();
            let done = match inset {
                Some(inset) => filter(&main, &inset, &mut self.composed, (self.cfg.x, self.cfg.y)),
                None => {
                    self.composed.forward(&main);
                    Ok(())
                }
            };
            self.tally.count(done);
        }
        Ok(())
    }
}

fn filter(
    main: &FrameView<'_, StereoHeader>,
    inset: &FrameView<'_, StereoHeader>,
    out: &mut Out<Frame<StereoHeader>>,
    (x, y): (i64, i64),
) -> Result<(), Unfit> {
    let (big, small) = (pair::images(main)?, pair::images(inset)?);
    let shape = big[0].shape();
    let mut loan = out.loan()?;
    let mut images = pair::blank(&mut loan, main.header(), shape)?;
    for (eye, to) in images.iter_mut().enumerate() {
        convert(&big[eye], to);
        lay(&small[eye], to, x, y);
    }
    loan.commit(2 * shape.packed_bytes(), main.stamp());
    Ok(())
}
