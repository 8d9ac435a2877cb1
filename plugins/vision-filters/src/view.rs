//! Images that the filters work on, to read and to write: grey ones and coloured ones.
//!
//! Invariant: a view that exists covers `height` rows of `width` pixels inside its bytes, as
//! `ImageHeader::image` has checked; rows never panic.

use std::fmt;

use trocar_sdk::data::{BadFrame, ImageHeader, ImageView, PixelFormat};

/// Layout of a pixel in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One byte of brightness.
    Gray8,
    /// Three bytes: red, green, blue.
    Rgb8,
}

impl Format {
    /// Bytes of one pixel.
    pub const fn bytes(self) -> usize {
        match self {
            Format::Gray8 => 1,
            Format::Rgb8 => 3,
        }
    }

    /// As a header says it.
    pub const fn in_header(self) -> PixelFormat {
        match self {
            Format::Gray8 => PixelFormat::GRAY8,
            Format::Rgb8 => PixelFormat::RGB8,
        }
    }

    /// The format that a header says; none when it is another one.
    pub const fn of(format: PixelFormat) -> Option<Format> {
        match format {
            PixelFormat::GRAY8 => Some(Format::Gray8),
            PixelFormat::RGB8 => Some(Format::Rgb8),
            _ => None,
        }
    }
}

/// Size and format of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixel format.
    pub format: Format,
}

impl Shape {
    /// Bytes of one row without padding.
    pub const fn row_bytes(self) -> usize {
        self.width * self.format.bytes()
    }

    /// Bytes of the image when its rows touch.
    pub const fn packed_bytes(self) -> usize {
        self.row_bytes() * self.height
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}×{} {:?}", self.width, self.height, self.format)
    }
}

/// An image to read, of a format that the filters work on.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    image: ImageView<'a>,
    format: Format,
}

/// An image to write.
#[derive(Debug)]
pub struct ViewMut<'a> {
    shape: Shape,
    stride: usize,
    bytes: &'a mut [u8],
}

impl<'a> View<'a> {
    /// Looks at `bytes` as an image whose rows start every `stride` bytes.
    ///
    /// # Errors
    /// No pixels, a stride below one row, or fewer bytes than the rows need.
    pub fn new(shape: Shape, stride: usize, bytes: &'a [u8]) -> Result<Self, BadFrame> {
        // A number beyond a header's range is beyond the bytes, too.
        let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let (width, height, stride) = (number(shape.width), number(shape.height), number(stride));
        let format = shape.format.in_header();
        let image = ImageHeader { width, height, stride, format, ..Default::default() }.image(bytes)?;
        Ok(View { image, format: shape.format })
    }

    /// Looks at `bytes` as an image whose rows touch.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn packed(shape: Shape, bytes: &'a [u8]) -> Result<Self, BadFrame> {
        View::new(shape, shape.row_bytes(), bytes)
    }

    /// The image of a frame; none when its format is another one.
    pub fn of(image: ImageView<'a>) -> Option<Self> {
        Format::of(image.format()).map(|format| View { image, format })
    }

    /// Size and format.
    #[inline]
    pub fn shape(&self) -> Shape {
        let (width, height) = (self.image.width() as usize, self.image.height() as usize);
        Shape { width, height, format: self.format }
    }

    /// Row `y` without its padding; empty below the image.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [u8] {
        self.image.row(u32::try_from(y).unwrap_or(u32::MAX))
    }

    /// All bytes, from the first pixel on; they may reach beyond the last one.
    pub(crate) fn bytes(&self) -> &'a [u8] {
        self.image.bytes()
    }

    /// Bytes from row to row.
    pub(crate) fn stride(&self) -> usize {
        self.image.stride()
    }
}

impl<'a> ViewMut<'a> {
    /// Looks at `bytes` as a writable image whose rows start every `stride` bytes.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn new(shape: Shape, stride: usize, bytes: &'a mut [u8]) -> Result<Self, BadFrame> {
        let view = View::new(shape, stride, bytes)?;
        let (shape, stride) = (view.shape(), view.stride());
        Ok(ViewMut { shape, stride, bytes })
    }

    /// Looks at `bytes` as a writable image whose rows touch.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn packed(shape: Shape, bytes: &'a mut [u8]) -> Result<Self, BadFrame> {
        ViewMut::new(shape, shape.row_bytes(), bytes)
    }

    /// Size and format.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Row `y` without its padding; the last row when `y` lies below the image.
    pub fn row_mut(&mut self, y: usize) -> &mut [u8] {
        let start = y.min(self.shape.height - 1) * self.stride;
        &mut self.bytes[start..start + self.shape.row_bytes()]
    }

    /// Two rows at once, `above` before `below`; empty ones when they are not in this order or not in the
    /// image.
    pub(crate) fn two_rows_mut(&mut self, above: usize, below: usize) -> (&mut [u8], &mut [u8]) {
        if above >= below || below >= self.shape.height {
            return (&mut [], &mut []);
        }
        let row = self.shape.row_bytes();
        let (first, second) = self.bytes.split_at_mut(below * self.stride);
        (&mut first[above * self.stride..][..row], &mut second[..row])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: Shape = Shape { width: 2, height: 3, format: Format::Rgb8 };

    #[test]
    fn rows_skip_the_padding_and_the_last_row_needs_none() {
        let bytes: Vec<u8> = (0..22).collect();
        let view = View::new(SHAPE, 8, &bytes).expect("2 strides and a row");
        assert_eq!(view.row(0), [0, 1, 2, 3, 4, 5]);
        assert_eq!(view.row(2), [16, 17, 18, 19, 20, 21]);
        assert!(view.row(9).is_empty());
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_with_their_numbers() {
        let refused = |done: Result<View<'_>, BadFrame>| done.map(|_| ()).expect_err("refused").to_string();
        assert_eq!(
            refused(View::new(SHAPE, 8, &[0; 21])),
            "a 2 × 3 RGB8 image with a stride of 8 B needs 22 B, and the frame has 21 B"
        );
        assert_eq!(
            refused(View::new(SHAPE, 5, &[0; 99])),
            "a stride of 5 B is less than a row of 2 RGB8 pixels, 6 B"
        );
        let empty = Shape { height: 0, ..SHAPE };
        assert_eq!(refused(View::packed(empty, &[])), "an image of 2 × 0 has no pixels");
        assert!(
            ViewMut::new(SHAPE, 8, &mut [0; 21]).is_err() && ViewMut::new(SHAPE, 8, &mut [0; 22]).is_ok()
        );
    }

    #[test]
    fn sizes_near_the_end_of_the_address_space_are_refused_not_wrapped() {
        let huge = Shape { width: usize::MAX / 2, height: 3, format: Format::Rgb8 };
        assert!(View::new(huge, usize::MAX, &[0; 4]).is_err());
        let tall = Shape { width: 1, height: usize::MAX, format: Format::Gray8 };
        assert!(View::new(tall, 16, &[0; 4]).is_err());
    }
}
