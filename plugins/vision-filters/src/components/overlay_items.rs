//! Items that `overlay` can draw: their payloads, their places, the files of the pictures.
//!
//! Invariant: an item that has a place is drawn in the eyes it names, and touches no pixel outside of the
//! image.

use std::path::Path;

use trocar_sdk::prelude::*;

use crate::overlay::{self, Picture};
use crate::view::ViewMut;

/// Items there may be at once.
pub(super) const ITEMS: usize = 32;
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
    /// Latin-1; other letters become `?`.
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
    /// Distance by which the item is further left in the right image: the disparity of what it stands beside.
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
    /// Distance by which the item is further left in the right image.
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
    /// Distance by which the item is further left in the right image.
    #[unit("px")]
    pub disparity: i32,
}

/// An item with a number.
#[derive(Clone, Copy)]
pub(super) enum Item {
    Text(OverlayText),
    Line(OverlayLine),
    Picture(OverlayPicture),
}

/// Draws an item into both images.
pub(super) fn draw(item: &Item, pictures: &[Picture], [left, right]: &mut [ViewMut<'_>; 2]) {
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

/// Reads a picture of a file.
///
/// # Errors
/// Names the file and what is wrong with it.
pub(super) fn load(path: &str) -> Result<Picture> {
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
