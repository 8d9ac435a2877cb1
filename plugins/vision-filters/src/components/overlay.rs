//! `overlay`: text, lines and pictures over stereo frames, set by commands while they run.
//!
//! Invariant: items are drawn in the order of their numbers; a number has at most one item; a step allocates nothing. Files
//! are read only while it does not run.

use std::path::Path;

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::in_place::{InPlace, Room};
use super::pair::{self, Tally};
use crate::overlay::{self, Picture};
use crate::view::ViewMut;

/// Items there may be at once.
const ITEMS: usize = 32;
/// Longest side of a picture, px.
const MAX_PICTURE: u32 = 4096;

named_values! {
    /// In which image an item is.
    pub struct Eye: u32 { BOTH = 0, LEFT = 1, RIGHT = 2 }
}

/// A line of text.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct OverlayText {
    /// ASCII; other letters become `?`.
    pub text: Text<96>,
    /// Number of the item, 0 to 31; takes the place of what has it.
    pub item: u32,
    /// Left side of the text.
    #[unit("px")]
    pub x: i32,
    /// Its upper side.
    #[unit("px")]
    pub y: i32,
    /// Height of letters: 16, 24 or 32, the nearest is taken.
    #[unit("px")]
    pub size: u32,
    /// Red, green, blue, opacity: 255 hides what is below.
    pub color: [u8; 4],
    pub eye: Eye,
    /// How much further left the item is in the right image: the disparity of what it stands beside.
    #[unit("px")]
    pub disparity: i32,
    pub reserved: u32,
}

/// A straight line.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct OverlayLine {
    /// Number of the item, 0 to 31; takes the place of what has it.
    pub item: u32,
    /// Begin: column, row.
    #[unit("px")]
    pub from: [i32; 2],
    /// End: column, row.
    #[unit("px")]
    pub to: [i32; 2],
    /// 1 to 64.
    #[unit("px")]
    pub width: u32,
    /// Red, green, blue, opacity: 255 hides what is below.
    pub color: [u8; 4],
    pub eye: Eye,
    /// How much further left the item is in the right image.
    #[unit("px")]
    pub disparity: i32,
}

/// A picture of those that are configured.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct OverlayPicture {
    /// Number of the item, 0 to 31; takes the place of what has it.
    pub item: u32,
    /// Which of `pictures`, from 0.
    pub picture: u32,
    /// Its left side.
    #[unit("px")]
    pub x: i32,
    /// Its upper side.
    #[unit("px")]
    pub y: i32,
    /// Opacity beside the picture's own, 0 to 255.
    pub alpha: u32,
    pub eye: Eye,
    /// How much further left the item is in the right image.
    #[unit("px")]
    pub disparity: i32,
}

#[derive(Clone, Copy)]
enum Item {
    Text(OverlayText),
    Line(OverlayLine),
    Picture(OverlayPicture),
}

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
        // What shows a picture that is no longer there goes with it.
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

fn draw(item: &Item, pictures: &[Picture], [left, right]: &mut [ViewMut<'_>; 2]) {
    let (eye, disparity) = match item {
        Item::Text(t) => (t.eye, t.disparity),
        Item::Line(l) => (l.eye, l.disparity),
        Item::Picture(p) => (p.eye, p.disparity),
    };
    let eyes = [(Eye::RIGHT, left, 0), (Eye::LEFT, right, i64::from(disparity))];
    for (other, image, shift) in eyes {
        if eye == other {
            continue;
        }
        let at = |x: i32, y: i32| (i64::from(x) - shift, i64::from(y));
        match item {
            Item::Text(t) => overlay::text(image, at(t.x, t.y), t.size, t.color, t.text.as_str()),
            Item::Line(l) => {
                let [from, to] = [l.from, l.to].map(|[x, y]| at(x, y)).map(|(x, y)| (x as f64, y as f64));
                overlay::line(image, from, to, f64::from(l.width), l.color);
            }
            Item::Picture(p) => {
                if let Some(picture) = pictures.get(p.picture as usize) {
                    overlay::picture(image, at(p.x, p.y), p.alpha.min(255) as u8, picture);
                }
            }
        }
    }
}

fn load(path: &str) -> Result<Picture> {
    let bad = |why: String| format!("pictures: {path}: {why}; name PNG or JPEG files");
    let reader =
        image::ImageReader::open(Path::new(path)).map_err(|e| bad(format!("cannot be opened: {e}")))?;
    let mut reader = reader.with_guessed_format().map_err(|e| bad(format!("cannot be read: {e}")))?;
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(MAX_PICTURE), Some(MAX_PICTURE));
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| bad(format!("cannot be decoded: {e}")))?.into_rgba8();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    Ok(Picture { width, height, rgba: decoded.into_raw() })
}
