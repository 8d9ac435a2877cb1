//! Reads a plugin file exactly once, through one descriptor, without following it out of its directory.
//!
//! Invariant: every later decision is about the bytes returned here; the dropped file is never opened again.
//! Opening never blocks (a FIFO) and the size is checked before memory is asked for.

use std::ffi::{CString, OsStr};
use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use super::trust::Ownership;
use super::{Fault, Hash, Trust};

/// Most bytes of a plugin with all the libraries it brings.
pub(crate) const SIZE_LIMIT: u64 = 256 << 20;

/// A plugin file in memory.
pub struct FileBytes {
    pub bytes: Vec<u8>,
    pub hash: Hash,
    /// User id.
    pub owner: u32,
    /// Permission bits.
    pub mode: u32,
    pub warnings: Vec<String>,
}

/// A plugin directory, held open so that one scan looks at one directory.
pub(crate) struct PluginDir {
    path: PathBuf,
    fd: OwnedFd,
}

/// Values that change when a file is written, replaced, chmod'ed or touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Signature {
    device: u64,
    inode: u64,
    pub size: u64,
    /// Both in ns since the epoch.
    pub modified_ns: i128,
    changed_ns: i128,
}

impl Signature {
    pub(crate) fn of(meta: &Metadata) -> Signature {
        let ns = |s: i64, ns: i64| i128::from(s) * 1_000_000_000 + i128::from(ns);
        Signature {
            device: meta.dev(),
            inode: meta.ino(),
            size: meta.len(),
            modified_ns: ns(meta.mtime(), meta.mtime_nsec()),
            changed_ns: ns(meta.ctime(), meta.ctime_nsec()),
        }
    }

    /// None where there is no file.
    pub(crate) fn at(path: &Path) -> Option<Signature> {
        std::fs::metadata(path).ok().as_ref().map(Signature::of)
    }
}

impl PluginDir {
    /// # Errors
    /// Missing, not a directory, not readable.
    pub(crate) fn open(path: &Path) -> io::Result<PluginDir> {
        let dir = std::fs::OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_DIRECTORY | libc::O_CLOEXEC)
            .open(path)?;
        Ok(PluginDir { path: path.to_path_buf(), fd: dir.into() })
    }

    /// Names that may be plugins, sorted: no dotfiles, ending `.so`.
    pub(crate) fn names(&self) -> io::Result<Vec<std::ffi::OsString>> {
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.path)? {
            let name = entry?.file_name();
            if is_plugin_name(&name) {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }

    /// Reads `name`; refuses anything but a regular file of at most `room` bytes that `trust` takes.
    pub(crate) fn read(&self, name: &OsStr, trust: &Trust, room: u64) -> Result<FileBytes, Fault> {
        let file = self.open_beneath(name, trust).map_err(open_fault)?;
        let meta = file.metadata().map_err(unreadable)?;
        check_regular(&meta, room)?;
        let warnings = trust.judge_owner(Ownership {
            uid: meta.uid(),
            mode: meta.mode() & 0o7777,
            own_uid: own_uid(),
        })?;
        let (bytes, hash) = read_all(&file, &meta)?;
        trust.judge_hash(&hash)?;
        Ok(FileBytes { bytes, hash, owner: meta.uid(), mode: meta.mode() & 0o7777, warnings })
    }

    fn open_beneath(&self, name: &OsStr, trust: &Trust) -> io::Result<File> {
        let name = CString::new(name.as_bytes())?;
        let flags = libc::O_RDONLY | libc::O_NONBLOCK | libc::O_CLOEXEC;
        // SAFETY: `open_how` is a plain struct of integers for which all zeros is valid.
        let mut how: libc::open_how = unsafe { std::mem::zeroed() };
        how.flags = flags as u64;
        how.resolve = libc::RESOLVE_BENEATH
            | libc::RESOLVE_NO_MAGICLINKS
            | if trust.refuses_links() { libc::RESOLVE_NO_SYMLINKS } else { 0 };
        // SAFETY: the descriptor is open, the name is zero-terminated, and the size is that of `how`.
        let fd = unsafe {
            libc::syscall(
                libc::SYS_openat2,
                self.fd.as_raw_fd(),
                name.as_ptr(),
                &raw const how,
                size_of_val(&how),
            )
        };
        if fd >= 0 {
            // SAFETY: the kernel has just given this descriptor to us alone.
            return Ok(unsafe { File::from_raw_fd(fd as i32) });
        }
        let error = io::Error::last_os_error();
        match error.raw_os_error() {
            // Kernels before 5.6, and sandboxes that do not know the call: no link is followed at all.
            Some(libc::ENOSYS | libc::EPERM) => self.open_no_follow(&name, flags),
            _ => Err(error),
        }
    }

    fn open_no_follow(&self, name: &CString, flags: i32) -> io::Result<File> {
        // SAFETY: the descriptor is open and the name is zero-terminated.
        let fd = unsafe { libc::openat(self.fd.as_raw_fd(), name.as_ptr(), flags | libc::O_NOFOLLOW) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the kernel has just given this descriptor to us alone.
        Ok(unsafe { File::from_raw_fd(fd) })
    }
}

/// Reads one file that a user names: links are followed and the owner is not judged.
pub(crate) fn read_named(path: &Path, room: u64) -> Result<FileBytes, Fault> {
    let file = std::fs::OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
        .open(path)
        .map_err(open_fault)?;
    let meta = file.metadata().map_err(unreadable)?;
    check_regular(&meta, room)?;
    let (bytes, hash) = read_all(&file, &meta)?;
    Ok(FileBytes { bytes, hash, owner: meta.uid(), mode: meta.mode() & 0o7777, warnings: Vec::new() })
}

pub(crate) fn is_plugin_name(name: &OsStr) -> bool {
    let name = name.as_bytes();
    !name.starts_with(b".") && name.ends_with(b".so")
}

/// Tells whether a library that a plugin brings may have this name: `libvendor.so`, `libvendor.so.1`. No
/// other file of the cache has such a name.
pub(crate) fn is_library_name(name: &OsStr) -> bool {
    let bytes = name.as_bytes();
    is_plugin_name(name) || (!bytes.starts_with(b".") && bytes.windows(4).any(|part| part == b".so."))
}

/// The user this process acts as.
pub(crate) fn own_uid() -> u32 {
    // SAFETY: geteuid has no preconditions and cannot fail.
    unsafe { libc::geteuid() }
}

fn check_regular(meta: &Metadata, room: u64) -> Result<(), Fault> {
    let kind = meta.file_type();
    if !kind.is_file() {
        let kind = match () {
            () if kind.is_dir() => "a directory",
            () if kind.is_fifo() => "a FIFO",
            () if kind.is_socket() => "a socket",
            () => "a device",
        };
        return Err(Fault::NotRegular { kind });
    }
    if meta.len() > room {
        return Err(Fault::TooLarge { size: meta.len(), limit: SIZE_LIMIT });
    }
    Ok(())
}

fn read_all(file: &File, meta: &Metadata) -> Result<(Vec<u8>, Hash), Fault> {
    let mut file = file;
    let mut bytes = vec![0; meta.len() as usize];
    file.read_exact(&mut bytes).map_err(|e| match e.kind() {
        io::ErrorKind::UnexpectedEof => Fault::ChangedWhileRead,
        _ => unreadable(e),
    })?;
    let after = file.metadata().map_err(unreadable)?;
    let same = |a: Signature, b: Signature| a.size == b.size && a.modified_ns == b.modified_ns;
    if !same(Signature::of(meta), Signature::of(&after)) {
        return Err(Fault::ChangedWhileRead);
    }
    let hash = Hash::of(&bytes);
    Ok((bytes, hash))
}

fn unreadable(error: io::Error) -> Fault {
    let because = error.to_string();
    if is_shortage(&error) { Fault::Shortage { because } } else { Fault::Unreadable { because } }
}

/// The process or the machine has no file or no memory left.
pub(crate) fn is_shortage(error: &io::Error) -> bool {
    matches!(error.raw_os_error(), Some(libc::EMFILE | libc::ENFILE | libc::ENOMEM))
}

fn open_fault(error: io::Error) -> Fault {
    match error.raw_os_error() {
        Some(libc::ENOENT) => Fault::Vanished,
        Some(libc::ELOOP) => Fault::Symlink,
        Some(libc::EXDEV) => Fault::SymlinkLeadsOut,
        Some(libc::ENXIO) => Fault::NotRegular { kind: "a socket" },
        _ => unreadable(error),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn without_openat2_no_link_is_followed() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a.so"), b"x").unwrap();
        std::os::unix::fs::symlink("a.so", dir.path().join("b.so")).unwrap();
        let opened = PluginDir::open(dir.path()).unwrap();
        let open = |name: &str| opened.open_no_follow(&CString::new(name).unwrap(), libc::O_RDONLY);
        assert!(open("a.so").is_ok());
        assert_eq!(open_fault(open("b.so").unwrap_err()), Fault::Symlink);
    }
}
