//! A plugin whose file was taken, and the bytes that will be loaded.
//!
//! Invariant: none of its code has run. The hash is that of all bytes in the content, which are those that
//! were judged.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_plugin_api::manifest::{Class, Manifest};

use super::Hash;
use super::beside::Brought;
use super::file::FileBytes;
use super::inspect::Facts;
use super::resident::Libraries;

/// A plugin whose file was taken; none of its code has run.
pub struct ListedPlugin {
    pub manifest: Manifest,
    /// sha256 of the file; of a plugin that brings libraries one over theirs, too.
    pub hash: Hash,
    pub file: PathBuf,
    /// Bytes, those of the libraries it brings included.
    pub size: u64,
    pub warnings: Vec<String>,
    /// Names of the libraries it brings.
    pub brought: Vec<String>,
    /// Kept until the plugin is loaded, then the cache has them.
    content: Mutex<Option<Arc<Content>>>,
}

/// The bytes that go into the cache.
pub(crate) struct Content {
    pub bytes: Vec<u8>,
    pub brought: Vec<Brought>,
    needed: Vec<String>,
}

/// A class of a listed plugin.
#[derive(Clone, Debug)]
pub struct ClassRef {
    pub plugin: Arc<ListedPlugin>,
    index: usize,
}

impl ClassRef {
    pub(super) fn new(plugin: Arc<ListedPlugin>, index: usize) -> ClassRef {
        ClassRef { plugin, index }
    }

    /// `plugin/class`.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.plugin.name(), self.class().name)
    }

    pub fn class(&self) -> &Class {
        &self.plugin.manifest.classes[self.index]
    }

    pub(super) fn index(&self) -> usize {
        self.index
    }
}

impl ListedPlugin {
    /// Logs nothing; the warnings are those of file and facts.
    pub fn new(path: &Path, file: FileBytes, facts: Facts) -> ListedPlugin {
        let Facts { manifest, needed, brought, warnings } = facts;
        let hashes: Vec<_> = brought.iter().map(|library| (library.name.as_str(), library.hash)).collect();
        let hash = file.hash.with(&hashes);
        let size = file.bytes.len() + brought.iter().map(|library| library.bytes.len()).sum::<usize>();
        let names = brought.iter().map(|library| library.name.clone()).collect();
        ListedPlugin {
            manifest,
            hash,
            file: path.into(),
            size: size as u64,
            warnings: file.warnings.into_iter().chain(warnings).collect(),
            brought: names,
            content: Mutex::new(Some(Arc::new(Content { bytes: file.bytes, brought, needed }))),
        }
    }

    pub fn name(&self) -> &str {
        &self.manifest.name
    }

    pub(super) fn content(&self) -> Option<Arc<Content>> {
        self.content.lock().clone()
    }

    /// Its code is in the process: the cache has the bytes.
    pub(super) fn drop_content(&self) {
        *self.content.lock() = None;
    }
}

impl Content {
    #[cfg(test)]
    pub(super) fn of(bytes: &[u8], brought: &[(&str, &[u8])]) -> Content {
        let library = |(name, bytes): &(&str, &[u8])| Brought {
            name: name.to_string(),
            hash: Hash::of(bytes),
            bytes: bytes.to_vec(),
            warnings: Vec::new(),
        };
        Content { bytes: bytes.to_vec(), brought: brought.iter().map(library).collect(), needed: Vec::new() }
    }

    pub(super) fn libraries(&self) -> Libraries {
        let brought = self.brought.iter().map(|library| (library.name.clone(), library.hash)).collect();
        Libraries { needed: self.needed.clone(), brought }
    }
}

impl std::fmt::Debug for ListedPlugin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} ({})", self.name(), self.manifest.version, self.hash.short())
    }
}
