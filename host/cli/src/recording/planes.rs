//! The bytes of a frame as rows of an array: their items and their shape.
//!
//! Invariant: a plane has exactly the bytes that its shape says; what does not is left as the bytes it is.

use prost_reflect::bytes::Bytes;

use super::columns::Cell;
use super::npz::Item;

/// Largest side of an image, pixels.
pub(super) const LARGEST: usize = 1 << 15;

/// Part of an array that one message adds.
#[derive(Debug, PartialEq)]
pub(super) struct Plane {
    pub(super) item: Item,
    /// Length along the first axis.
    pub(super) rows: usize,
    /// Shape of one row.
    pub(super) shape: Vec<usize>,
    pub(super) bytes: Vec<u8>,
}

/// The values of a message, by name.
pub(super) struct Row<'a>(pub(super) &'a [(String, Cell)]);

impl Row<'_> {
    fn cell(&self, name: &str) -> Option<&Cell> {
        self.0.iter().find(|(other, _)| other == name).map(|(_, cell)| cell)
    }

    fn whole(&self, name: &str) -> Option<usize> {
        match self.cell(name)? {
            Cell::Whole(n) => usize::try_from(*n).ok(),
            Cell::Large(n) => usize::try_from(*n).ok(),
            _ => None,
        }
    }

    fn text(&self, name: &str) -> &str {
        match self.cell(name) {
            Some(Cell::Text(text) | Cell::Named(_, text)) => text,
            _ => "",
        }
    }

    /// An image's kind, where it is an image without compression.
    pub(super) fn encoding(&self) -> Option<&str> {
        let all = ["width", "height", "step"].iter().all(|name| self.whole(name).is_some());
        Some(self.text("encoding")).filter(|encoding| all && !encoding.is_empty())
    }
}

impl Plane {
    /// Reads lines of samples as the header counts them, or an image's rows without the bytes between them;
    /// else the bytes as they are.
    pub(super) fn of(row: &Row<'_>, name: &str, bytes: &Bytes) -> Plane {
        let known = if name == "data" { lines(row, bytes).or_else(|| image(row, bytes)) } else { None };
        known.unwrap_or_else(|| Plane {
            item: Item::U8,
            rows: 1,
            shape: vec![bytes.len()],
            bytes: bytes.to_vec(),
        })
    }
}

fn lines(row: &Row<'_>, bytes: &Bytes) -> Option<Plane> {
    let (lines, samples) = (row.whole("lines")?, row.whole("samples")?);
    // Values of an enum have its name before theirs.
    let item = match row.text("format").rsplit('_').next()? {
        "U8" => Item::U8,
        "U16" => Item::U16,
        "F32" => Item::F32,
        _ => return None,
    };
    let all = lines.checked_mul(samples)?.checked_mul(item.bytes())?;
    // A frame may be larger than what is in it.
    (samples > 0 && all <= bytes.len()).then(|| Plane {
        item,
        rows: lines,
        shape: vec![samples],
        bytes: bytes[..all].to_vec(),
    })
}

fn image(row: &Row<'_>, bytes: &Bytes) -> Option<Plane> {
    let item = match row.encoding()? {
        "16SC1" => Item::I16,
        "32FC1" => Item::F32,
        _ => return None,
    };
    let (width, height, step) = (row.whole("width")?, row.whole("height")?, row.whole("step")?);
    let bytes = tight((width, height, step), item.bytes(), bytes)?;
    Some(Plane { item, rows: 1, shape: vec![height, width], bytes })
}

/// The rows of an image without the bytes between them, `pixel` bytes for each pixel; `None` where they are
/// not all there.
pub(super) fn tight(
    (width, height, step): (usize, usize, usize),
    pixel: usize,
    bytes: &[u8],
) -> Option<Vec<u8>> {
    let sides = 1..=LARGEST;
    if !sides.contains(&width) || !sides.contains(&height) {
        return None;
    }
    let line = width * pixel;
    if step < line || bytes.len() < step.checked_mul(height - 1)?.checked_add(line)? {
        return None;
    }
    let mut tight = Vec::with_capacity(line * height);
    bytes.chunks(step).take(height).for_each(|row| tight.extend_from_slice(&row[..line]));
    Some(tight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(fields: &[(&str, i64)], texts: &[(&str, &str)]) -> Vec<(String, Cell)> {
        let numbers = fields.iter().map(|(name, n)| ((*name).to_owned(), Cell::Whole(*n)));
        let texts = texts.iter().map(|(name, text)| ((*name).to_owned(), Cell::Text((*text).to_owned())));
        numbers.chain(texts).collect()
    }

    fn plane(fields: &[(&str, i64)], texts: &[(&str, &str)], bytes: usize) -> Plane {
        let data = Bytes::from((0..bytes).map(|n| n as u8).collect::<Vec<u8>>());
        Plane::of(&Row(&row(fields, texts)), "data", &data)
    }

    #[test]
    fn lines_are_as_many_rows_as_the_header_counts() {
        let seen = plane(&[("lines", 3), ("samples", 2)], &[("format", "SAMPLEFORMAT_U16")], 20);
        assert_eq!((seen.item, seen.rows, &seen.shape[..], seen.bytes.len()), (Item::U16, 3, &[2][..], 12));
    }

    #[test]
    fn an_image_is_without_what_lies_between_its_rows() {
        let seen = plane(&[("width", 2), ("height", 2), ("step", 6)], &[("encoding", "16SC1")], 12);
        assert_eq!((seen.item, seen.rows, &seen.shape[..]), (Item::I16, 1, &[2, 2][..]));
        assert_eq!(&seen.bytes[..], [0, 1, 2, 3, 6, 7, 8, 9]);
    }

    #[test]
    fn what_a_header_promises_and_is_not_there_stays_bytes() {
        let bytes = |seen: Plane| (seen.item, seen.rows, seen.shape) == (Item::U8, 1, vec![7]);
        assert!(bytes(plane(&[("lines", i64::MAX), ("samples", 2)], &[("format", "X_U16")], 7)));
        assert!(bytes(plane(&[("lines", 2), ("samples", 2)], &[("format", "X_F64")], 7)));
        assert!(bytes(plane(
            &[("width", 1), ("height", i64::MAX), ("step", 8)],
            &[("encoding", "32FC1")],
            7
        )));
        assert!(bytes(plane(&[("width", 2), ("height", 2), ("step", 3)], &[("encoding", "16SC1")], 7)));
        assert!(bytes(plane(&[("width", -2), ("height", 2), ("step", 3)], &[("encoding", "16SC1")], 7)));
    }
}
