//! Arrays as NumPy reads them: a `.npz` file, a zip of `.npy` arrays.
//!
//! Invariant: an array's header says exactly the bytes that follow it.

use std::fs::File;
use std::io::{self, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Writes one file of arrays.
pub(super) struct Npz {
    zip: ZipWriter<File>,
}

/// What an array's items are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Item {
    F64,
    I64,
    U64,
}

impl Npz {
    pub(super) fn new(file: File) -> Npz {
        Npz { zip: ZipWriter::new(file) }
    }

    /// Adds an array of `rows` times `columns` items, 1-D for one column.
    ///
    /// # Errors
    /// What the file system says.
    pub(super) fn array(
        &mut self,
        name: &str,
        item: Item,
        rows: usize,
        columns: usize,
        bytes: &[u8],
    ) -> io::Result<()> {
        let options =
            SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        self.zip.start_file(format!("{name}.npy"), options).map_err(io::Error::other)?;
        self.zip.write_all(&header(item, rows, columns))?;
        self.zip.write_all(bytes)
    }

    /// # Errors
    /// What the file system says.
    pub(super) fn finish(self) -> io::Result<()> {
        self.zip.finish().map_err(io::Error::other)?.sync_all()
    }
}

/// Version 1.0 of the format: magic, length, a Python literal, filled up to a multiple of 64 bytes.
fn header(item: Item, rows: usize, columns: usize) -> Vec<u8> {
    let kind = match item {
        Item::F64 => "<f8",
        Item::I64 => "<i8",
        Item::U64 => "<u8",
    };
    let shape = if columns == 1 { format!("({rows},)") } else { format!("({rows}, {columns})") };
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    let pad = (64 - (10 + text.len() + 1) % 64) % 64;
    text.push_str(&" ".repeat(pad));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(text.len() as u16).to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_ends_where_its_data_begin() {
        for (rows, columns) in [(0, 1), (7, 1), (1_000_000, 12)] {
            let bytes = header(Item::F64, rows, columns);
            assert_eq!((bytes.len() % 64, bytes.last()), (0, Some(&b'\n')), "{rows} x {columns}");
            assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10, bytes.len());
        }
    }
}
