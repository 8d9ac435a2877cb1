//! Files that only their user reads, replaced as a whole.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::time::SystemTime;

/// Writes `content` in place of what is there; others never see a part of it. `secret`: only this user reads
/// it.
pub(crate) fn write(path: &Path, content: &str, secret: bool) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = path.with_file_name(format!(".{name}.{}", std::process::id()));
    let mode = if secret { 0o600 } else { 0o644 };
    let done = (|| {
        // A killed process of this number may have left something there, which is not followed.
        match fs::remove_file(&new) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
        let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&new)?;
        file.write_all(content.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, path)
    })();
    if done.is_err() {
        let _ = fs::remove_file(&new);
    }
    done
}

/// Reads a file that holds a key.
///
/// # Errors
/// It cannot be read, or others can read it as well.
pub(crate) fn read_secret(path: &Path) -> Result<String, String> {
    let said = |e: io::Error| format!("{} cannot be read: {e}", path.display());
    let file = File::open(path).map_err(said)?;
    if !is_own(&file.metadata().map_err(said)?, 0o077) {
        return Err(format!(
            "{} holds a key, and others may read or change it: `chmod 600 {}`",
            path.display(),
            path.display()
        ));
    }
    io::read_to_string(file).map_err(said)
}

/// Tells whether a file is this user's or root's, and others have none of these rights in it.
pub(crate) fn is_own(file: &Metadata, rights: u32) -> bool {
    let own = [rustix::process::geteuid().as_raw(), 0];
    own.contains(&file.uid()) && file.mode() & rights == 0
}

/// Tells one content of a file from another that took its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    written: SystemTime,
    inode: u64,
    length: u64,
}

impl Stamp {
    /// `None`: there is no such file.
    pub(crate) fn of(path: &Path) -> Option<Stamp> {
        let file = path.metadata().ok()?;
        Some(Stamp { written: file.modified().ok()?, inode: file.ino(), length: file.len() })
    }
}
