//! Journals that were put aside: a later one took their place, and they are the audit of what was before.
//!
//! Invariant: a journal that is put aside is moved and never written, and a greater number is a later one;
//! only the oldest go, beyond [`MOST`].

use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::FILE;

/// Journals that are kept aside.
pub(super) const MOST: usize = 8;
/// Text between the name of the file and a number.
const OLD: &str = ".old-";

/// Tells whether a file of that name is a journal that was put aside.
pub fn is_aside(name: &OsStr) -> bool {
    number(name).is_some()
}

/// Puts the journal of a directory aside, as the first `journal.redb.old-N` behind all that are there, and
/// returns its new name.
///
/// # Errors
/// The directory cannot be read or written. The journal then has its old name.
pub fn put_aside(dir: &Path) -> io::Result<PathBuf> {
    let mut numbers = Vec::new();
    for entry in fs::read_dir(dir)? {
        numbers.extend(number(&entry?.file_name()));
    }
    numbers.sort_unstable();
    let next = numbers.last().map_or(1, |last| last + 1);
    let aside = named(dir, next);
    fs::rename(dir.join(FILE), &aside)?;
    numbers.push(next);
    for oldest in &numbers[..numbers.len().saturating_sub(MOST)] {
        let oldest = named(dir, *oldest);
        match fs::remove_file(&oldest) {
            Ok(()) => log::warn!("{} is removed: {MOST} old journals are kept", oldest.display()),
            Err(e) => log::warn!("{} is not removed: {e}", oldest.display()),
        }
    }
    Ok(aside)
}

fn named(dir: &Path, number: u32) -> PathBuf {
    dir.join(format!("{FILE}{OLD}{number}"))
}

fn number(name: &OsStr) -> Option<u32> {
    let number: u32 = name.to_str()?.strip_prefix(FILE)?.strip_prefix(OLD)?.parse().ok()?;
    // One more is left for the next.
    (number < u32::MAX).then_some(number)
}
