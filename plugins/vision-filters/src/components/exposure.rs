//! `exposure`: gain, offset and gamma of both images, where they lie when nobody else reads them.
//!
//! Invariant: settings that change nothing let frames pass untouched.

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::pair::{self, Tally};
use crate::exposure::Curve;
use crate::view::ViewMut;

#[derive(Config)]
struct ExposureConfig {
    /// Times what comes
    #[config(live, min = 0, max = 8, default = 1.0)]
    gain: f64,
    /// Added to it, of the whole range
    #[config(live, min = -1, max = 1, default = 0.0)]
    offset: f64,
    /// Above 1 lightens the dark parts
    #[config(live, min = 0.1, max = 8, default = 1.0)]
    gamma: f64,
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Makes both images of stereo frames lighter or darker.
#[derive(Component)]
#[component(model = "on_signal")]
pub struct Exposure {
    /// Stereo frames, RGB8 or GRAY8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames with other levels
    #[output]
    exposed: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    #[config]
    cfg: ExposureConfig,
    room: Room,
    curve: Curve,
}

impl Component for Exposure {
    fn configure(&mut self) -> Result {
        let ExposureConfig { gain, offset, gamma, .. } = self.cfg;
        self.curve = Curve::new(gain, offset, gamma);
        self.room.reserve(&mut self.exposed, self.cfg.max_width, self.cfg.max_height)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let curve = &self.curve;
        let change = |images: &mut [ViewMut<'_>; 2]| images.iter_mut().for_each(|image| curve.apply(image));
        let change = (!curve.is_identity()).then_some(change);
        pair::each(&mut self.image, &mut self.tally, |frame| {
            InPlace { frame, out: &mut self.exposed }.run(change)
        });
        self.image.release();
        Ok(())
    }
}
