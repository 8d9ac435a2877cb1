//! The layout of the two images of a pair in a raw frame of a camera.
//!
//! Invariant: a frame is handed on byte by byte as it came; the header says where the images lie in it.

use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

/// The arrangement of the images in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrangement {
    /// One image, for both eyes.
    Mono,
    /// Each row is one of the left image and then one of the right one.
    SideBySide,
    /// All of the left image, then all of the right one.
    Stacked,
}

/// Size, format and arrangement of raw frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Size of one image, px.
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) format: PixelFormat,
    pub(crate) arrangement: Arrangement,
}

impl Layout {
    /// From the words of a configuration.
    ///
    /// # Errors
    /// A size that the format has not.
    pub(crate) fn of(width: u32, height: u32, format: &str, layout: &str) -> Result<Layout> {
        let format = match format {
            "gray8" => PixelFormat::GRAY8,
            "bgr8" => PixelFormat::BGR8,
            "bayer_rg8" => PixelFormat::BAYER_RG8,
            "yuyv" => PixelFormat::YUYV,
            _ => PixelFormat::RGB8,
        };
        let [even_width, even_height] = match format {
            PixelFormat::BAYER_RG8 => [true, true],
            PixelFormat::YUYV => [true, false],
            _ => [false, false],
        };
        if (even_width && !width.is_multiple_of(2)) || (even_height && !height.is_multiple_of(2)) {
            let which = if even_height { "width and height" } else { "width" };
            return Err(
                format!("width, height: {width} × {height} px; {format:?} wants an even {which}").into()
            );
        }
        let arrangement = match layout {
            "side_by_side" => Arrangement::SideBySide,
            "stacked" => Arrangement::Stacked,
            _ => Arrangement::Mono,
        };
        Ok(Layout { width, height, format, arrangement })
    }

    /// Pixels in a row of the frame, and its rows.
    pub(crate) fn frame_size(&self) -> (u32, u32) {
        match self.arrangement {
            Arrangement::Mono => (self.width, self.height),
            Arrangement::SideBySide => (2 * self.width, self.height),
            Arrangement::Stacked => (self.width, 2 * self.height),
        }
    }

    /// Bytes from one row of the frame to the next.
    pub(crate) fn stride(&self) -> u32 {
        self.frame_size().0 * self.format.bytes_per_pixel() as u32
    }

    /// Bytes of a frame.
    pub(crate) fn frame_bytes(&self) -> usize {
        self.stride() as usize * self.frame_size().1 as usize
    }

    pub(crate) fn header(&self, stamp: Stamp, index: u64) -> StereoHeader {
        let right_offset = match self.arrangement {
            Arrangement::Mono => 0,
            Arrangement::SideBySide => u64::from(self.width) * self.format.bytes_per_pixel() as u64,
            Arrangement::Stacked => u64::from(self.stride()) * u64::from(self.height),
        };
        let Layout { width, height, format, .. } = *self;
        StereoHeader { stamp, index, width, height, stride: self.stride(), format, right_offset }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn each_arrangement_finds_both_images_in_the_frame_as_it_came() {
        let bytes: Vec<u8> = (0..8).collect();
        for (name, left, right) in [
            ("mono", [[0, 1], [2, 3]], [[0, 1], [2, 3]]),
            ("side_by_side", [[0, 1], [4, 5]], [[2, 3], [6, 7]]),
            ("stacked", [[0, 1], [2, 3]], [[4, 5], [6, 7]]),
        ] {
            let layout = Layout::of(2, 2, "gray8", name).unwrap();
            assert_eq!(layout.frame_bytes(), if name == "mono" { 4 } else { 8 });
            let header = layout.header(Stamp::from_ns(1), 0);
            let images = header.images(&bytes[..layout.frame_bytes()]).unwrap();
            for (image, rows) in images.iter().zip([left, right]) {
                assert_eq!([image.row(0), image.row(1)], rows, "{name}");
            }
        }
    }

    #[test]
    fn sizes_that_a_format_has_not_are_refused() {
        let refused =
            |width, height, format| Layout::of(width, height, format, "mono").unwrap_err().to_string();
        assert_eq!(refused(3, 2, "yuyv"), "width, height: 3 × 2 px; YUYV wants an even width");
        assert!(refused(2, 3, "bayer_rg8").contains("an even width and height"));
        assert!(Layout::of(3, 3, "bgr8", "mono").is_ok());
    }
}
