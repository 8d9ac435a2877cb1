//! A test's own directories: plugins and state, gone with it.
//!
//! Invariant: no test reads or writes outside its world and the built, read-only things.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::Built;

/// A temporary directory with `plugins/` and `state/` in it.
pub struct World {
    root: TempDir,
}

impl World {
    /// A world whose plugin directory is empty.
    #[must_use]
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        let root = TempDir::with_prefix("trocar-").unwrap_or_else(|e| panic!("no temporary directory: {e}"));
        for part in ["plugins", "state"] {
            fs::create_dir(root.path().join(part)).unwrap_or_else(|e| panic!("cannot make {part}: {e}"));
        }
        Self { root }
    }

    /// A world with copies of these plugins in its plugin directory.
    #[must_use]
    pub fn with_plugins(names: &[&str]) -> Self {
        let world = Self::new();
        for name in names {
            world.drop_in(&Built::plugin(name));
        }
        world
    }

    #[must_use]
    pub fn path(&self, relative: &str) -> PathBuf {
        self.root.path().join(relative)
    }

    #[must_use]
    pub fn plugins(&self) -> PathBuf {
        self.path("plugins")
    }

    #[must_use]
    pub fn state(&self) -> PathBuf {
        self.path("state")
    }

    /// What `cp FILE plugins/` does.
    pub fn drop_in(&self, file: &Path) -> PathBuf {
        let name = file.file_name().unwrap_or_default();
        let to = self.plugins().join(name);
        fs::copy(file, &to).unwrap_or_else(|e| panic!("cp {} {}: {e}", file.display(), to.display()));
        to
    }

    /// Writes a file of the world, by its owner alone writable whatever the umask.
    pub fn write(&self, relative: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let to = self.path(relative);
        let written =
            fs::write(&to, bytes).and_then(|()| fs::set_permissions(&to, fs::Permissions::from_mode(0o644)));
        written.unwrap_or_else(|e| panic!("cannot write {}: {e}", to.display()));
        to
    }
}
