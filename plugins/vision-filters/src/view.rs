//! Views of images in memory: bytes with a width, a height, a stride and a pixel format.
//!
//! Invariant: a view that exists covers `height` rows of `width` pixels inside its bytes; rows never panic.

use std::fmt;

/// How a pixel lies in memory.
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

/// An image to read.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    shape: Shape,
    stride: usize,
    bytes: &'a [u8],
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
    pub fn new(shape: Shape, stride: usize, bytes: &'a [u8]) -> Result<Self, BadView> {
        check(shape, stride, bytes.len())?;
        Ok(View { shape, stride, bytes })
    }

    /// Looks at `bytes` as an image whose rows touch.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn packed(shape: Shape, bytes: &'a [u8]) -> Result<Self, BadView> {
        View::new(shape, shape.row_bytes(), bytes)
    }

    /// Size and format.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Row `y` without its padding; the last row when `y` lies below the image.
    pub fn row(&self, y: usize) -> &'a [u8] {
        let start = y.min(self.shape.height - 1) * self.stride;
        &self.bytes[start..start + self.shape.row_bytes()]
    }

    /// All bytes, from the first pixel on; they may reach beyond the last one.
    pub(crate) fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Bytes from row to row.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }
}

impl<'a> ViewMut<'a> {
    /// Looks at `bytes` as a writable image whose rows start every `stride` bytes.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn new(shape: Shape, stride: usize, bytes: &'a mut [u8]) -> Result<Self, BadView> {
        check(shape, stride, bytes.len())?;
        Ok(ViewMut { shape, stride, bytes })
    }

    /// Looks at `bytes` as a writable image whose rows touch.
    ///
    /// # Errors
    /// As [`View::new`].
    pub fn packed(shape: Shape, bytes: &'a mut [u8]) -> Result<Self, BadView> {
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

    /// Two rows at once, `above` before `below`; empty ones when they are not in this order or not in the image.
    pub(crate) fn two_rows_mut(&mut self, above: usize, below: usize) -> (&mut [u8], &mut [u8]) {
        if above >= below || below >= self.shape.height {
            return (&mut [], &mut []);
        }
        let row = self.shape.row_bytes();
        let (first, second) = self.bytes.split_at_mut(below * self.stride);
        (&mut first[above * self.stride..][..row], &mut second[..row])
    }
}

fn check(shape: Shape, stride: usize, got: usize) -> Result<(), BadView> {
    if shape.width == 0 || shape.height == 0 {
        return Err(BadView::Empty { shape });
    }
    let row = shape.width.checked_mul(shape.format.bytes());
    if row.is_none_or(|row| stride < row) {
        return Err(BadView::Stride { shape, stride });
    }
    // The last row needs no padding behind it.
    let needed = row.and_then(|row| (shape.height - 1).checked_mul(stride)?.checked_add(row));
    match needed {
        Some(needed) if needed <= got => Ok(()),
        _ => Err(BadView::Short { shape, stride, got }),
    }
}

/// Why bytes are not the image they were said to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadView {
    /// No width or no height.
    Empty {
        /// What was said.
        shape: Shape,
    },
    /// Rows would overlap.
    Stride {
        /// What was said.
        shape: Shape,
        /// Bytes from row to row.
        stride: usize,
    },
    /// Rows would lie behind the end.
    Short {
        /// What was said.
        shape: Shape,
        /// Bytes from row to row.
        stride: usize,
        /// Bytes there are.
        got: usize,
    },
}

impl fmt::Display for BadView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BadView::Empty { shape } => write!(f, "an image of {shape} has no pixels"),
            BadView::Stride { shape, stride } => {
                write!(f, "a stride of {stride} bytes is shorter than one row of {shape}")
            }
            BadView::Short { shape, stride, got } => {
                write!(f, "{got} bytes are too few for {shape} with a stride of {stride} bytes")
            }
        }
    }
}

impl std::error::Error for BadView {}

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
        assert_eq!(view.row(9), view.row(2));
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_with_their_numbers() {
        assert_eq!(
            View::new(SHAPE, 8, &[0; 21]).map(|_| ()),
            Err(BadView::Short { shape: SHAPE, stride: 8, got: 21 })
        );
        let refused = View::new(SHAPE, 5, &[0; 99]).expect_err("overlapping rows");
        assert_eq!(refused.to_string(), "a stride of 5 bytes is shorter than one row of 2×3 Rgb8");
        let empty = Shape { height: 0, ..SHAPE };
        assert_eq!(View::packed(empty, &[]).map(|_| ()), Err(BadView::Empty { shape: empty }));
    }

    #[test]
    fn sizes_near_the_end_of_the_address_space_are_refused_not_wrapped() {
        let huge = Shape { width: usize::MAX / 2, height: 3, format: Format::Rgb8 };
        assert!(View::new(huge, usize::MAX, &[0; 4]).is_err());
        let tall = Shape { width: 1, height: usize::MAX, format: Format::Gray8 };
        assert!(View::new(tall, 16, &[0; 4]).is_err());
    }
}
