//! Payloads of cameras: headers of image frames, and the camera's geometry.
//!
//! Invariant: rows are `stride` bytes apart; the image that a header describes lies in the frame's bytes, or
//! the reader drops the frame: `FrameView::image` and `images` check it.
#![allow(
    missing_docs,
    reason = "the docs of fields go into every manifest: a field has one where name, type and unit do not say it all"
)]

use crate as trocar_sdk;
use trocar_sdk::{Payload, Stamp, named_values};

named_values! {
    /// Pixel formats; rows are `stride` bytes apart.
    pub struct PixelFormat: u32 {
        /// u8 brightness.
        GRAY8 = 1,
        /// u8 red, green, blue.
        RGB8 = 2,
        /// u8 blue, green, red.
        BGR8 = 3,
        /// u8 red, green, blue, opacity.
        RGBA8 = 4,
        /// u16 brightness.
        GRAY16 = 5,
        /// One value per pixel behind a colour filter: rows R G R G … and G B G B …, beginning with R.
        BAYER_RG8 = 6,
        /// Y0 U Y1 V for two pixels, ITU-R BT.601 video range.
        YUYV = 7,
        /// i16, 1/16 px from the left to the right image of a rectified pair; negative: nothing is known.
        DISPARITY16 = 8,
        /// f32, m along the optical axis; not a number: nothing is known.
        DEPTH32F = 9,
    }
}

impl PixelFormat {
    /// Bytes of one pixel; 0 for an unknown format.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            PixelFormat::GRAY8 | PixelFormat::BAYER_RG8 => 1,
            PixelFormat::GRAY16 | PixelFormat::YUYV | PixelFormat::DISPARITY16 => 2,
            PixelFormat::RGB8 | PixelFormat::BGR8 => 3,
            PixelFormat::RGBA8 | PixelFormat::DEPTH32F => 4,
            _ => 0,
        }
    }
}

/// Header of an image frame.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("image")]
pub struct ImageHeader {
    /// When the image was taken.
    pub stamp: Stamp,
    /// Counts the source's images, from 0.
    pub index: u64,
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
    /// From one row to the next.
    #[unit("B")]
    pub stride: u32,
    pub format: PixelFormat,
}

/// Header of a stereo pair: two images of one size and format in one frame.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("stereo")]
pub struct StereoHeader {
    /// When the pair was taken.
    pub stamp: Stamp,
    /// Counts the source's pairs, from 0.
    pub index: u64,
    /// Of one image.
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
    /// From one row to the next.
    #[unit("B")]
    pub stride: u32,
    pub format: PixelFormat,
    /// Where the right image begins; the left one begins at 0.
    #[unit("B")]
    pub right_offset: u64,
}

impl From<ImageHeader> for StereoHeader {
    /// The same image for both eyes: the right one begins where the left one does.
    fn from(image: ImageHeader) -> StereoHeader {
        let ImageHeader { stamp, index, width, height, stride, format } = image;
        StereoHeader { stamp, index, width, height, stride, format, right_offset: 0 }
    }
}

/// Size and rate of a camera (`camera_geometry`).
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct CameraGeometry {
    /// Of one image.
    #[unit("px")]
    pub width: u32,
    #[unit("px")]
    pub height: u32,
    /// Images or pairs per second; 0 before the first one.
    #[unit("Hz")]
    pub fps: f64,
}
