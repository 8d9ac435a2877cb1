//! Plugin files that were brought, by the hash of their contents, and the directories of processes made of
//! them.
//!
//! Invariant: a file under a hash has these contents: it gets its name when all of it is there and was looked
//! at. A process has links to the files that it was started with; a file that no process has is swept at the
//! next start of the agent.

use std::fs::{self, DirBuilder, File};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use sha2::{Digest, Sha256};
use trocar_loader::Hash;
use trocar_model::Refusal;

/// Largest plugin file, bytes.
const LARGEST: u64 = 1 << 30;
/// Ending of files on their way.
const COMING: &str = "coming";

/// A plugin file of a process.
#[derive(Clone, Debug, PartialEq)]
pub struct PluginFile {
    /// `libNAME.so`.
    pub name: String,
    pub hash: Hash,
    /// Number of its directory among those of the process.
    pub directory: u32,
}

impl PluginFile {
    /// Tells whether this is the name of a plugin file, or of a library beside one, and of nothing elsewhere.
    pub fn is_name(name: &str) -> bool {
        let is_library = match name.rsplit_once(".so") {
            Some((_, version)) => version.chars().all(|c| c == '.' || c.is_ascii_digit()),
            None => false,
        };
        is_library && name.len() <= 255 && !name.starts_with('.') && !name.contains(['/', '\0'])
    }
}

/// The files that were brought.
#[derive(Debug)]
pub(super) struct Files {
    dir: PathBuf,
    /// Number of the next file on its way.
    next: AtomicU64,
}

impl Files {
    /// Opens the directory, and sweeps what no process has.
    pub(super) fn open(dir: PathBuf) -> io::Result<Files> {
        make(&dir)?;
        for entry in fs::read_dir(&dir)?.flatten() {
            if entry.metadata().is_ok_and(|file| file.is_file() && file.nlink() == 1) {
                fs::remove_file(entry.path())?;
            }
        }
        Ok(Files { dir, next: AtomicU64::new(0) })
    }

    fn of(&self, hash: &Hash) -> PathBuf {
        self.dir.join(hash.to_string())
    }

    pub(super) fn has(&self, hash: &Hash) -> bool {
        self.of(hash).is_file()
    }

    /// Begins to take a file in.
    ///
    /// # Errors
    /// The disk is full, or cannot be written.
    pub(super) fn begin(&self, hash: Hash) -> Result<Coming, Refusal> {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let path = self.dir.join(format!("{number}.{COMING}"));
        let file = File::options().create(true).truncate(true).write(true).mode(0o600).open(&path);
        let file = file.map_err(|e| unwritten(&path, &e))?;
        Ok(Coming { file, path, to: self.of(&hash), hash, hasher: Sha256::new(), bytes: 0 })
    }

    /// Makes the directories of a process out of files that are here; returns them.
    ///
    /// # Errors
    /// A name is none of a plugin file, two files have one name, a file is not here, or the disk cannot be
    /// written.
    pub(super) fn lay_out(&self, plugins: &[PluginFile], to: &Path) -> Result<Vec<PathBuf>, Refusal> {
        let unwritten = |e: io::Error| unwritten(to, &e);
        // The directories of an earlier start; its process has ended.
        match fs::remove_dir_all(to) {
            Err(e) if e.kind() != ErrorKind::NotFound => return Err(unwritten(e)),
            _ => {}
        }
        let mut dirs = Vec::new();
        for plugin in plugins {
            let PluginFile { name, hash, directory } = plugin;
            if !PluginFile::is_name(name) {
                return Err(invalid(format!("{name:?} is no name of a plugin file")));
            }
            let dir = to.join(directory.to_string());
            make(&dir).map_err(unwritten)?;
            if !dirs.contains(&dir) {
                dirs.push(dir.clone());
            }
            match fs::hard_link(self.of(hash), dir.join(name)) {
                Ok(()) => {}
                Err(e) if e.kind() == ErrorKind::NotFound => {
                    return Err(invalid(format!("{name} ({}) was not brought", hash.short())));
                }
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {
                    return Err(invalid(format!("{name} is there twice")));
                }
                Err(e) => return Err(unwritten(e)),
            }
        }
        Ok(dirs)
    }
}

/// A file on its way; forgotten where it is dropped before its end.
#[derive(Debug)]
pub struct Coming {
    file: File,
    path: PathBuf,
    to: PathBuf,
    hash: Hash,
    hasher: Sha256,
    bytes: u64,
}

impl Coming {
    /// Takes the next bytes.
    ///
    /// # Errors
    /// There are too many, or the disk is full.
    pub fn take(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        self.bytes += bytes.len() as u64;
        if self.bytes > LARGEST {
            return Err(brought(format!("a plugin file has at most {} MiB", LARGEST >> 20)));
        }
        self.hasher.update(bytes);
        self.file.write_all(bytes).map_err(|e| unwritten(&self.path, &e))
    }

    /// Keeps it.
    ///
    /// # Errors
    /// Its contents are others than was said, or the disk cannot be written.
    pub fn finish(self) -> Result<(), Refusal> {
        let mut found = [0; 32];
        found.copy_from_slice(&self.hasher.clone().finalize());
        let found = Hash::from_bytes(found);
        if found != self.hash {
            let said = self.hash.short();
            return Err(brought(format!("its contents have the hash {}, not {said}", found.short())));
        }
        // Others may read it, as they may read a plugin file that was built here; nobody writes it.
        let renamed = fs::set_permissions(&self.path, fs::Permissions::from_mode(0o500))
            .and_then(|()| self.file.sync_all())
            .and_then(|()| fs::rename(&self.path, &self.to));
        renamed.map_err(|e| unwritten(&self.to, &e))
    }
}

impl Drop for Coming {
    fn drop(&mut self) {
        // It has its name where it was kept.
        let _ = fs::remove_file(&self.path);
    }
}

/// Makes a directory that only its user looks into.
pub(super) fn make(dir: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(dir)
}

fn invalid(why: String) -> Refusal {
    Refusal::ArgumentInvalid { what: "the process".into(), why, field: "plugins".into() }
}

fn brought(why: String) -> Refusal {
    Refusal::ArgumentInvalid { what: "the plugin file".into(), why, field: "bytes".into() }
}

pub(super) fn unwritten(at: &Path, e: &io::Error) -> Refusal {
    Refusal::Internal { text: format!("{} cannot be written on the agent's machine: {e}", at.display()) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn files() -> (tempfile::TempDir, Files) {
        let temp = tempfile::tempdir().unwrap();
        let files = Files::open(temp.path().join("files")).unwrap();
        (temp, files)
    }

    fn bring(files: &Files, bytes: &[u8]) -> Hash {
        let hash = Hash::of(bytes);
        let mut coming = files.begin(hash).unwrap();
        bytes.chunks(3).for_each(|part| coming.take(part).unwrap());
        coming.finish().unwrap();
        hash
    }

    fn plugin(name: &str, hash: Hash, directory: u32) -> PluginFile {
        PluginFile { name: name.into(), hash, directory }
    }

    #[test]
    fn a_file_is_there_when_all_of_it_is_and_has_the_hash_that_was_said() {
        let (temp, files) = files();
        let hash = bring(&files, b"one plugin");
        assert!(files.has(&hash));
        let mut other = files.begin(Hash::of(b"another")).unwrap();
        other.take(b"anotheR").unwrap();
        let refusal = other.finish().unwrap_err();
        assert!(refusal.to_string().contains("have the hash"), "{refusal}");
        assert!(!files.has(&Hash::of(b"another")));
        drop(files.begin(Hash::of(b"cut off")).unwrap());
        let left = fs::read_dir(temp.path().join("files")).unwrap().count();
        assert_eq!(left, 1, "nothing is left of what did not come");
    }

    #[test]
    fn a_process_has_its_files_by_their_names_and_those_before_no_more() {
        let (temp, files) = files();
        let (old, new) = (bring(&files, b"old"), bring(&files, b"new"));
        let to = temp.path().join("cart");
        let of_both = files.lay_out(&[plugin("liba.so", old, 0), plugin("libb.so", old, 0)], &to).unwrap();
        assert_eq!(of_both, [to.join("0")]);
        let dirs = files.lay_out(&[plugin("liba.so", new, 0), plugin("liba.so", old, 2)], &to).unwrap();
        assert_eq!(dirs, [to.join("0"), to.join("2")]);
        assert_eq!(fs::read(to.join("0/liba.so")).unwrap(), b"new");
        assert!(!to.join("0/libb.so").exists());
        drop(files);
        fs::remove_dir_all(to.join("2")).unwrap();
        let again = Files::open(temp.path().join("files")).unwrap();
        assert!(again.has(&new) && !again.has(&old), "what no process has is swept");
    }

    #[test]
    fn names_that_lead_elsewhere_and_files_that_are_not_there_are_refused() {
        let (temp, files) = files();
        let (hash, to) = (bring(&files, b"x"), temp.path().join("cart"));
        assert!(PluginFile::is_name("liba.so.1.2"), "a library beside one");
        for name in ["../liba.so", "/liba.so", ".so", ".liba.so", "liba", "liba.so.x", "liba.so\0.so", ""] {
            let refusal = files.lay_out(&[plugin(name, hash, 0)], &to).unwrap_err();
            assert!(refusal.to_string().contains("no name of a plugin file"), "{name}: {refusal}");
        }
        let refusal = files.lay_out(&[plugin("liba.so", Hash::of(b"y"), 0)], &to).unwrap_err();
        assert!(refusal.to_string().contains("was not brought"), "{refusal}");
        let twice = [plugin("liba.so", hash, 0), plugin("liba.so", hash, 0)];
        assert!(files.lay_out(&twice, &to).unwrap_err().to_string().contains("twice"));
    }
}
