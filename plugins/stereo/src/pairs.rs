//! Stereo pairs from a folder: `left*` and `right*` PNG or JPEG files, decoded once into memory.
//!
//! Invariant: all pairs that were loaded have one size and one pixel format; a folder that cannot give that
//! is refused whole, with the file that is wrong.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use image::{ColorType, DynamicImage, ImageReader};

/// Decoded pictures may take this many bytes together, so that a wrong folder cannot exhaust the machine's
/// memory.
pub const MAX_BYTES: usize = 2 << 30;

/// Pixel format of loaded pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// One byte of brightness per pixel.
    Gray8,
    /// Red, green, blue: three bytes per pixel.
    Rgb8,
}

/// Format that the pictures are brought to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// Gray8 when every file is grey, else Rgb8.
    AsStored,
    /// Rgb8 always.
    Rgb8,
}

/// One pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Part of the file names behind `left` and `right`, without extension.
    pub name: String,
    /// Rows of the left picture, then rows of the right one, without padding.
    pub bytes: Box<[u8]>,
}

/// Pairs of one size and format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pairs {
    /// Pixels in a row of one picture.
    pub width: usize,
    /// Rows of one picture.
    pub height: usize,
    /// Pixel format.
    pub format: Format,
    /// In the order of their names: numbers by value, then others by text.
    pub pairs: Vec<Pair>,
}

impl Pairs {
    /// Reads every pair of `folder`; other files are left alone.
    ///
    /// # Errors
    /// See [`LoadError`]; nothing is kept of a folder that is refused.
    pub fn load(folder: &Path, want: Want) -> Result<Self, LoadError> {
        let files = find(folder)?;
        let first = decode(&files[0].left)?;
        let (width, height) = (first.width(), first.height());
        let mut decoded = Vec::with_capacity(files.len());
        let mut bytes = 0;
        for PairFiles { name, left, right } in files {
            let mut pictures = [None, None];
            for (picture, path) in pictures.iter_mut().zip([&left, &right]) {
                let taken = decode(path)?;
                if (taken.width(), taken.height()) != (width, height) {
                    let got = (taken.width(), taken.height());
                    return Err(LoadError::Size { path: path.clone(), got, first: (width, height) });
                }
                bytes += taken.as_bytes().len();
                if bytes > MAX_BYTES {
                    return Err(LoadError::TooMuch { folder: folder.into(), path: path.clone() });
                }
                *picture = Some(taken);
            }
            decoded.push((name, pictures));
        }
        let colour = |p: &DynamicImage| p.color() != ColorType::L8;
        let any_colour = decoded.iter().flat_map(|(_, pictures)| pictures.iter().flatten()).any(colour);
        let format = if any_colour || want == Want::Rgb8 { Format::Rgb8 } else { Format::Gray8 };
        let pairs = decoded
            .into_iter()
            .map(|(name, pictures)| {
                let rows = pictures.into_iter().flatten().map(|picture| match format {
                    Format::Gray8 => picture.into_luma8().into_raw(),
                    Format::Rgb8 => picture.into_rgb8().into_raw(),
                });
                Pair { name, bytes: rows.collect::<Vec<_>>().concat().into_boxed_slice() }
            })
            .collect();
        Ok(Pairs { width: width as usize, height: height as usize, format, pairs })
    }
}

struct PairFiles {
    name: String,
    left: PathBuf,
    right: PathBuf,
}

/// Numbers order by value before names that are no numbers, which order by text.
type Key = (bool, u64, String);

fn find(folder: &Path) -> Result<Vec<PairFiles>, LoadError> {
    let no_folder = |why: std::io::Error| LoadError::Folder { folder: folder.into(), why: why.to_string() };
    let mut sides: [BTreeMap<Key, PathBuf>; 2] = Default::default();
    let mut others = 0;
    for entry in std::fs::read_dir(folder).map_err(no_folder)? {
        let path = entry.map_err(no_folder)?.path();
        let Some((side, name)) = side_and_name(&path) else {
            others += 1;
            continue;
        };
        let number = name.parse::<u64>();
        let key = (number.is_err(), number.unwrap_or(0), name);
        if let Some(twin) = sides[side].insert(key, path.clone()) {
            return Err(LoadError::Twice { one: twin, other: path });
        }
    }
    let [left, mut right] = sides;
    let mut found = Vec::with_capacity(left.len());
    for (key, left) in left {
        match right.remove(&key) {
            Some(right) => found.push(PairFiles { name: key.2, left, right }),
            None => return Err(LoadError::Unpaired { missing: partner(&left, "left", "right"), path: left }),
        }
    }
    if let Some(right) = right.into_values().next() {
        return Err(LoadError::Unpaired { missing: partner(&right, "right", "left"), path: right });
    }
    if found.is_empty() {
        return Err(LoadError::NoPairs { folder: folder.into(), others });
    }
    Ok(found)
}

/// (0 left or 1 right, rest of the file's stem) when the file is one of a pair.
fn side_and_name(path: &Path) -> Option<(usize, String)> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    if !matches!(extension.as_str(), "png" | "jpg" | "jpeg") {
        return None;
    }
    let stem = path.file_stem()?.to_str()?;
    let (side, name) = match (stem.strip_prefix("left"), stem.strip_prefix("right")) {
        (Some(name), _) => (0, name),
        (_, Some(name)) => (1, name),
        _ => return None,
    };
    Some((side, name.to_owned()))
}

fn partner(path: &Path, side: &str, other: &str) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    name.replacen(side, other, 1)
}

fn decode(path: &Path) -> Result<DynamicImage, LoadError> {
    let unreadable = |why: String| LoadError::Unreadable { path: path.into(), why };
    let reader = ImageReader::open(path).map_err(|e| unreadable(e.to_string()))?;
    // The bytes decide on the format, not the extension.
    let reader = reader.with_guessed_format().map_err(|e| unreadable(e.to_string()))?;
    let picture = reader.decode().map_err(|e| unreadable(e.to_string()))?;
    if picture.width() == 0 || picture.height() == 0 {
        return Err(unreadable("it has no pixels".into()));
    }
    Ok(picture)
}

/// Why a folder gave no pairs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LoadError {
    /// The folder cannot be listed.
    Folder {
        /// The folder as it was given.
        folder: PathBuf,
        /// The sentence of the system.
        why: String,
    },
    /// The folder has no `left*`/`right*` pictures.
    NoPairs {
        /// The folder as it was given.
        folder: PathBuf,
        /// Entries that are something else.
        others: usize,
    },
    /// One side of a pair is missing.
    Unpaired {
        /// The side that is there.
        path: PathBuf,
        /// File name that was expected beside it.
        missing: String,
    },
    /// Two files claim to be the same side of the same pair.
    Twice {
        /// One.
        one: PathBuf,
        /// The other.
        other: PathBuf,
    },
    /// A picture has another size than the first left one.
    Size {
        /// The picture.
        path: PathBuf,
        /// Its width and height, px.
        got: (u32, u32),
        /// Width and height of the first left picture, px.
        first: (u32, u32),
    },
    /// A file is not a picture that can be decoded.
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The sentence of the decoder.
        why: String,
    },
    /// The pictures need more than [`MAX_BYTES`].
    TooMuch {
        /// The folder as it was given.
        folder: PathBuf,
        /// The picture that went over.
        path: PathBuf,
    },
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LoadError::Folder { folder, why } => {
                write!(
                    f,
                    "{}: cannot list this folder: {why}; name a folder with left*/right* pictures",
                    folder.display()
                )
            }
            LoadError::NoPairs { folder, others } => write!(
                f,
                "{}: no left*/right* .png or .jpg files here ({others} other entries): name left1.png, right1.png, …",
                folder.display()
            ),
            LoadError::Unpaired { path, missing } => {
                write!(
                    f,
                    "{}: its partner {missing} is not in the folder: add it or take this file away",
                    path.display()
                )
            }
            LoadError::Twice { one, other } => {
                write!(f, "{} and {} are the same side of one pair: keep one", one.display(), other.display())
            }
            LoadError::Size { path, got, first } => write!(
                f,
                "{}: {}×{} px, but the first left picture is {}×{} px: all pictures of a folder must have one size",
                path.display(),
                got.0,
                got.1,
                first.0,
                first.1
            ),
            LoadError::Unreadable { path, why } => {
                write!(f, "{}: cannot be decoded as PNG or JPEG: {why}", path.display())
            }
            LoadError::TooMuch { folder, path } => write!(
                f,
                "{}: the pictures up to {} take more than {} MiB decoded: use fewer or smaller ones",
                folder.display(),
                path.display(),
                MAX_BYTES >> 20
            ),
        }
    }
}

impl std::error::Error for LoadError {}

#[cfg(test)]
#[path = "pairs_tests.rs"]
mod tests;
