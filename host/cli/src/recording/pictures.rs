//! Images of a recording as PNG files.
//!
//! Invariant: a picture is written only when its pixels are all there, and never over something.

use std::fs::OpenOptions;
use std::io::BufWriter;
use std::path::Path;

use png::{BitDepth, ColorType};
use prost_reflect::{DynamicMessage, ReflectMessage};

use super::planes::{LARGEST, Row, tight};

/// Pixels of a compressed picture at most: a byte of it may stand for 62.
const MOST: u64 = 1 << 26;

/// Pixels as PNG takes them, without gaps between rows.
#[derive(Debug, PartialEq)]
pub(super) struct Picture {
    pub(super) width: u32,
    pub(super) height: u32,
    color: ColorType,
    depth: BitDepth,
    bytes: Vec<u8>,
}

/// Content of a message of an image's schema.
pub(super) enum Found {
    Picture(Picture),
    /// A file of its own kind: its ending and bytes.
    File(&'static str, Vec<u8>),
    /// Why there is none.
    None(&'static str),
}

/// Tells whether a message of this schema and with these values can be written as PNG or as a file
/// of its own kind.
pub(super) fn is_one(schema: &str, row: &Row<'_>) -> bool {
    match schema {
        "foxglove.RawImage" => row.encoding().is_some_and(|encoding| pixels(encoding).is_some()),
        "foxglove.CompressedImage" => true,
        _ => false,
    }
}

/// Colours, depth and bytes of a pixel.
fn pixels(encoding: &str) -> Option<(ColorType, BitDepth, usize)> {
    Some(match encoding {
        "mono8" | "8UC1" | "bayer_rggb8" => (ColorType::Grayscale, BitDepth::Eight, 1),
        "rgb8" | "bgr8" | "8UC3" => (ColorType::Rgb, BitDepth::Eight, 3),
        "rgba8" | "bgra8" => (ColorType::Rgba, BitDepth::Eight, 4),
        "mono16" | "16UC1" => (ColorType::Grayscale, BitDepth::Sixteen, 2),
        _ => return None,
    })
}

fn number(message: &DynamicMessage, name: &str) -> u32 {
    message.get_field_by_name(name).and_then(|v| v.as_u32()).unwrap_or(0)
}

/// The image in a message; nothing where its schema is none of images.
pub(super) fn find(message: &DynamicMessage) -> Option<Found> {
    let descriptor = message.descriptor();
    let data =
        |name: &str| message.get_field_by_name(name).and_then(|v| v.as_bytes().cloned()).unwrap_or_default();
    let text = |name: &str| {
        message.get_field_by_name(name).and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
    };
    match descriptor.full_name() {
        "foxglove.RawImage" => {
            let size = (number(message, "width"), number(message, "height"), number(message, "step"));
            Some(match raw(size, &text("encoding"), &data("data")) {
                Some(picture) => Found::Picture(picture),
                None if pixels(&text("encoding")).is_none() => Found::None(
                    "its pixels are of a kind that PNG has no word for: `--npz` has disparity and depth",
                ),
                None => Found::None("its pixels are not all there"),
            })
        }
        "foxglove.CompressedImage" => Some(match text("format").as_str() {
            "jpeg" => Found::File("jpg", data("data").to_vec()),
            "png" => Found::File("png", data("data").to_vec()),
            "qoi" => qoi_picture(&data("data")).map_or(Found::None("it is no QOI image"), Found::Picture),
            _ => Found::None("its compression is not known"),
        }),
        _ => None,
    }
}

fn raw((width, height, step): (u32, u32, u32), encoding: &str, data: &[u8]) -> Option<Picture> {
    let (color, depth, bytes) = pixels(encoding)?;
    let mut tight = tight((width as usize, height as usize, step as usize), bytes, data)?;
    match encoding {
        "bgr8" => tight.chunks_exact_mut(3).for_each(|p| p.swap(0, 2)),
        "bgra8" => tight.chunks_exact_mut(4).for_each(|p| p.swap(0, 2)),
        // PNG has the high byte first.
        _ if bytes == 2 => tight.chunks_exact_mut(2).for_each(|p| p.swap(0, 1)),
        _ => {}
    }
    Some(Picture { width, height, color, depth, bytes: tight })
}

fn qoi_picture(data: &[u8]) -> Option<Picture> {
    let header = qoi::decode_header(data).ok()?;
    // A byte of QOI is at most 62 pixels: a header that promises more lies.
    let most = (data.len() as u64).saturating_mul(62).min(MOST);
    if header.width as usize > LARGEST
        || header.height as usize > LARGEST
        || u64::from(header.width) * u64::from(header.height) > most
    {
        return None;
    }
    let (header, bytes) = qoi::decode_to_vec(data).ok()?;
    let color = if header.channels.as_u8() == 4 { ColorType::Rgba } else { ColorType::Rgb };
    Some(Picture { width: header.width, height: header.height, color, depth: BitDepth::Eight, bytes })
}

/// Writes a picture to a new file.
///
/// # Errors
/// What the system says.
pub(super) fn write(path: &Path, picture: &Picture) -> Result<(), String> {
    let file = OpenOptions::new().write(true).create_new(true).open(path).map_err(|e| e.to_string())?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), picture.width, picture.height);
    encoder.set_color(picture.color);
    encoder.set_depth(picture.depth);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(&picture.bytes).and_then(|()| writer.finish()).map_err(|e| e.to_string())
}
