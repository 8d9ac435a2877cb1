//! Files of raw spectra: `u16` little endian, `[frames][ascans][samples]`, nothing before and nothing behind.
//!
//! Invariant: a file that was loaded has a whole number of frames, and no count beyond its bits; every other
//! one is refused with its length and the length it should have.

use std::fmt;
use std::path::{Path, PathBuf};

/// Files may be this long, B, so that a wrong name cannot exhaust the machine's memory.
pub const MAX_BYTES: u64 = 2 << 30;

/// Contents that a file should have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Pixels of a line.
    pub samples: usize,
    /// Lines of a frame.
    pub ascans: usize,
    /// Bits of a count.
    pub bits: u32,
}

impl Layout {
    /// Bytes of a frame.
    fn frame(&self) -> u64 {
        2 * self.samples as u64 * self.ascans as u64
    }
}

/// Reads a file into counts, line after line.
///
/// # Errors
/// See [`RawError`].
pub fn load(path: &Path, layout: Layout) -> Result<Vec<u16>, RawError> {
    let unreadable = |why: std::io::Error| RawError::Unreadable { path: path.into(), why: why.to_string() };
    let meta = std::fs::metadata(path).map_err(unreadable)?;
    if !meta.is_file() {
        return Err(RawError::NoFile { path: path.into() });
    }
    check(path, meta.len(), layout)?;
    let bytes = std::fs::read(path).map_err(unreadable)?;
    // The file may have grown meanwhile.
    check(path, bytes.len() as u64, layout)?;
    let counts: Vec<u16> = bytes.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
    let most = ((1u32 << layout.bits.min(16)) - 1) as u16;
    match counts.iter().position(|count| *count > most) {
        Some(at) => Err(RawError::TooLarge { path: path.into(), at, count: counts[at], bits: layout.bits }),
        None => Ok(counts),
    }
}

fn check(path: &Path, bytes: u64, layout: Layout) -> Result<(), RawError> {
    if bytes > MAX_BYTES {
        return Err(RawError::TooLong { path: path.into(), bytes });
    }
    if layout.frame() == 0 || bytes == 0 || !bytes.is_multiple_of(layout.frame()) {
        return Err(RawError::Length { path: path.into(), bytes, layout });
    }
    Ok(())
}

/// Why a file gave no spectra.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RawError {
    /// The system's error.
    Unreadable { path: PathBuf, why: String },
    /// A directory or a device.
    NoFile { path: PathBuf },
    /// More than [`MAX_BYTES`].
    TooLong { path: PathBuf, bytes: u64 },
    /// No whole number of frames.
    Length { path: PathBuf, bytes: u64, layout: Layout },
    /// A count that the bits cannot hold.
    TooLarge { path: PathBuf, at: usize, count: u16, bits: u32 },
}

impl fmt::Display for RawError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RawError::Unreadable { path, why } => {
                write!(f, "{}: cannot be read: {why}; name a file of raw spectra", path.display())
            }
            RawError::NoFile { path } => {
                write!(f, "{}: is no regular file; name a file of raw spectra", path.display())
            }
            RawError::TooLong { path, bytes } => {
                write!(
                    f,
                    "{}: {bytes} B are more than {MAX_BYTES} B: cut it into shorter files",
                    path.display()
                )
            }
            RawError::Length { path, bytes: 0, .. } => {
                write!(f, "{}: is empty; name a file of raw spectra", path.display())
            }
            RawError::Length { path, bytes, layout } => {
                let Layout { samples, ascans, .. } = layout;
                let (frame, over) = (layout.frame(), bytes.checked_rem(layout.frame()).unwrap_or(0));
                write!(
                    f,
                    "{}: {bytes} B are no frames of {ascans} lines of {samples} u16, {frame} B each ({over} B are left over): \
                     set samples and ascans to what the file holds",
                    path.display()
                )
            }
            RawError::TooLarge { path, at, count, bits } => write!(
                f,
                "{}: count {at} is {count}, more than {bits} bits hold: the file is little endian u16; set bits to what the \
                 detector had",
                path.display()
            ),
        }
    }
}

impl std::error::Error for RawError {}
