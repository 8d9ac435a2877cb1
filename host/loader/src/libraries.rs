//! Tells whether a library a plugin needs can be found by the dynamic linker, without loading anything.
//!
//! Invariant: may say "found" for a library that turns out unusable (the vetting child then says why), never
//! "missing" for one that `dlopen` would find.

use std::path::Path;

use trocar_plugin_api::environment::var_at_start;

/// The linker's cache of libraries outside its default directories.
const CACHE: &str = "/etc/ld.so.cache";
const CACHE_MAGIC: &[u8] = b"glibc-ld.so.cache1.1";
/// Header and entry of that cache, bytes.
const CACHE_HEADER: usize = 48;
const CACHE_ENTRY: usize = 24;

#[cfg(target_arch = "x86_64")]
const DEFAULT_DIRS: [&str; 6] =
    ["/lib/x86_64-linux-gnu", "/usr/lib/x86_64-linux-gnu", "/lib64", "/usr/lib64", "/lib", "/usr/lib"];
#[cfg(target_arch = "aarch64")]
const DEFAULT_DIRS: [&str; 6] =
    ["/lib/aarch64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/lib64", "/usr/lib64", "/lib", "/usr/lib"];

/// True when `soname` (no slash) lies where the dynamic linker looks.
pub(crate) fn is_available(soname: &str) -> bool {
    if DEFAULT_DIRS.iter().any(|dir| Path::new(dir).join(soname).exists()) {
        return true;
    }
    // The linker read it when this process began, or ignored it, since the program is secured.
    let extra = if is_secured() { None } else { var_at_start("LD_LIBRARY_PATH") };
    let extra = extra.filter(|paths| !paths.is_empty());
    // An empty path among others is the working directory, an empty variable is none.
    if extra.is_some_and(|paths| std::env::split_paths(&paths).any(|dir| dir.join(soname).exists())) {
        return true;
    }
    match std::fs::read(CACHE) {
        Ok(cache) => cache_lists(&cache, soname).unwrap_or(true),
        Err(_) => false,
    }
}

/// Tells whether the dynamic linker takes no search path from the environment: the program has capabilities
/// of its file, or runs as another user than the one that started it.
pub(crate) fn is_secured() -> bool {
    // SAFETY: asks what the kernel told this process when it began.
    unsafe { libc::getauxval(libc::AT_SECURE) != 0 }
}

/// Whether the cache lists the library; nothing when its format is unknown.
fn cache_lists(cache: &[u8], soname: &str) -> Option<bool> {
    // The old format, if present, comes first and the one of today follows it.
    let start = cache.windows(CACHE_MAGIC.len()).position(|w| w == CACHE_MAGIC)?;
    let cache = &cache[start..];
    let u32_at = |at: usize| Some(u32::from_le_bytes(cache.get(at..at + 4)?.try_into().ok()?) as usize);
    let count = u32_at(CACHE_MAGIC.len())?;
    let entries = cache.get(CACHE_HEADER..)?.chunks_exact(CACHE_ENTRY).take(count);
    for (i, _) in entries.enumerate() {
        let name_at = u32_at(CACHE_HEADER + i * CACHE_ENTRY + 4)?;
        let name = cache.get(name_at..)?;
        if name.starts_with(soname.as_bytes()) && name.get(soname.len()) == Some(&0) {
            return Some(true);
        }
    }
    Some(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_c_library_is_there_and_an_invented_one_is_not() {
        assert!(is_available("libc.so.6"));
        assert!(!is_available("libtrocar_never_made.so.7"));
    }

    #[test]
    fn a_library_named_in_the_linker_cache_is_found_and_a_damaged_cache_is_no_panic() {
        let mut cache = CACHE_MAGIC.to_vec();
        cache.extend(1u32.to_le_bytes());
        cache.resize(CACHE_HEADER, 0);
        let name_at = (CACHE_HEADER + CACHE_ENTRY) as u32;
        cache.extend(3u32.to_le_bytes());
        cache.extend(name_at.to_le_bytes());
        cache.resize(CACHE_HEADER + CACHE_ENTRY, 0);
        cache.extend(b"libspectro.so.2\0");
        assert_eq!(cache_lists(&cache, "libspectro.so.2"), Some(true));
        assert_eq!(cache_lists(&cache, "libspectro.so"), Some(false));
        for len in 0..cache.len() {
            cache_lists(&cache[..len], "libspectro.so.2");
        }
    }
}
