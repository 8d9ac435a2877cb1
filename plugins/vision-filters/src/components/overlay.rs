//! `overlay`: text, lines and pictures over stereo frames, set by commands while they run.
//!
//! Invariant: items are drawn in the order of their numbers; a number has at most one item; a step allocates
//! nothing. Files are read only while it does not run.

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::overlay_items::{Eye, ITEMS, Item, OverlayLine, OverlayPicture, OverlayText, draw, load};
use super::pair::{self, Tally};
use crate::overlay::Picture;
use crate::view::ViewMut;

#[derive(Config)]
struct OverlayConfig {
    /// PNG or JPEG files for `set_picture`, read when configured; relative to the directory the host runs in
    #[config(default = [])]
    pictures: Vec<String>,
    /// Whether the items are shown
    #[config(live, default = true)]
    visible: bool,
    /// Widest image that will come; sets the size of the output's frames
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: u32,
    /// Highest image that will come
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: u32,
}

/// Draws items over both images, where they lie when nobody else reads them.
#[derive(Component)]
#[component(model = "on_signal", provides("items"))]
pub struct Overlay {
    /// Stereo frames, RGB8 or GRAY8
    #[input]
    image: In<Frame<StereoHeader>>,
    /// The same frames with the items over them
    #[output]
    overlaid: Out<Frame<StereoHeader>>,
    #[state]
    tally: Tally,
    /// Items there are.
    #[state]
    items: u64,
    #[config]
    cfg: OverlayConfig,
    room: Room,
    pictures: Vec<Picture>,
    /// The files they are of.
    files: Vec<String>,
    /// Between Start and Stop, when no file is read: `pictures` cannot change then.
    runs: bool,
    drawn: [Option<Item>; ITEMS],
}

#[provides("items")]
impl Overlay {
    /// Makes or replaces a line of text.
    #[command]
    fn set_text(&mut self, text: &OverlayText) -> Result {
        self.set("set_text", text.item, text.eye, Item::Text(*text))
    }
    /// Makes or replaces a straight line.
    #[command]
    fn set_line(&mut self, line: &OverlayLine) -> Result {
        if !(1..=64).contains(&line.width) {
            return Err(format!("set_line: a width of {} px is not 1 to 64 px", line.width).into());
        }
        self.set("set_line", line.item, line.eye, Item::Line(*line))
    }
    /// Makes or replaces a picture.
    #[command]
    fn set_picture(&mut self, picture: &OverlayPicture) -> Result {
        let there = self.pictures.len();
        if picture.picture as usize >= there {
            let which = picture.picture;
            return Err(format!(
                "set_picture: there is no picture {which}: {there} are configured, counted from 0; name its file in pictures"
            )
            .into());
        }
        if picture.alpha > 255 {
            return Err(format!("set_picture: an alpha of {} is above 255", picture.alpha).into());
        }
        self.set("set_picture", picture.item, picture.eye, Item::Picture(*picture))
    }
    /// Takes an item away; one that is not there is away already.
    #[command]
    fn remove(&mut self, #[arg(min = 0, max = 31, doc = "Number of the item")] item: u32) {
        if let Some(place) = self.drawn.get_mut(item as usize) {
            *place = None;
        }
        self.count();
    }
    /// Takes all items away.
    #[command]
    fn clear(&mut self) {
        self.drawn = [None; ITEMS];
        self.count();
    }
    /// Items there are.
    #[read]
    fn items(s: &OverlayState) -> u64 {
        s.items
    }
}

impl Overlay {
    fn set(&mut self, command: &str, number: u32, eye: Eye, item: Item) -> Result {
        if eye.name().is_none() {
            return Err(format!("{command}: eye {} is none of BOTH = 0, LEFT = 1, RIGHT = 2", eye.0).into());
        }
        let Some(place) = self.drawn.get_mut(number as usize) else {
            return Err(format!("{command}: item {number} is above {}: there are {ITEMS}", ITEMS - 1).into());
        };
        *place = Some(item);
        self.count();
        Ok(())
    }

    fn count(&mut self) {
        self.items = self.drawn.iter().flatten().count() as u64;
    }
}

impl Component for Overlay {
    fn configure(&mut self) -> Result {
        if !self.runs || self.files != self.cfg.pictures {
            self.pictures = self.cfg.pictures.iter().map(|path| load(path)).collect::<Result<_>>()?;
            self.files.clone_from(&self.cfg.pictures);
        }
        // An item that shows a picture which is no longer there goes with it.
        let there = self.pictures.len();
        for place in &mut self.drawn {
            if matches!(place, Some(Item::Picture(p)) if p.picture as usize >= there) {
                *place = None;
            }
        }
        self.count();
        self.room.reserve(&mut self.overlaid, self.cfg.max_width, self.cfg.max_height)
    }

    fn start(&mut self) -> Result {
        self.tally = Tally::default();
        self.resume()
    }

    fn resume(&mut self) -> Result {
        self.runs = true;
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.runs = false;
        Ok(())
    }

    fn step(&mut self, _: &Tick) -> Result {
        let (items, pictures) = (&self.drawn, &self.pictures);
        let change = |images: &mut [ViewMut<'_>; 2]| {
            items.iter().flatten().for_each(|item| draw(item, pictures, images));
        };
        let change = (self.cfg.visible && self.items > 0).then_some(change);
        pair::each(&mut self.image, &mut self.tally, |frame| {
            InPlace { frame, out: &mut self.overlaid }.run(change)
        });
        self.image.release();
        Ok(())
    }
}
