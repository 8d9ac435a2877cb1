//! Files that only their user reads, replaced as a whole.

use std::fs::{self, File, OpenOptions};
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
        // What a killed process of this number left there is not followed, whatever it is.
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
    let open_to_others = file.metadata().map_err(said)?.mode() & 0o077;
    if open_to_others != 0 {
        return Err(format!(
            "{} holds a key, and others may read or change it: `chmod 600 {}`",
            path.display(),
            path.display()
        ));
    }
    io::read_to_string(file).map_err(said)
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
