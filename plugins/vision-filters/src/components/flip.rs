//! `flip`: mirrors both images, where they lie when nobody else reads them.
//!
//! Invariant: a frame that others read too is copied, never changed under them.

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::pair::{self, Tally};
use crate::flip::{Flip as How, flip};
use crate::view::ViewMut;

#[derive(Config)]
struct FlipConfig {
    /// Direction in which the images are mirrored; `both` is half a turn
    #[config(live, one_of = ["none", "horizontal", "vertical", "both"], default = "horizontal")]
    direction: String,
    /// Whether left and right image change places, too: seen in a mirror, they do
    #[config(live, default = false)]
    swap_eyes: bool,
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Mirrors both images of stereo frames.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Flip {
    /// Stereo frames, RGB8 or GRAY8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames mirrored
    #[output]
    flipped: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: FlipConfig,
    room: Room,
}

impl Component for Flip {
    fn configure(&mut self) -> Result {
        self.room.reserve(&mut self.flipped, self.cfg.max_width, self.cfg.max_height)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let how = match self.cfg.direction.as_str() {
            "horizontal" => Some(How::Horizontal),
            "vertical" => Some(How::Vertical),
            "both" => Some(How::Both),
            _ => None,
        };
        let swap = self.cfg.swap_eyes;
        let change = |images: &mut [ViewMut<'_>; 2]| {
            if let Some(how) = how {
                images.iter_mut().for_each(|image| flip(image, how));
            }
            if swap {
                let [left, right] = images;
                (0..left.shape().height).for_each(|y| left.row_mut(y).swap_with_slice(right.row_mut(y)));
            }
        };
        let change = (how.is_some() || swap).then_some(change);
        pair::each(&mut self.image, &mut self.tally, |frame| {
            InPlace { frame, out: &mut self.flipped }.run(change)
        });
        self.image.release();
        Ok(())
    }
}
