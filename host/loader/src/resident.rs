//! The file that the dynamic linker has in this process under the name of a library.
//!
//! Invariant: glibc knows a library by the name it was needed as and by its DT_SONAME, whatever its path and
//! however local it was opened: a library that needs a name that is there already gets that one. So a plugin
//! is loaded only where each name it needs is free, or stands for the very bytes the child tried.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use libloading::os::unix::{Library, RTLD_LAZY};

use super::Hash;
use super::load_fault::LoadFault;

/// The names of libraries that have to stand for the right ones before a plugin is opened.
pub(crate) struct Libraries {
    /// Names of the libraries it needs.
    pub needed: Vec<String>,
    /// Libraries it brings.
    pub brought: Vec<(String, Hash)>,
}

/// The beginning of `struct link_map` of <link.h>.
#[repr(C)]
struct LinkMap {
    address: usize,
    name: *const c_char,
}

/// Refuses a plugin for which the linker would take another library than the one it brings, or one from the
/// cache that another plugin brought.
pub(crate) fn check(
    Libraries { needed, brought }: &Libraries,
    cache: Option<&Path>,
) -> Result<(), LoadFault> {
    let other = |name: &String, file: PathBuf| {
        Err(LoadFault::OtherLibrary { name: name.clone(), loaded: file.display().to_string() })
    };
    for (name, hash) in brought {
        let Some(there) = loaded_as(name) else { continue };
        if std::fs::read(&there).ok().map(|bytes| Hash::of(&bytes)) != Some(*hash) {
            return other(name, there);
        }
    }
    for name in needed.iter().filter(|name| !brought.iter().any(|(own, _)| own == *name)) {
        if let Some(there) = loaded_as(name).filter(|there| cache.is_some_and(|dir| there.starts_with(dir))) {
            return other(name, there);
        }
    }
    Ok(())
}

/// The file of the library that is in this process under a name.
fn loaded_as(name: &str) -> Option<PathBuf> {
    // SAFETY: opens only what is loaded already, so that nothing is run.
    let library = unsafe { Library::open(Some(name), RTLD_LAZY | libc::RTLD_NOLOAD) }.ok()?;
    let handle: *mut c_void = library.into_raw();
    // SAFETY: the handle came from `into_raw` just now; it is closed with `library`, after the last use of
    // its map.
    let library = unsafe { Library::from_raw(handle) };
    let mut map: *const LinkMap = std::ptr::null();
    const LINK_MAP: c_int = libc::RTLD_DI_LINKMAP;
    // SAFETY: the handle is open, and this request writes a pointer to a `struct link_map`.
    let told = unsafe { libc::dlinfo(handle, LINK_MAP, (&raw mut map).cast()) };
    if told != 0 || map.is_null() {
        return None;
    }
    // SAFETY: the map of an open handle, whose name is a C string as long as it is open.
    let path = unsafe { CStr::from_ptr((*map).name) };
    let path = PathBuf::from(std::ffi::OsStr::from_bytes(path.to_bytes()));
    drop(library);
    Some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_c_library_is_in_the_process_and_an_invented_one_is_not() {
        let file = loaded_as("libc.so.6");
        assert!(file.is_some_and(|file| file.ends_with("libc.so.6")));
        assert_eq!(loaded_as("libtrocar_never_made.so.7"), None);
    }
}
