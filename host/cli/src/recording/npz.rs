//! Arrays as NumPy reads them: a `.npz` file, a zip of `.npy` arrays.
//!
//! Invariant: an array's header says exactly the bytes that follow it.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::rc::Rc;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Writes one file of arrays.
pub(super) struct Npz {
    zip: ZipWriter<Target>,
    failed: Rc<RefCell<Option<io::Error>>>,
}

/// The file, until it takes no more: later bytes go nowhere, and count as written. The zip's writer ends its
/// file whenever it is dropped, and would print that it cannot.
struct Target {
    file: File,
    /// Position of the next byte.
    at: u64,
    failed: Rc<RefCell<Option<io::Error>>>,
}

impl Target {
    /// Does `what` with the file; once it has failed, returns `instead`.
    ///
    /// # Errors
    /// It was interrupted, and can be done again.
    fn done<T>(&mut self, instead: T, what: impl FnOnce(&mut File) -> io::Result<T>) -> io::Result<T> {
        let mut failed = self.failed.borrow_mut();
        if failed.is_some() {
            return Ok(instead);
        }
        match what(&mut self.file) {
            Err(e) if e.kind() == io::ErrorKind::Interrupted => Err(e),
            Err(e) => {
                *failed = Some(e);
                Ok(instead)
            }
            done => done,
        }
    }
}

impl Write for Target {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.done(bytes.len(), |file| file.write(bytes))?;
        self.at += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.done((), File::flush)
    }
}

impl Seek for Target {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let instead = match to {
            SeekFrom::Start(at) => at,
            SeekFrom::Current(by) | SeekFrom::End(by) => self.at.saturating_add_signed(by),
        };
        self.at = self.done(instead, |file| file.seek(to))?;
        Ok(self.at)
    }
}

/// Type of an array's items.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Item {
    F64,
    F32,
    I64,
    I16,
    U64,
    U16,
    U8,
}

impl Item {
    /// Returns NumPy's name of the type.
    fn name(self) -> &'static str {
        match self {
            Item::F64 => "<f8",
            Item::F32 => "<f4",
            Item::I64 => "<i8",
            Item::I16 => "<i2",
            Item::U64 => "<u8",
            Item::U16 => "<u2",
            Item::U8 => "|u1",
        }
    }

    /// Returns the size of one item, B.
    pub(super) fn bytes(self) -> usize {
        match self {
            Item::F64 | Item::I64 | Item::U64 => 8,
            Item::F32 => 4,
            Item::I16 | Item::U16 => 2,
            Item::U8 => 1,
        }
    }
}

impl Npz {
    pub(super) fn new(file: File) -> Npz {
        let failed = Rc::default();
        Npz { zip: ZipWriter::new(Target { file, at: 0, failed: Rc::clone(&failed) }), failed }
    }

    /// Returns the error so far.
    fn check(failed: &RefCell<Option<io::Error>>) -> io::Result<()> {
        let said = |e: &io::Error| Err(io::Error::new(e.kind(), e.to_string()));
        failed.borrow().as_ref().map_or(Ok(()), said)
    }

    /// Adds an array of this shape.
    ///
    /// # Errors
    /// What the file system says.
    pub(super) fn array(&mut self, name: &str, item: Item, shape: &[usize], bytes: &[u8]) -> io::Result<()> {
        let options =
            SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        self.zip.start_file(format!("{name}.npy"), options).map_err(io::Error::other)?;
        self.zip.write_all(&header(item, shape))?;
        self.zip.write_all(bytes)?;
        Self::check(&self.failed)
    }

    /// # Errors
    /// What the file system says.
    pub(super) fn finish(self) -> io::Result<()> {
        let Target { file, .. } = self.zip.finish().map_err(io::Error::other)?;
        Self::check(&self.failed)?;
        file.sync_all()
    }
}

/// Version 1.0 of the format: magic, length, a Python literal, filled up to a multiple of 64 bytes.
fn header(item: Item, shape: &[usize]) -> Vec<u8> {
    let kind = item.name();
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    let shape =
        if let [side] = &sides[..] { format!("({side},)") } else { format!("({})", sides.join(", ")) };
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
    fn a_device_without_room_is_told_once_and_nothing_else_comes_of_it() {
        let full = || File::options().write(true).open("/dev/full").expect("a device of Linux");
        let mut npz = Npz::new(full());
        let refused = npz.array("a", Item::U8, &[100_000], &[7; 100_000]).expect_err("it is full");
        assert_eq!(refused.kind(), io::ErrorKind::StorageFull);
        drop(npz);
        let mut npz = Npz::new(full());
        npz.array("a", Item::U8, &[3], &[7; 3]).expect_err("it is full");
        assert_eq!(npz.finish().expect_err("it is full").kind(), io::ErrorKind::StorageFull);
    }

    #[test]
    fn a_header_ends_where_its_data_begin() {
        for shape in [&[0][..], &[7], &[1_000_000, 12], &[30, 768, 1024]] {
            let bytes = header(Item::F64, shape);
            assert_eq!((bytes.len() % 64, bytes.last()), (0, Some(&b'\n')), "{shape:?}");
            assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10, bytes.len());
        }
    }
}
