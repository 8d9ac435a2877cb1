//! The bytes of a frame as its header describes them: images and lines, checked once and then safe to read.
//!
//! Invariant: a header is a peer's claim. A view exists only where all of it lies in the frame's bytes,
//! computed without overflow; reading a view neither panics nor leaves the bytes.

use super::{AScanHeader, ImageHeader, PixelFormat, SampleFormat, SpectraHeader, StereoHeader};
use crate::frames::FrameView;
use core::fmt;

/// An image to read: `height` rows of `width` pixels.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    width: u32,
    height: u32,
    stride: u32,
    format: PixelFormat,
    /// Begins with the first pixel.
    bytes: &'a [u8],
}

impl<'a> ImageView<'a> {
    fn new(of: &ImageHeader, offset: u64, bytes: &'a [u8]) -> Result<ImageView<'a>, BadFrame> {
        let ImageHeader { width, height, stride, format, .. } = *of;
        if format.bytes_per_pixel() == 0 {
            return Err(BadFrame::PixelFormat { format: format.0 });
        }
        if width == 0 || height == 0 {
            return Err(BadFrame::NoPixels { width, height });
        }
        let row = u64::from(width) * format.bytes_per_pixel() as u64;
        if u64::from(stride) < row {
            return Err(BadFrame::Stride { width, format, stride });
        }
        // The last row needs no gap behind it. At most 2^64 + 2^65: no overflow.
        let end = u128::from(offset) + u128::from(height - 1) * u128::from(stride) + u128::from(row);
        let there = usize::try_from(offset)
            .ok()
            .filter(|_| end <= bytes.len() as u128)
            .and_then(|at| bytes.get(at..));
        match there {
            Some(bytes) => Ok(ImageView { width, height, stride, format, bytes }),
            None => Err(BadFrame::ImageBeyond {
                width,
                height,
                format,
                stride,
                offset,
                needs: end,
                bytes: bytes.len(),
            }),
        }
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Bytes from one row to the next.
    pub fn stride(&self) -> usize {
        self.stride as usize
    }

    /// Format of the pixels.
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// The frame's bytes from the first pixel on; they hold all rows and may reach beyond the last one.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The pixels of row `y`, 0 at the top, without the gap behind them; empty below the image.
    #[inline]
    pub fn row(&self, y: u32) -> &'a [u8] {
        if y >= self.height {
            return &[];
        }
        let at = y as usize * self.stride as usize;
        &self.bytes[at..at + self.width as usize * self.format.bytes_per_pixel()]
    }

    /// All rows, from the top.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &'a [u8]> + use<'a> {
        let image = *self;
        (0..image.height as usize).map(move |y| image.row(y as u32))
    }

    /// The bytes of one pixel; empty outside of the image.
    #[inline]
    pub fn pixel(&self, x: u32, y: u32) -> &'a [u8] {
        let (row, size) = (self.row(y), self.format.bytes_per_pixel());
        let at = (x as usize).saturating_mul(size);
        row.get(at..at.saturating_add(size)).unwrap_or_default()
    }
}

/// Lines to read: spectra or A-scans, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct LinesView<'a> {
    lines: u32,
    /// Bytes.
    line: usize,
    bytes: &'a [u8],
}

impl<'a> LinesView<'a> {
    fn new(
        lines: u32,
        samples: u32,
        format: SampleFormat,
        bytes: &'a [u8],
    ) -> Result<LinesView<'a>, BadFrame> {
        if format.bytes() == 0 {
            return Err(BadFrame::SampleFormat { format: format.0 });
        }
        if lines > 0 && samples == 0 {
            return Err(BadFrame::NoSamples { lines });
        }
        let needs = u128::from(lines) * u128::from(samples) * format.bytes() as u128;
        if needs > bytes.len() as u128 {
            return Err(BadFrame::LinesBeyond { lines, samples, format, needs, bytes: bytes.len() });
        }
        Ok(LinesView { lines, line: samples as usize * format.bytes(), bytes })
    }

    /// Returns the number of lines.
    #[allow(clippy::len_without_is_empty)] // A frame without lines is nothing special.
    pub fn len(&self) -> usize {
        self.lines as usize
    }

    /// The bytes of one line, in the machine's byte order; empty behind the last one.
    #[inline]
    pub fn line(&self, i: u32) -> &'a [u8] {
        if i >= self.lines {
            return &[];
        }
        let at = i as usize * self.line;
        &self.bytes[at..at + self.line]
    }

    /// All lines, in the order in which they were taken.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &'a [u8]> + use<'a> {
        let view = *self;
        (0..view.len()).map(move |i| view.line(i as u32))
    }
}

impl ImageHeader {
    /// Returns the image in `bytes`, those of the frame with this header.
    ///
    /// # Errors
    /// The header promises more than the bytes hold: both sizes.
    ///
    /// ```
    /// use trocar_sdk::data::{ImageHeader, PixelFormat};
    /// let header =
    ///     ImageHeader { width: 2, height: 2, stride: 3, format: PixelFormat::GRAY8, ..Default::default() };
    /// assert_eq!(header.image(&[1, 2, 0, 3, 4]).unwrap().row(1), [3, 4]);
    /// let refused = header.image(&[1, 2, 0, 3]).unwrap_err();
    /// assert_eq!(
    ///     refused.to_string(),
    ///     "a 2 × 2 GRAY8 image with a stride of 3 B needs 5 B, and the frame has 4 B"
    /// );
    /// ```
    pub fn image<'a>(&self, bytes: &'a [u8]) -> Result<ImageView<'a>, BadFrame> {
        ImageView::new(self, 0, bytes)
    }
}

impl StereoHeader {
    /// Returns both images in `bytes`, those of the frame with this header; the left one first.
    ///
    /// # Errors
    /// As [`ImageHeader::image`].
    pub fn images<'a>(&self, bytes: &'a [u8]) -> Result<[ImageView<'a>; 2], BadFrame> {
        let StereoHeader { stamp, index, width, height, stride, format, right_offset } = *self;
        let one = ImageHeader { stamp, index, width, height, stride, format };
        Ok([ImageView::new(&one, 0, bytes)?, ImageView::new(&one, right_offset, bytes)?])
    }
}

impl SpectraHeader {
    /// Returns the lines in `bytes`, those of the frame with this header.
    ///
    /// # Errors
    /// The header promises more than the bytes hold: both sizes.
    pub fn lines_in<'a>(&self, bytes: &'a [u8]) -> Result<LinesView<'a>, BadFrame> {
        LinesView::new(self.lines, self.samples, self.format, bytes)
    }
}

impl AScanHeader {
    /// Returns the lines in `bytes`, those of the frame with this header.
    ///
    /// # Errors
    /// The header promises more than the bytes hold: both sizes.
    pub fn lines_in<'a>(&self, bytes: &'a [u8]) -> Result<LinesView<'a>, BadFrame> {
        LinesView::new(self.lines, self.samples, self.format, bytes)
    }
}

impl FrameView<'_, ImageHeader> {
    /// Returns the frame as its header describes it.
    ///
    /// # Errors
    /// The header promises more than the bytes hold: count the frame and leave it out.
    pub fn image(&self) -> Result<ImageView<'_>, BadFrame> {
        self.header().image(self.bytes())
    }
}

impl FrameView<'_, StereoHeader> {
    /// Returns the frame as its header describes it, the left image first.
    ///
    /// # Errors
    /// As [`FrameView::image`].
    pub fn images(&self) -> Result<[ImageView<'_>; 2], BadFrame> {
        self.header().images(self.bytes())
    }
}

impl FrameView<'_, SpectraHeader> {
    /// Returns the frame as its header describes it.
    ///
    /// # Errors
    /// As [`FrameView::image`].
    pub fn lines(&self) -> Result<LinesView<'_>, BadFrame> {
        self.header().lines_in(self.bytes())
    }
}

impl FrameView<'_, AScanHeader> {
    /// Returns the frame as its header describes it.
    ///
    /// # Errors
    /// As [`FrameView::image`].
    pub fn lines(&self) -> Result<LinesView<'_>, BadFrame> {
        self.header().lines_in(self.bytes())
    }
}

/// Reason why a frame is not what its header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadFrame {
    /// None of [`PixelFormat`].
    PixelFormat {
        /// The header's number.
        format: u32,
    },
    /// None of [`SampleFormat`].
    SampleFormat {
        /// The header's number.
        format: u32,
    },
    /// No width or no height, px.
    NoPixels {
        /// Columns, px.
        width: u32,
        /// Rows, px.
        height: u32,
    },
    /// Lines with nothing in them.
    NoSamples {
        /// Number of lines.
        lines: u32,
    },
    /// Rows would lie in each other: `stride` B are less than `width` px.
    Stride {
        /// Columns, px.
        width: u32,
        /// Format of the pixels.
        format: PixelFormat,
        /// From one row to the next, B.
        stride: u32,
    },
    /// The image that begins at `offset` would end at byte `needs`, and there are `bytes`.
    ImageBeyond {
        /// Columns, px.
        width: u32,
        /// Rows, px.
        height: u32,
        /// Format of the pixels.
        format: PixelFormat,
        /// From one row to the next, B.
        stride: u32,
        /// First byte of the image.
        offset: u64,
        /// Number of the byte at which the image would end.
        needs: u128,
        /// Size of the frame, B.
        bytes: usize,
    },
    /// The lines would need `needs` B, and there are `bytes`.
    LinesBeyond {
        /// Number of lines.
        lines: u32,
        /// Values of one line.
        samples: u32,
        /// Format of one value.
        format: SampleFormat,
        /// Size of the lines, B.
        needs: u128,
        /// Size of the frame, B.
        bytes: usize,
    },
}

impl fmt::Display for BadFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            BadFrame::PixelFormat { format } => write!(f, "{format} is no pixel format of PixelFormat"),
            BadFrame::SampleFormat { format } => write!(f, "{format} is no format of SampleFormat"),
            BadFrame::NoPixels { width, height } => write!(f, "an image of {width} × {height} has no pixels"),
            BadFrame::NoSamples { lines } => write!(f, "{lines} lines have no samples in them"),
            BadFrame::Stride { width, format, stride } => {
                let row = u64::from(width) * format.bytes_per_pixel() as u64;
                write!(f, "a stride of {stride} B is less than a row of {width} {format:?} pixels, {row} B")
            }
            BadFrame::ImageBeyond { width, height, format, stride, offset, needs, bytes } => {
                write!(f, "a {width} × {height} {format:?} image with a stride of {stride} B")?;
                if offset > 0 {
                    write!(f, " from byte {offset} on")?;
                }
                write!(f, " needs {needs} B, and the frame has {bytes} B")
            }
            BadFrame::LinesBeyond { lines, samples, format, needs, bytes } => {
                write!(f, "{lines} lines of {samples} {format:?} need {needs} B, and the frame has {bytes} B")
            }
        }
    }
}

impl core::error::Error for BadFrame {}

#[cfg(test)]
#[path = "view_tests.rs"]
mod tests;
