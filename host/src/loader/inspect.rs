//! Everything that can be said about a plugin file without running a byte of it.
//!
//! Invariant: pure over the file's bytes, except for the question which libraries this system has.

use std::path::{Path, PathBuf};

use trocar_plugin_api::manifest::Manifest;

use super::elf::{self, Elf};
use super::{Fault, Hash, PluginError, file, libraries, manifest};

/// What `trocar plugin inspect` shows.
#[derive(Clone, Debug)]
pub struct Inspection {
    pub file: PathBuf,
    /// Bytes.
    pub size: u64,
    pub hash: Hash,
    pub machine: &'static str,
    pub manifest: Manifest,
    /// Libraries it needs, all present on this system.
    pub needed: Vec<String>,
    /// What is not wrong enough to refuse it.
    pub warnings: Vec<String>,
}

/// What the bytes say.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    pub(crate) manifest: Manifest,
    pub(crate) needed: Vec<String>,
    pub(crate) warnings: Vec<String>,
}

/// Inspects a file somebody names; ownership and trust are not judged.
///
/// # Errors
/// The same sentence the file would be refused with in a plugin directory.
pub fn inspect_file(path: &Path) -> Result<Inspection, PluginError> {
    let refused = |fault| PluginError::Refused { file: path.to_path_buf(), fault };
    let read = file::read_named(path).map_err(refused)?;
    let facts = inspect_bytes(&read.bytes).map_err(refused)?;
    Ok(Inspection {
        file: path.to_path_buf(),
        size: read.bytes.len() as u64,
        hash: read.hash,
        machine: elf::own_machine(),
        manifest: facts.manifest,
        needed: facts.needed,
        warnings: facts.warnings,
    })
}

/// ELF, needed libraries, note, manifest.
pub(crate) fn inspect_bytes(bytes: &[u8]) -> Result<Facts, Fault> {
    let elf = Elf::parse(bytes)?;
    let note = elf.note.ok_or(Fault::NoNote)?;
    let (manifest, mut warnings) = manifest::read_warned(note)?;
    if manifest.panic == "unwind" && !elf.unwinds {
        return Err(Fault::PanicAbort);
    }
    if let Some(path) = elf.run_paths.iter().flat_map(|p| p.split(':')).find(|p| !is_origin(p)) {
        return Err(Fault::RunPath { path: path.to_string() });
    }
    for name in &elf.needed {
        if name.contains('/') {
            return Err(Fault::LibraryByPath { name: name.to_string() });
        }
        if !libraries::is_available(name) {
            return Err(Fault::MissingLibrary { name: name.to_string() });
        }
    }
    if let Some(symbol) = elf.unique_symbol {
        warnings.push(format!(
            "exports unique symbols (`{symbol}`), which all its versions would share: build it with \
             -fvisibility=hidden, or with g++ -fno-gnu-unique; it cannot be unloaded"
        ));
    }
    Ok(Facts { manifest, needed: elf.needed.iter().map(ToString::to_string).collect(), warnings })
}

/// `$ORIGIN` alone: it points into the cache, where no other library lies.
fn is_origin(path: &str) -> bool {
    matches!(path, "" | "$ORIGIN" | "${ORIGIN}" | "$ORIGIN/" | "${ORIGIN}/")
}
