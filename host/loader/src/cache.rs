//! The only place the dynamic linker loads plugins from: `<state>/plugins/<sha256>/<name>.so`, and beside it
//! the libraries the plugin brings.
//!
//! Invariant: a path handed out and the libraries beside it hold exactly the bytes of that hash, are owned by
//! this user, and no other user can write them or a directory above them up to the cache's root. Files are
//! made complete under another name, then renamed. Only the plugin among them is executable. Versions that
//! cannot be asked for any more are removed.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

use super::file::{is_plugin_name, own_uid};
use super::listed::Content;
use super::{Fault, Hash, StoreError};

pub(crate) struct Cache {
    root: PathBuf,
}

impl Cache {
    /// Makes `<state>/plugins` if needed and proves that it can be written and executed from.
    ///
    /// # Errors
    /// Unwritable, foreign, or on a filesystem mounted noexec.
    pub(crate) fn open(state: &Path) -> Result<Cache, StoreError> {
        let root = state.join("plugins");
        let unwritable =
            |e: io::Error| StoreError::StateUnwritable { dir: state.into(), because: e.to_string() };
        private_dir(&root).map_err(unwritable)?;
        let meta = fs::metadata(&root).map_err(unwritable)?;
        if meta.uid() != own_uid() {
            return Err(StoreError::StateForeign { dir: root, owner: meta.uid() });
        }
        if meta.mode() & 0o077 != 0 {
            fs::set_permissions(&root, Permissions::from_mode(0o700)).map_err(unwritable)?;
        }
        let probe = root.join(temporary_name());
        OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&probe)
            .and_then(|_| fs::remove_file(&probe))
            .map_err(unwritable)?;
        if is_noexec(&root).map_err(unwritable)? {
            return Err(StoreError::StateNoExec { dir: root });
        }
        let root = root.canonicalize().map_err(unwritable)?;
        Ok(Cache { root })
    }

    /// Returns the cached file of `hash`; it and its libraries are written unless they are there already,
    /// whole and private.
    pub(crate) fn put(&self, hash: &Hash, name: &str, content: &Content) -> Result<PathBuf, Fault> {
        let dir = self.dir(hash);
        for library in &content.brought {
            keep(&dir.join(&library.name), &library.bytes, LIBRARY)?;
        }
        let path = dir.join(format!("{name}.so"));
        keep(&path, &content.bytes, PLUGIN)?;
        Ok(path)
    }

    /// Tells whether the vetting child of this host version found nothing wrong with `hash`.
    pub(crate) fn is_vetted(&self, hash: &Hash) -> bool {
        self.dir(hash).join(verdict_name()).exists()
    }

    /// Remembers a good verdict; a lost one only costs another look.
    pub(crate) fn set_vetted(&self, hash: &Hash) {
        if let Err(error) = write_whole(&self.dir(hash).join(verdict_name()), b"ok\n", 0o400) {
            log::debug!("the verdict on {} was not kept: {error}", hash.short());
        }
    }

    /// Forgets the verdict on `hash`; true when there was one.
    pub(crate) fn forget(&self, hash: &Hash) -> bool {
        fs::remove_file(self.dir(hash).join(verdict_name())).is_ok()
    }

    /// Removes all that is neither in `keep` nor the newest of the rest of its name: going back to the
    /// version before costs nothing.
    pub(crate) fn prune(&self, keep: &BTreeSet<Hash>) {
        let entries = fs::read_dir(&self.root).into_iter().flatten().flatten();
        let rest = entries.filter_map(|entry| {
            let hash = Hash::parse(entry.file_name().to_str()?)?;
            let made = entry.metadata().ok()?.modified().ok()?;
            (!keep.contains(&hash)).then(|| (plugin_in(&entry.path()), made, entry.path()))
        });
        let mut rest: Vec<_> = rest.collect();
        rest.sort();
        let last = |pair: &[(Option<OsString>, SystemTime, PathBuf)]| pair[0].0 != pair[1].0;
        let old = rest.windows(2).filter(|pair| !last(pair)).map(|pair| &pair[0].2);
        for dir in old {
            if let Err(error) = fs::remove_dir_all(dir) {
                log::debug!("an old version of a plugin stays in {}: {error}", dir.display());
            }
        }
    }

    fn dir(&self, hash: &Hash) -> PathBuf {
        self.root.join(hash.to_string())
    }
}

/// Grows when the child tries more than it did, so that no earlier verdict counts.
const RULES: u32 = 2;

/// Another host or ABI version judges anew.
fn verdict_name() -> String {
    use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR};
    format!("vetted-{}-{ABI_MAJOR}.{ABI_MINOR}-{RULES}", env!("CARGO_PKG_VERSION"))
}

/// Modes of a plugin's copy and of the libraries it brings: they tell the two kinds apart.
const PLUGIN: u32 = 0o500;
const LIBRARY: u32 = 0o400;

/// Returns the name of the plugin that lies there.
fn plugin_in(dir: &Path) -> Option<OsString> {
    let entries = fs::read_dir(dir).ok()?.flatten();
    let is_plugin = |entry: &fs::DirEntry| entry.metadata().is_ok_and(|meta| meta.mode() & 0o100 != 0);
    entries.filter(is_plugin).map(|entry| entry.file_name()).find(|name| is_plugin_name(name))
}

/// Writes a file unless it is there already, whole and private.
fn keep(path: &Path, bytes: &[u8], mode: u32) -> Result<(), Fault> {
    if is_whole(path, bytes) {
        return Ok(());
    }
    let write = || {
        path.parent().map_or(Ok(()), private_dir)?;
        write_whole(path, bytes, mode)
    };
    write().map_err(|e| Fault::Cache { path: path.into(), because: e.to_string() })
}

fn private_dir(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(path)
}

fn temporary_name() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    format!(".tmp-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed))
}

fn write_whole(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    let temporary = path.with_file_name(temporary_name());
    let write = || {
        let mut file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .custom_flags(libc::O_NOFOLLOW)
            .open(&temporary)?;
        file.write_all(bytes)?;
        file.set_permissions(Permissions::from_mode(mode))?;
        drop(file);
        fs::rename(&temporary, path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&temporary)))
}

/// Compares with the bytes in memory: cheaper than hashing the copy.
fn is_whole(path: &Path, bytes: &[u8]) -> bool {
    let read = || -> io::Result<bool> {
        let mut file: File = OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW).open(path)?;
        let meta = file.metadata()?;
        let private = meta.is_file() && meta.uid() == own_uid() && meta.mode() & 0o022 == 0;
        if !private || meta.len() != bytes.len() as u64 {
            return Ok(false);
        }
        let mut piece = vec![0; 64 << 10];
        for bytes in bytes.chunks(piece.len()) {
            let piece = &mut piece[..bytes.len()];
            file.read_exact(piece)?;
            if piece != bytes {
                return Ok(false);
            }
        }
        Ok(true)
    };
    read().unwrap_or(false)
}

fn is_noexec(path: &Path) -> io::Result<bool> {
    let file_system = rustix::fs::statvfs(path)?;
    Ok(file_system.f_flag.contains(rustix::fs::StatVfsMountFlags::NOEXEC))
}

#[cfg(test)]
#[path = "cache_tests.rs"]
mod tests;
