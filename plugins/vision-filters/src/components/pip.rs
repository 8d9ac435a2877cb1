//! `pip`: picture in picture, for both eyes, in the frame itself when nobody else reads it.
//!
//! Invariant: an old inset is hidden, never shown as if it were new; without an inset frames pass without a copy; a step
//! allocates only when insets of another size than before begin to come, or another size is asked for, once per change.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::pair::{self, Tally, Unfit};
use crate::pip::lay;
use crate::resize::{Method, Resizer};
use crate::view::{Shape, View, ViewMut};

/// Longest side of the inset, px.
const MAX_SIDE: u32 = 16_384;

/// Where the inset is, how large, and how much of the picture below it shows through.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct PipRect {
    /// Column of its left side; moved so that the inset fits.
    #[unit("px")]
    pub x: i32,
    /// Row of its upper side.
    #[unit("px")]
    pub y: i32,
    /// 0: the size that it comes with.
    #[unit("px")]
    pub w: u32,
    /// 0: the size that it comes with.
    #[unit("px")]
    pub h: u32,
    /// 0 (nothing to be seen of it) to 1 (hides what is below).
    pub alpha: f64,
}

#[derive(Config)]
struct PipConfig {
    /// Column of the inset's left edge; moved so that the inset fits
    #[config(live, min = 0, max = 16384, unit = "px", default = 16)]
    x: i32,
    /// Row of the inset's upper edge
    #[config(live, min = 0, max = 16384, unit = "px", default = 16)]
    y: i32,
    /// Width of the inset; 0: as it comes
    #[config(live, min = 0, max = 16384, unit = "px", default = 0)]
    w: u32,
    /// Height of the inset; 0: as it comes
    #[config(live, min = 0, max = 16384, unit = "px", default = 0)]
    h: u32,
    /// How much the inset hides: 0 nothing, 1 all
    #[config(live, min = 0, max = 1, default = 1.0)]
    alpha: f64,
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
#[component(model = "on_signal", provides("inset_control"))]
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
    /// Where the inset is: as configured or commanded last.
    #[state]
    rect: PipRect,
    #[config]
    cfg: PipConfig,
    visible: bool,
    room: Room,
    scaled: Scaled,
}

#[provides("inset_control")]
impl Pip {
    /// Moves and sizes the inset, until it is configured anew.
    #[command]
    fn set_rect(&mut self, rect: PipRect) -> Result {
        if !(0.0..=1.0).contains(&rect.alpha) {
            return Err(format!("set_rect: an alpha of {} is not 0 to 1", rect.alpha).into());
        }
        if rect.w > MAX_SIDE || rect.h > MAX_SIDE {
            let PipRect { w, h, .. } = rect;
            return Err(
                format!("set_rect: {w} × {h} px: a side is at most {MAX_SIDE} px, 0 as it comes").into()
            );
        }
        self.rect = rect;
        Ok(())
    }
    /// Shows or hides the inset, until it is configured anew.
    #[command]
    fn set_visible(&mut self, visible: Flag) {
        self.visible = visible.get();
    }
    /// Where the inset is.
    #[read]
    fn rect(s: &PipState) -> PipRect {
        s.rect
    }
}

impl Component for Pip {
    fn configure(&mut self) -> Result {
        let PipConfig { x, y, w, h, alpha, visible, .. } = self.cfg;
        self.rect = PipRect { x, y, w, h, alpha };
        self.visible = visible;
        self.room.reserve(&mut self.composed, self.cfg.max_width, self.cfg.max_height)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        for _ in 0..super::BURST {
            let Some(frame) = self.image.next() else { break };
            let inset = if self.visible { self.inset.latest() } else { None };
            let inset = inset.filter(|i| !i.is_stale());
            self.inset_shown = inset.is_some().into();
            let (scaled, rect) = (&mut self.scaled, self.rect);
            let change =
                inset.as_ref().map(|inset| move |big: &mut [ViewMut<'_>; 2]| scaled.lay(inset, big, &rect));
            self.tally.count(InPlace { frame, out: &mut self.composed }.run(change));
        }
        self.image.release();
        Ok(())
    }
}

/// Brings insets to the size that is asked for.
#[derive(Default)]
struct Scaled {
    resizer: Option<Resizer>,
    bytes: Vec<u8>,
}

impl Scaled {
    fn lay(
        &mut self,
        inset: &FrameView<'_, StereoHeader>,
        big: &mut [ViewMut<'_>; 2],
        rect: &PipRect,
    ) -> Result<(), Unfit> {
        let part = (rect.alpha * 255.0).round() as u32;
        for (small, big) in pair::images(inset)?.iter().zip(big) {
            let (x, y) = (i64::from(rect.x), i64::from(rect.y));
            lay(&self.sized(small, rect)?, big, x, y, part);
        }
        Ok(())
    }

    fn sized<'a>(&'a mut self, small: &View<'a>, rect: &PipRect) -> Result<View<'a>, Unfit> {
        let from = small.shape();
        let or = |asked: u32, own: usize| if asked == 0 { own } else { asked as usize };
        let to = Shape { width: or(rect.w, from.width), height: or(rect.h, from.height), ..from };
        if to == from {
            return Ok(*small);
        }
        let resizer = match self.resizer.take().filter(|r| r.from() == from && r.to() == to) {
            Some(fits) => self.resizer.insert(fits),
            None => {
                self.bytes.resize(self.bytes.len().max(to.packed_bytes()), 0);
                // Means for smaller ones, smooth for larger ones.
                let shrinks = to.width <= from.width && to.height <= from.height;
                let method = if shrinks { Method::Area } else { Method::Bilinear };
                self.resizer.insert(Resizer::new(from, to.width, to.height, method))
            }
        };
        let bytes = self.bytes.get_mut(..to.packed_bytes()).ok_or(Unfit::Large)?;
        if !resizer.run(small, &mut ViewMut::packed(to, bytes).map_err(|_| Unfit::Large)?) {
            return Err(Unfit::Short);
        }
        View::packed(to, bytes).map_err(|_| Unfit::Large)
    }
}
