//! A row's own directories, with copies of the plugins it uses; gone with it.
//!
//! Invariant: every process of a row names this directory in its command line, so whoever is left of it can
//! be found.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::files;

pub(crate) struct World {
    root: TempDir,
}

impl World {
    pub(crate) fn new(plugins: &[&str]) -> Result<World, String> {
        let root =
            TempDir::with_prefix("trocar-torture-").map_err(|e| format!("no temporary directory: {e}"))?;
        let world = World { root };
        for part in ["plugins", "state"] {
            fs::create_dir(world.path(part)).map_err(|e| format!("cannot make {part}: {e}"))?;
        }
        for name in plugins {
            let from = files::plugin(name)?;
            let to = world.path("plugins").join(from.file_name().unwrap_or_default());
            fs::copy(&from, &to).map_err(|e| format!("cp {} {}: {e}", from.display(), to.display()))?;
        }
        Ok(world)
    }

    pub(crate) fn root(&self) -> &Path {
        self.root.path()
    }

    pub(crate) fn path(&self, relative: &str) -> PathBuf {
        self.root.path().join(relative)
    }

    /// The same as text, for a configuration.
    pub(crate) fn text(&self, relative: &str) -> String {
        self.path(relative).to_string_lossy().into_owned()
    }

    /// Writes a file that only its owner may write, whatever the umask.
    pub(crate) fn write(&self, relative: &str, text: &str) -> Result<PathBuf, String> {
        let to = self.path(relative);
        let written =
            fs::write(&to, text).and_then(|()| fs::set_permissions(&to, fs::Permissions::from_mode(0o644)));
        written.map_err(|e| format!("cannot write {}: {e}", to.display()))?;
        Ok(to)
    }
}
