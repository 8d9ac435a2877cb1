//! The libraries a plugin brings: those it needs, itself or through one of them, that lie in its own
//! directory.
//!
//! Invariant: decides where the dynamic linker will find each library, by its rules and without it: breadth
//! first, the first one found under a name serves all that need that name. A brought library is judged like
//! the plugin.

use std::collections::{BTreeSet, VecDeque};

use super::elf::Elf;
use super::file::{FileBytes, is_library_name};
use super::{Fault, Hash, libraries};

/// A library beside a plugin, read and judged.
pub struct Brought {
    /// The name it is needed by.
    pub name: String,
    pub hash: Hash,
    pub bytes: Vec<u8>,
    pub warnings: Vec<String>,
}

/// More libraries than this are not read.
const LIMIT: usize = 64;

/// Reads a library of the plugin's directory that may have so many bytes; [`Fault::Vanished`] when there is
/// none.
pub(crate) type ReadBeside<'a> = dyn FnMut(&str, u64) -> Result<FileBytes, Fault> + 'a;

/// A name that a library needs.
struct Want {
    name: String,
    /// The brought library that needs it; none for the plugin.
    by: Option<String>,
    is_beside: bool,
    /// The linker looks there for the libraries that need it, too (DT_RPATH).
    inherited: bool,
}

/// Returns everything the plugin brings, in the order the linker finds it. `own` is the name of the plugin's
/// copy, `room` the most bytes all together.
///
/// # Errors
/// A search path other than `$ORIGIN`; a library that is nowhere; a brought one that a plugin could not be.
pub(crate) fn collect(
    plugin: &Elf,
    own: &str,
    mut room: u64,
    read: &mut ReadBeside,
) -> Result<Vec<Brought>, Fault> {
    let (mut brought, mut known) = (Vec::new(), BTreeSet::new());
    let mut queue = VecDeque::from(wants(plugin, None, false)?);
    while let Some(want) = queue.pop_front() {
        if !known.insert(want.name.clone()) {
            continue;
        }
        let found = match want.is_beside && is_library_name(want.name.as_ref()) {
            true => some(read(&want.name, room)).map_err(|fault| of(&want.name, fault))?,
            false => None,
        };
        let Some(file) = found else {
            match libraries::is_available(&want.name) {
                true => continue,
                false => return Err(missing(want)),
            }
        };
        if want.name == own {
            return Err(of(&want.name, Fault::NameOfTheCopy));
        }
        if brought.len() == LIMIT {
            return Err(Fault::TooManyLibraries { limit: LIMIT });
        }
        let judged = || {
            let elf = Elf::parse(&file.bytes)?;
            Ok((wants(&elf, Some(&want.name), want.inherited)?, elf.unique_warning()))
        };
        let (more, unique) = judged().map_err(|fault| of(&want.name, fault))?;
        queue.extend(more);
        room = room.saturating_sub(file.bytes.len() as u64);
        let warnings = file.warnings.into_iter().chain(unique);
        let warnings = warnings.map(|warning| format!("its library {}: {warning}", want.name)).collect();
        brought.push(Brought { name: want.name, hash: file.hash, bytes: file.bytes, warnings });
    }
    Ok(brought)
}

fn some(read: Result<FileBytes, Fault>) -> Result<Option<FileBytes>, Fault> {
    match read {
        Err(Fault::Vanished) => Ok(None),
        read => read.map(Some),
    }
}

fn of(name: &str, fault: Fault) -> Fault {
    Fault::Library { name: name.into(), fault: Box::new(fault) }
}

fn missing(want: Want) -> Fault {
    let fault = Fault::MissingLibrary { name: want.name };
    want.by.map_or(fault.clone(), |by| of(&by, fault))
}

/// Returns the needs of a library, and whether the linker looks for them beside it.
fn wants(elf: &Elf, by: Option<&str>, inherited: bool) -> Result<Vec<Want>, Fault> {
    let has_runpath = !elf.runpaths.is_empty();
    let by_runpath = leads_beside(&elf.runpaths)?;
    let by_rpath = leads_beside(&elf.rpaths)?;
    // A library's DT_RUNPATH makes every DT_RPATH void for it, its own and that of the libraries that need
    // it.
    let inherited = !has_runpath && (by_rpath || inherited);
    let want = |name: &&str| match name.contains('/') {
        true => Err(Fault::LibraryByPath { name: name.to_string() }),
        false => Ok(Want {
            name: name.to_string(),
            by: by.map(str::to_string),
            is_beside: by_runpath || inherited,
            inherited,
        }),
    };
    elf.needed.iter().map(want).collect()
}

/// Tells whether a search path is the library's own directory; any other directory is refused. An empty
/// element would be the working directory.
fn leads_beside(paths: &[&str]) -> Result<bool, Fault> {
    let mut elements = paths.iter().filter(|path| !path.is_empty()).flat_map(|path| path.split(':'));
    let is_origin = |path: &&str| matches!(path.trim_end_matches('/'), "$ORIGIN" | "${ORIGIN}");
    match elements.clone().find(|path| !is_origin(path)) {
        Some(path) => Err(Fault::RunPath { path: path.to_string() }),
        None => Ok(elements.next().is_some()),
    }
}

#[cfg(test)]
#[path = "beside_tests.rs"]
mod tests;
