//! `pip`: picture in picture, for both eyes, in the frame itself when nobody else reads it.
//!
//! Invariant: an old inset is hidden, never shown as if it were new, and one that cannot be shown never takes
//! the big picture with it; without an inset frames pass without a copy; a step allocates nothing.

use trocar_sdk::data::{ImageHeader, StereoHeader};
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::inset::{Given, Scaled};
use super::pair::{self, Tally};
use crate::pip::lay;
use crate::scale::{self, PixelSize};
use crate::view::ViewMut;

/// Place and size of the inset, and how much of the picture below it shows through.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct PipRect {
    /// Column of its left side; moved so that the inset fits.
    #[unit("px")]
    pub x: i32,
    /// Row of its upper side.
    #[unit("px")]
    pub y: i32,
    /// At most `max_width`; 0: the size that it comes with.
    #[unit("px")]
    pub w: u32,
    /// At most `max_height`; 0: the size that it comes with.
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
    /// Width of the inset, at most max_width; 0: as it comes
    #[config(live, min = 0, max = 16384, unit = "px", default = 0)]
    w: u32,
    /// Height of the inset, at most max_height; 0: as it comes
    #[config(live, min = 0, max = 16384, unit = "px", default = 0)]
    h: u32,
    /// Opacity of the inset: 0 hides nothing, 1 all
    #[config(live, min = 0, max = 1, default = 1.0)]
    alpha: f64,
    /// From one column of the inset to the next, as it comes; with it the inset has an axis and a scale bar.
    /// 0: not known
    #[config(live, min = 0, max = 1, unit = "m", default = 0.0)]
    columns_m: f64,
    /// From one row to the next; with it the inset has an axis down its left side
    #[config(live, min = 0, max = 1, unit = "m", default = 0.0)]
    rows_m: f64,
    /// Ratio of the scale down to the scale across: 1 is true to scale. With columns_m and rows_m it says the
    /// height, in place of h. 0: the height is that of h
    #[config(live, min = 0, max = 100, default = 0.0)]
    stretch: f64,
    /// Whether the inset is shown
    #[config(live, default = true)]
    visible: bool,
    /// Widest image that will come; sets the size of the output's frames and of the largest inset
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
    /// The small picture for both eyes, such as a B-scan; shown while there is no `inset` that is not stale
    #[input(optional)]
    picture: In<Frame<ImageHeader>>,
    /// The big picture with the small one in it
    #[output]
    composed: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    /// Whether the frame before had an inset in it.
    #[state]
    inset_shown: Flag,
    /// Insets that were brought to their size, and those that could not be shown.
    #[state]
    insets: Tally,
    /// Place of the inset: as configured or commanded last.
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
        self.cfg.check(rect.w, rect.h).map_err(|why| format!("set_rect: {why}"))?;
        self.rect = rect;
        Ok(())
    }
    /// Shows or hides the inset, until it is configured anew.
    #[command]
    fn set_visible(&mut self, visible: Flag) {
        self.visible = visible.get();
    }
    /// Place of the inset.
    #[read]
    fn rect(s: &PipState) -> PipRect {
        s.rect
    }
}

impl PipConfig {
    /// Is there room for an inset of this size?
    fn check(&self, w: u32, h: u32) -> Result<(), String> {
        let (most_w, most_h) = (self.max_width, self.max_height);
        if w > most_w || h > most_h {
            return Err(format!(
                "an inset of {w} × {h} px is larger than max_width × max_height, {most_w} × {most_h} px: ask for a smaller \
                 one (0: as it comes), or configure larger ones"
            ));
        }
        Ok(())
    }
}

impl PipConfig {
    /// The height of an inset that comes with so many columns and rows and shall be `w` wide (0: as it
    /// comes), px; `h` where the stretch does not say it.
    fn height(&self, [columns, rows]: [u32; 2], w: u32, h: u32) -> u32 {
        let [across_m, down_m] = [f64::from(columns) * self.columns_m, f64::from(rows) * self.rows_m];
        if !(self.stretch > 0.0 && across_m > 0.0 && down_m > 0.0) {
            return h;
        }
        let wide = f64::from(if w == 0 { columns } else { w });
        (wide * self.stretch * down_m / across_m).round().clamp(1.0, f64::from(self.max_height)) as u32
    }

    /// Size of the pixels of an inset that came with so many columns and rows and is shown with others, m.
    fn pixel(&self, [columns, rows]: [u32; 2], shown: [usize; 2]) -> PixelSize {
        let each = |m: f64, came: u32, shown: usize| m * f64::from(came) / shown.max(1) as f64;
        PixelSize {
            column_m: each(self.columns_m, columns, shown[0]),
            row_m: each(self.rows_m, rows, shown[1]),
        }
    }
}

impl Component for Pip {
    fn configure(&mut self) -> Result {
        let PipConfig { x, y, w, h, alpha, visible, .. } = self.cfg;
        self.cfg.check(w, h).map_err(|why| format!("w, h: {why}"))?;
        self.rect = PipRect { x, y, w, h, alpha };
        self.visible = visible;
        self.scaled.reserve(self.cfg.max_width, self.cfg.max_height);
        self.room.reserve(&mut self.composed, self.cfg.max_width, self.cfg.max_height)
    }

    fn start(&mut self) -> Result {
        (self.tally, self.insets) = (Tally::default(), Tally::default());
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let rect = self.rect;
        let part = (rect.alpha * 255.0).round() as u32;
        pair::each(&mut self.image, &mut self.tally, |frame| {
            let pair = if self.visible { self.inset.latest() } else { None }.filter(|i| !i.is_stale());
            let one = if self.visible && pair.is_none() { self.picture.latest() } else { None };
            let one = one.filter(|p| !p.is_stale());
            let given = pair.as_ref().map(Given::pair).or_else(|| one.as_ref().map(Given::picture));
            let came = given.as_ref().map_or([0; 2], Given::size);
            let rect = PipRect { h: self.cfg.height(came, rect.w, rect.h), ..rect };
            let inset = given.and_then(|given| self.scaled.ready(&given, [rect.w, rect.h], &mut self.insets));
            self.inset_shown = inset.is_some().into();
            let cfg = &self.cfg;
            let change = inset.map(|inset| {
                move |big: &mut [ViewMut<'_>; 2]| {
                    for (small, big) in inset.iter().zip(big) {
                        let covered = lay(small, big, i64::from(rect.x), i64::from(rect.y), part);
                        let shape = small.shape();
                        scale::draw(big, covered, cfg.pixel(came, [shape.width, shape.height]));
                    }
                }
            });
            InPlace { frame, out: &mut self.composed }.run(change)
        });
        self.image.release();
        Ok(())
    }
}
