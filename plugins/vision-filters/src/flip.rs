//! Mirroring of images where they lie.
//!
//! Invariant: doing the same flip twice gives the image back; padding between rows is not touched.

use crate::view::ViewMut;

/// Direction in which an image is mirrored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flip {
    /// Left to right.
    Horizontal,
    /// Top to bottom.
    Vertical,
    /// Both: half a turn.
    Both,
}

/// Mirrors an image.
pub fn flip(image: &mut ViewMut<'_>, how: Flip) {
    let (height, pixel) = (image.shape().height, image.shape().format.bytes());
    if how != Flip::Horizontal {
        for y in 0..height / 2 {
            let (above, below) = image.two_rows_mut(y, height - 1 - y);
            above.swap_with_slice(below);
        }
    }
    if how != Flip::Vertical {
        for y in 0..height {
            let row = image.row_mut(y);
            match pixel {
                3 => row.as_chunks_mut::<3>().0.reverse(),
                _ => row.reverse(),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Format, Shape};

    fn flipped(shape: Shape, stride: usize, bytes: &[u8], how: Flip) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        flip(&mut ViewMut::new(shape, stride, &mut bytes).expect("fits"), how);
        bytes
    }

    #[test]
    fn pixels_change_sides_and_colours_stay_in_order() {
        let grey = Shape { width: 3, height: 3, format: Format::Gray8 };
        let image = [1, 2, 3, 4, 5, 6, 7, 8, 9];
        assert_eq!(flipped(grey, 3, &image, Flip::Horizontal), [3, 2, 1, 6, 5, 4, 9, 8, 7]);
        assert_eq!(flipped(grey, 3, &image, Flip::Vertical), [7, 8, 9, 4, 5, 6, 1, 2, 3]);
        assert_eq!(flipped(grey, 3, &image, Flip::Both), [9, 8, 7, 6, 5, 4, 3, 2, 1]);
        let colour = Shape { width: 2, height: 1, format: Format::Rgb8 };
        assert_eq!(flipped(colour, 6, &[1, 2, 3, 4, 5, 6], Flip::Horizontal), [4, 5, 6, 1, 2, 3]);
    }

    #[test]
    fn padding_stays_where_it_is() {
        let grey = Shape { width: 2, height: 2, format: Format::Gray8 };
        assert_eq!(flipped(grey, 4, &[1, 2, 90, 91, 3, 4], Flip::Both), [4, 3, 90, 91, 2, 1]);
    }
}
