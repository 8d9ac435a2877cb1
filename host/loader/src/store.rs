//! The plugin store of a host: the content of its directories, and the way from a class name to a loaded
//! class.
//!
//! Invariant: a file's bytes are read once; the loaded bytes are those that were hashed and inspected. One
//! scan at a time, and its news is told in order. Locks are never held while a plugin's code or a child
//! process runs, except that plugin's own.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::{Mutex, RwLock};

use super::cache::Cache;
use super::host_table::{LogFn, log_to_crate};
use super::listed::{ClassRef, Content, ListedPlugin};
use super::load::{self, LoadedClass, LoadedPlugin};
use super::scan::{SETTLE, Scanner, is_called};
use super::vet::{self, VET_LIMIT};
use super::{CatalogChange, Fault, Hash, PluginEntry, PluginError, StoreError, Trust, catalog, closing};

/// Source of plugins, and the rules for them.
#[derive(Clone, Debug)]
pub struct PluginStoreConfig {
    /// Watched directories; the first one wins where two files have the same plugin name.
    pub dirs: Vec<PathBuf>,
    /// State directory of this process; plugins are cached in `<state>/plugins`.
    pub state: PathBuf,
    pub trust: Trust,
    /// The binary that knows the hidden subcommand `__vet`: `std::env::current_exe()` in a host.
    pub host_exe: PathBuf,
    /// Log of plugins outside their instances.
    pub log: LogFn,
}

impl PluginStoreConfig {
    /// Trust `dev`, lines to the `log` crate.
    pub fn new(dirs: Vec<PathBuf>, state: PathBuf, host_exe: PathBuf) -> PluginStoreConfig {
        PluginStoreConfig { dirs, state, trust: Trust::Dev, host_exe, log: log_to_crate }
    }
}

/// See the module's documentation. All calls may block on files; never from a real-time thread.
pub struct PluginStore {
    config: PluginStoreConfig,
    vet_limit: Duration,
    cache: Cache,
    scanner: Mutex<Scanner>,
    entries: RwLock<Arc<Vec<PluginEntry>>>,
    /// One slot per file content, so that a slow plugin does not hold up another.
    loaded: Mutex<HashMap<Hash, Slot>>,
    /// Contents whose code is in the process.
    present: Mutex<BTreeSet<Hash>>,
    /// The fault of a content's code when it was tried last, as long as it is listed. A fault of the file
    /// itself is said again at once, and the file not tried again.
    failed: Mutex<HashMap<Hash, Fault>>,
    pub(super) observers: Mutex<Vec<Observer>>,
    /// Files seen to be written and not yet closed.
    pub(super) writing: Mutex<BTreeSet<PathBuf>>,
}

type Slot = Arc<Mutex<Option<Arc<LoadedPlugin>>>>;

pub(super) struct Observer {
    pub(super) id: u64,
    pub(super) tell: Box<dyn Fn(&CatalogChange) + Send>,
}

/// Returns all that looks like a plugin in these directories, at one look: nothing is tried, and nothing
/// kept.
///
/// # Errors
/// A directory that is missing, no directory, unreadable.
pub fn look(dirs: &[PathBuf], trust: &Trust) -> Result<Vec<PluginEntry>, StoreError> {
    dirs.iter().try_for_each(|dir| check_dir(dir))?;
    let (mut scanner, none) = (Scanner::default(), BTreeSet::new());
    let mut scan = scanner.scan(dirs, trust, &none, &none);
    for _ in 0..2 {
        if scan.unsettled {
            std::thread::sleep(SETTLE);
            scan = scanner.scan(dirs, trust, &none, &none);
        }
    }
    Ok(catalog::assemble(&[], scan.findings))
}

impl PluginStore {
    /// Checks the directories and takes the first look into them.
    ///
    /// # Errors
    /// A directory that is missing, no directory, unreadable; a state directory that cannot hold plugins.
    pub fn open(config: PluginStoreConfig) -> Result<Arc<PluginStore>, StoreError> {
        PluginStore::open_with_limit(config, VET_LIMIT)
    }

    pub fn open_with_limit(
        config: PluginStoreConfig,
        vet_limit: Duration,
    ) -> Result<Arc<PluginStore>, StoreError> {
        config.dirs.iter().try_for_each(|dir| check_dir(dir))?;
        let store = PluginStore {
            cache: Cache::open(&config.state)?,
            config,
            vet_limit,
            scanner: Mutex::default(),
            entries: RwLock::default(),
            loaded: Mutex::default(),
            present: Mutex::default(),
            failed: Mutex::default(),
            observers: Mutex::default(),
            writing: Mutex::default(),
        };
        store.rescan();
        Ok(Arc::new(store))
    }

    pub fn dirs(&self) -> &[PathBuf] {
        &self.config.dirs
    }

    /// Looks at the directories now; waits up to half a second for files that are just being written.
    /// Observers hear of changes on this thread, before it returns, so an observer must not call this.
    pub fn rescan(&self) {
        for _ in 0..3 {
            if !self.scan(&BTreeSet::new()) {
                return;
            }
            std::thread::sleep(SETTLE);
        }
    }

    /// Looks again at the files of this plugin's or file's name, at all where it is empty, as if nothing was
    /// known of them. Files that were tried before, or are named, are tried anew in the child process. Waits
    /// for that. Loaded code stays. Not for an observer, as [`PluginStore::rescan`].
    pub fn recheck(&self, name: &str) {
        self.scanner.lock().forget(name);
        self.rescan();
        for plugin in self.entries().iter().filter_map(PluginEntry::listed) {
            if is_called(name, &plugin.file, Some(plugin.name())) {
                self.try_again(plugin, !name.is_empty());
            }
        }
    }

    /// The fault of the plugin's code when it was tried last, if there was one.
    pub fn failure(&self, plugin: &ListedPlugin) -> Option<PluginError> {
        let fault = self.failed.lock().get(&plugin.hash).cloned()?;
        Some(PluginError::Refused { file: plugin.file.clone(), fault })
    }

    fn try_again(&self, plugin: &ListedPlugin, unasked_too: bool) {
        let slot = self.loaded.lock().entry(plugin.hash).or_default().clone();
        let slot = slot.lock();
        if slot.is_some() {
            return;
        }
        let was_tried = self.failed.lock().remove(&plugin.hash).is_some() | self.cache.forget(&plugin.hash);
        if was_tried || unasked_too {
            self.noting(plugin, self.vetted(plugin).map(drop)).ok();
        }
    }

    /// One look; true when a file is still being written.
    pub(super) fn scan(&self, closed: &BTreeSet<PathBuf>) -> bool {
        let mut scanner = self.scanner.lock();
        let writing = self.writing.lock().clone();
        let scan = scanner.scan(&self.config.dirs, &self.config.trust, closed, &writing);
        let before = self.entries();
        let after = Arc::new(catalog::assemble(&before, scan.findings));
        let changes = catalog::changes(&before, &after);
        self.drop_loaded_content(&after);
        let listed: BTreeSet<Hash> = after.iter().filter_map(PluginEntry::listed).map(|p| p.hash).collect();
        self.failed.lock().retain(|hash, _| listed.contains(hash));
        *self.entries.write() = after;
        self.close_unused(&listed);
        if !changes.is_empty() {
            self.prune(listed);
        }
        let observers = self.observers.lock();
        for change in &changes {
            observers.iter().for_each(|o| (o.tell)(change));
        }
        scan.unsettled
    }

    /// Everything that looks like a plugin, listed or refused, in the order of directories and names.
    pub fn list(&self) -> Vec<PluginEntry> {
        self.entries().to_vec()
    }

    /// Every available class, in the order of [`PluginStore::list`].
    pub fn classes(&self) -> Vec<ClassRef> {
        let of = |plugin: &Arc<ListedPlugin>| {
            let refs = (0..plugin.manifest.classes.len()).map(|index| ClassRef::new(plugin.clone(), index));
            refs.collect::<Vec<_>>()
        };
        self.entries().iter().filter_map(PluginEntry::listed).flat_map(of).collect()
    }

    /// Finds `plugin/class`, or `class` where one plugin alone offers it.
    ///
    /// # Errors
    /// Unknown (with the nearest name and what exists) or ambiguous (with all full names).
    pub fn class(&self, name: &str) -> Result<ClassRef, PluginError> {
        let matches = |c: &ClassRef| match name.split_once('/') {
            Some((plugin, class)) => c.plugin.name() == plugin && c.class().name == class,
            None => c.class().name == name,
        };
        let classes = self.classes();
        let mut found: Vec<&ClassRef> = classes.iter().filter(|c| matches(c)).collect();
        match (found.pop(), found.is_empty()) {
            (Some(class), true) => Ok(class.clone()),
            (Some(class), false) => {
                let mut offered: Vec<_> = found.iter().map(|c| c.full_name()).collect();
                offered.push(class.full_name());
                Err(PluginError::ClassAmbiguous { asked: name.into(), offered })
            }
            (None, _) => Err(self.not_found(name, &classes)),
        }
    }

    fn not_found(&self, asked: &str, classes: &[ClassRef]) -> PluginError {
        let available: Vec<_> = classes.iter().map(ClassRef::full_name).collect();
        let short = asked.rsplit('/').next().unwrap_or(asked);
        let near = |full: &&String| {
            let class = full.rsplit('/').next().unwrap_or(full);
            strsim::jaro_winkler(asked, full).max(strsim::jaro_winkler(short, class))
        };
        let nearest = available
            .iter()
            .filter(|full| near(full) > 0.8)
            .max_by(|a, b| near(a).total_cmp(&near(b)))
            .cloned();
        let plugin = asked.split('/').next().unwrap_or(asked).replace('-', "_");
        let refused = self.entries().iter().find_map(|entry| match entry {
            PluginEntry::Refused { file, reason, .. } if !plugin.is_empty() => {
                let stem = file.file_stem()?.to_string_lossy().replace('-', "_");
                stem.contains(&plugin).then(|| Box::new(reason.clone()))
            }
            _ => None,
        });
        PluginError::ClassNotFound { asked: asked.into(), nearest, available, refused }
    }

    /// Loads a class. Cache, vet, dlopen, `init`: milliseconds the first time, a look-up afterwards.
    /// Blocking; several threads may call.
    ///
    /// # Errors
    /// The fault the vetting child or the dynamic linker tells; the host is unharmed. A fault of the file
    /// itself is told again at once; anything the system lacks is looked for again.
    pub fn load(&self, class: &ClassRef) -> Result<LoadedClass, PluginError> {
        let plugin = &class.plugin;
        let refused = |fault| PluginError::Refused { file: plugin.file.clone(), fault };
        let slot = self.loaded.lock().entry(plugin.hash).or_default().clone();
        let mut slot = slot.lock();
        let loaded = match &*slot {
            Some(loaded) => loaded.clone(),
            None => {
                let loaded = Arc::new(self.load_plugin(plugin).map_err(refused)?);
                *slot = Some(loaded.clone());
                self.present.lock().insert(plugin.hash);
                plugin.drop_content();
                loaded
            }
        };
        loaded.class(class.index()).ok_or_else(|| {
            refused(Fault::EntryDiffers { what: format!("class `{}` is not there", class.class().name) })
        })
    }

    /// The class `plugin/class` of the file with this hash, if its code is in the process, whichever file of
    /// that plugin is listed now. Loads nothing; waits while that very content is being tried or loaded.
    pub fn resident(&self, full_name: &str, hash: &Hash) -> Option<LoadedClass> {
        let slot = self.loaded.lock().get(hash).cloned()?;
        let plugin = slot.lock().clone()?;
        let class = full_name.strip_prefix(&plugin.manifest.name)?.strip_prefix('/')?;
        let index = plugin.manifest.classes.iter().position(|c| c.name == class)?;
        plugin.class(index)
    }

    /// True when the code of this file content is in the process.
    pub fn is_loaded(&self, hash: &Hash) -> bool {
        self.present.lock().contains(hash)
    }

    /// Once at a time for each content: the caller holds its slot.
    fn load_plugin(&self, plugin: &ListedPlugin) -> Result<LoadedPlugin, Fault> {
        if let Some(fault) = self.failed.lock().get(&plugin.hash).filter(|fault| fault.is_of_the_file()) {
            return Err(fault.clone());
        }
        let load = |(path, content): (PathBuf, Arc<Content>)| {
            load::load(&path, plugin, &content.libraries(), self.config.log)
        };
        self.noting(plugin, self.vetted(plugin).and_then(load))
    }

    /// Returns the copy in the cache, with its content, that a child process has come back from.
    fn vetted(&self, plugin: &ListedPlugin) -> Result<(PathBuf, Arc<Content>), Fault> {
        let content = plugin.content().ok_or(Fault::Vanished)?;
        let path = self.cache.put(&plugin.hash, plugin.name(), &content)?;
        if !self.cache.is_vetted(&plugin.hash) {
            vet::vet(&self.config.host_exe, &path, self.vet_limit)?;
            self.cache.set_vetted(&plugin.hash);
        }
        Ok((path, content))
    }

    /// Keeps the outcome of a plugin's code.
    fn noting<T>(&self, plugin: &ListedPlugin, outcome: Result<T, Fault>) -> Result<T, Fault> {
        match &outcome {
            Ok(_) => drop(self.failed.lock().remove(&plugin.hash)),
            Err(fault) => drop(self.failed.lock().insert(plugin.hash, fault.clone())),
        }
        outcome
    }

    /// Takes the libraries out of the process that ask for it and of which nothing is left. The caller has
    /// the scanner, so that no file of theirs is listed meanwhile.
    fn close_unused(&self, listed: &BTreeSet<Hash>) {
        let slots = self.loaded.lock();
        let unlisted = slots.iter().filter(|(hash, _)| !listed.contains(hash));
        let unlisted: Vec<(Hash, Slot)> = unlisted.map(|(hash, slot)| (*hash, slot.clone())).collect();
        drop(slots);
        for (hash, slot) in unlisted {
            let Some(mut slot) = slot.try_lock() else { continue };
            match slot.take().map(closing::last) {
                Some(Ok(plugin)) => {
                    self.present.lock().remove(&hash);
                    // SAFETY: as `closing::last` gave it.
                    unsafe { plugin.close() };
                }
                Some(Err(kept)) => *slot = Some(kept),
                None => {}
            }
        }
    }

    /// A file that came back with content that is loaded already needs no bytes in memory.
    fn drop_loaded_content(&self, entries: &[PluginEntry]) {
        for plugin in entries.iter().filter_map(PluginEntry::listed) {
            let slot = self.loaded.lock().get(&plugin.hash).cloned();
            let loaded = slot.is_some_and(|slot| slot.try_lock().is_some_and(|s| s.is_some()));
            if loaded {
                plugin.drop_content();
            }
        }
    }

    /// Removes old versions from the cache, but for those whose code is loaded or being loaded.
    fn prune(&self, mut keep: BTreeSet<Hash>) {
        let loaded = self.loaded.lock();
        let used = loaded.iter().filter(|(_, slot)| slot.try_lock().is_none_or(|loaded| loaded.is_some()));
        keep.extend(used.map(|(hash, _)| *hash));
        // Held until then: a load enters its slot first.
        self.cache.prune(&keep);
        drop(loaded);
    }

    fn entries(&self) -> Arc<Vec<PluginEntry>> {
        self.entries.read().clone()
    }
}

/// Checks that the directory can be looked into.
///
/// # Errors
/// It is missing, no directory, unreadable.
pub fn check_dir(dir: &Path) -> Result<(), StoreError> {
    let dir = dir.to_path_buf();
    let wrong = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => StoreError::DirMissing { dir: dir.clone() },
        std::io::ErrorKind::NotADirectory => StoreError::DirNotADirectory { dir: dir.clone() },
        _ => StoreError::DirUnreadable { dir: dir.clone(), because: e.to_string() },
    };
    if !std::fs::metadata(&dir).map_err(wrong)?.is_dir() {
        return Err(StoreError::DirNotADirectory { dir });
    }
    std::fs::read_dir(&dir).map(drop).map_err(wrong)
}
