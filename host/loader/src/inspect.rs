//! Everything that can be told about a plugin file without running a byte of it.
//!
//! Invariant: pure over the bytes of the file and of the libraries it brings, except for the question which
//! libraries this system has.

use std::path::{Path, PathBuf};

use trocar_plugin_api::manifest::Manifest;

use super::beside::{self, Brought, ReadBeside};
use super::elf::{self, Elf};
use super::file::{self, SIZE_LIMIT};
use super::{Fault, Hash, PluginError, manifest};

/// Output of `trocar plugin inspect`.
#[derive(Clone, Debug)]
pub struct Inspection {
    pub file: PathBuf,
    /// Bytes.
    pub size: u64,
    pub hash: Hash,
    /// User id of its owner.
    pub owner: u32,
    /// Permission bits.
    pub mode: u32,
    pub machine: &'static str,
    pub manifest: Manifest,
    /// Libraries it needs, all beside it or on this system.
    pub needed: Vec<String>,
    /// Libraries beside it that are taken into the cache with it, each under its name.
    pub brought: Vec<(String, Hash)>,
    /// Faults that are no reason to refuse it.
    pub warnings: Vec<String>,
}

/// Facts the bytes tell.
pub struct Facts {
    pub manifest: Manifest,
    pub needed: Vec<String>,
    pub brought: Vec<Brought>,
    pub warnings: Vec<String>,
}

/// Inspects a file a user names; ownership and trust are not judged.
///
/// # Errors
/// The same sentence the file would be refused with in a plugin directory.
pub fn inspect_file(path: &Path) -> Result<Inspection, PluginError> {
    let refused = |fault| PluginError::Refused { file: path.to_path_buf(), fault };
    let read = file::read_named(path, SIZE_LIMIT).map_err(refused)?;
    let mut beside = |name: &str, room| file::read_named(&path.with_file_name(name), room);
    let facts = inspect_bytes(&read.bytes, &mut beside).map_err(refused)?;
    Ok(Inspection {
        file: path.to_path_buf(),
        size: read.bytes.len() as u64,
        hash: read.hash,
        owner: read.owner,
        mode: read.mode,
        machine: elf::own_machine(),
        manifest: facts.manifest,
        needed: facts.needed,
        brought: facts.brought.into_iter().map(|library| (library.name, library.hash)).collect(),
        warnings: facts.warnings,
    })
}

/// ELF, note, manifest, needed libraries; `beside` reads those that lie beside the file.
pub(crate) fn inspect_bytes(bytes: &[u8], beside: &mut ReadBeside) -> Result<Facts, Fault> {
    let elf = Elf::parse(bytes)?;
    let note = elf.note.ok_or(Fault::NoNote)?;
    let (manifest, mut warnings) = manifest::read_warned(note)?;
    if manifest.panic == "unwind" && !elf.unwinds {
        return Err(Fault::PanicAbort);
    }
    let own = format!("{}.so", manifest.name);
    let brought = beside::collect(&elf, &own, SIZE_LIMIT.saturating_sub(bytes.len() as u64), beside)?;
    warnings.extend(elf.unique_warning());
    warnings.extend(brought.iter().flat_map(|library| library.warnings.clone()));
    let needed = elf.needed.iter().map(ToString::to_string).collect();
    Ok(Facts { manifest, needed, brought, warnings })
}
