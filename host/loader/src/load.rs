//! dlopen and the first calls into a plugin, the same code in the vetting child and in the host.
//!
//! Invariant: only a cache file is opened, and nothing is called through a table that `table.rs` has not
//! checked.

use std::ffi::c_int;
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
use parking_lot::{Mutex, MutexGuard};
use trocar_plugin_api::abi::{ClassTable, LOG_ERROR, PluginTable, STATUS_OK};
use trocar_plugin_api::layout::{AbiHeader, LAYOUT_SYMBOL, LibHeader};
use trocar_plugin_api::manifest::{Class, Manifest};
use trocar_plugin_api::{ENTRY_SYMBOL, EntryFn, layout};
use trocar_rt::os::{self, Environment};

use super::error::Stage;
use super::host_table::{self, LogFn};
use super::load_fault::LoadFault;
use super::other_threads::Others;
use super::resident::{self, Libraries};
use super::table::{check_table, complete};
use super::{Fault, Hash, ListedPlugin};

/// A library that is in this process. It stays, unless its manifest says `unload` and nothing of it is left.
pub struct LoadedPlugin {
    pub manifest: Manifest,
    pub hash: Hash,
    /// The cache file it was loaded from.
    pub file: PathBuf,
    classes: Vec<&'static ClassTable>,
    /// Not closed by being dropped: its threads, thread-locals and exit handlers may outlive every instance.
    library: ManuallyDrop<Library>,
    /// Threads that were there before it was loaded; of a library that may go.
    pub(super) others: Option<Others>,
}

/// A class whose instances can be created.
#[derive(Clone)]
pub struct LoadedClass {
    /// Complete whatever the plugin's age: an entry its own table does not have is null.
    pub table: &'static ClassTable,
    pub class: Class,
    pub plugin: Arc<LoadedPlugin>,
}

// SAFETY: the tables are immutable for the life of the process, and their entries may be called from any
// thread under the rules of the contract, which the LCM keeps.
unsafe impl Send for LoadedPlugin {}
// SAFETY: as above.
unsafe impl Sync for LoadedPlugin {}
// SAFETY: as above.
unsafe impl Send for LoadedClass {}
// SAFETY: as above.
unsafe impl Sync for LoadedClass {}

impl LoadedPlugin {
    /// Takes the library out of the process. Its exit handlers run here.
    ///
    /// # Safety
    /// `self` is what [`closing::last`](super::closing::last) gave: nobody has a class of it, and no thread
    /// runs that it may have started.
    pub(super) unsafe fn close(self) {
        let _loading = Loading::begin();
        let name = self.manifest.name;
        // The class tables are copies that stay. A caller through one holds this plugin beside it: a
        // `LoadedClass` in each instance, and in the rows of one of another process; so no caller is inside
        // or can come. Thread-locals with destructors are counted by glibc, which then keeps the library.
        match ManuallyDrop::into_inner(self.library).close() {
            Ok(()) => log::info!("plugin {name}: its library {} was closed", self.hash.short()),
            Err(error) => log::warn!("plugin {name}: its library cannot be closed: {error}"),
        }
    }

    pub fn class(self: &Arc<Self>, index: usize) -> Option<LoadedClass> {
        let table = *self.classes.get(index)?;
        let class = self.manifest.classes.get(index)?.clone();
        Some(LoadedClass { table, class, plugin: self.clone() })
    }
}

/// A library that was opened and whose entry agrees with its manifest.
struct Opened {
    library: Library,
    table: *const PluginTable,
    classes: Vec<*const ClassTable>,
}

/// Loads that began and that ended in this process.
static LOADS: (AtomicU64, AtomicU64) = (AtomicU64::new(0), AtomicU64::new(0));
/// When the last one began, ns.
static BEGAN_NS: AtomicU64 = AtomicU64::new(0);
/// Lets one load run at a time: each has to find the process as it was before, and to leave it so. The
/// dynamic linker has such a lock anyway.
static ONE: Mutex<()> = Mutex::new(());
/// A load that takes longer hangs, ns: it will put nothing back.
const HANGS_NS: u64 = 10_000_000_000;

/// A load under way. It may change the state of the process meanwhile, and puts that back itself.
pub struct Loading(#[expect(dead_code, reason = "held")] MutexGuard<'static, ()>);

impl Loading {
    pub fn begin() -> Loading {
        let one = ONE.lock();
        BEGAN_NS.store(os::now_ns(), Ordering::SeqCst);
        LOADS.0.fetch_add(1, Ordering::SeqCst);
        Loading(one)
    }
}

impl Drop for Loading {
    fn drop(&mut self) {
        LOADS.1.fetch_add(1, Ordering::SeqCst);
    }
}

/// A moment, as [`has_loaded_since`] asks for it.
#[derive(Clone, Copy)]
pub struct Moment(u64);

/// Now, counted in loads that have ended.
pub fn moment() -> Moment {
    Moment(LOADS.1.load(Ordering::SeqCst))
}

/// Tells whether a plugin's code was being loaded at that moment, or at any time since, and does not hang.
/// Call it after the look that it is to explain.
pub fn has_loaded_since(moment: Moment) -> bool {
    let began = LOADS.0.load(Ordering::SeqCst);
    let is_inside = began != LOADS.1.load(Ordering::SeqCst);
    let hangs = is_inside && os::now_ns().saturating_sub(BEGAN_NS.load(Ordering::SeqCst)) > HANGS_NS;
    began != moment.0 && !hangs
}

/// Loads a vetted cache file into the host and calls its `init`.
pub(crate) fn load(
    path: &Path,
    plugin: &ListedPlugin,
    libraries: &Libraries,
    log: LogFn,
) -> Result<LoadedPlugin, Fault> {
    let _loading = Loading::begin();
    let place = std::env::current_dir().ok();
    let environment = Environment::look();
    let loaded = load_here(path, plugin, libraries, log);
    tell_environment(&plugin.manifest.name, environment);
    if let Some(place) = place
        && std::env::current_dir().ok().as_ref() != Some(&place)
    {
        let put_back = match std::env::set_current_dir(&place) {
            Ok(()) => "which was put back".to_owned(),
            Err(e) => format!("which could not be put back to {}: {e}", place.display()),
        };
        let plugin = plugin.name();
        log::warn!(
            "plugin {plugin}: it changed the working directory of the process while it was loaded, {put_back}"
        );
    }
    loaded
}

/// Tells of a variable that a library sets while it is loaded: it is set for the whole process.
fn tell_environment(plugin: &str, before: Option<Environment>) {
    if let (Some(before), Some(now)) = (before, Environment::look())
        && let Some(said) = now.said_since(&before)
    {
        log::warn!("plugin {plugin}: it changed {said} (while it was loaded)");
    }
}

fn load_here(
    path: &Path,
    plugin: &ListedPlugin,
    libraries: &Libraries,
    log: LogFn,
) -> Result<LoadedPlugin, Fault> {
    let ListedPlugin { manifest, hash, .. } = plugin;
    resident::check(libraries, path.parent().and_then(Path::parent))?;
    let others = manifest.unload.then(Others::now);
    let opened = open(path, manifest, false, |_| ())?;
    // From here on the code has run; it is unmapped by `close` alone.
    let library = ManuallyDrop::new(opened.library);
    // SAFETY: `open` checked table and classes, which live as long as the library: until `close`.
    let classes = unsafe { settle_in(opened.table, &opened.classes, &manifest.name, log, 0) }?;
    Ok(LoadedPlugin { manifest: manifest.clone(), hash: *hash, file: path.into(), classes, library, others })
}

/// Calls `init` and completes the class tables.
///
/// # Safety
/// As for [`call_init`], and `classes` came out of the same [`check_table`].
pub(super) unsafe fn settle_in(
    table: *const PluginTable,
    classes: &[*const ClassTable],
    name: &str,
    log: LogFn,
    flags: u32,
) -> Result<Vec<&'static ClassTable>, Fault> {
    // SAFETY: the caller's promise.
    unsafe { call_init(table, name, log, flags) }?;
    // SAFETY: `check_table` proved that each pointer is a class table.
    Ok(classes.iter().map(|table| unsafe { complete(*table) }).collect())
}

/// # Safety
/// `table` came out of [`check_table`], and its library is open. Once for each plugin.
unsafe fn call_init(table: *const PluginTable, name: &str, log: LogFn, flags: u32) -> Result<(), LoadFault> {
    // SAFETY: `check_table` proved that the table reaches beyond `init`.
    let Some(init) = (unsafe { (&raw const (*table).init).read() }) else { return Ok(()) };
    let host = host_table::for_plugin(name, log, flags);
    // SAFETY: `init` is the plugin's own, called once, with a host table that lives as long as the process.
    match unsafe { init(host) } {
        STATUS_OK => Ok(()),
        status => Err(LoadFault::Init { status, said: String::new() }),
    }
}

/// The error a plugin logged last while the vetting child tries it.
static SAID: Mutex<String> = Mutex::new(String::new());

fn note(_plugin: &str, level: u32, _target: &str, message: &str) {
    if level == LOG_ERROR {
        message.clone_into(&mut SAID.lock());
    }
}

/// Runs in the vetting child: everything the host does to load the plugin, and the layout as well. No
/// instance is made.
pub(crate) fn try_out(
    path: &Path,
    manifest: &Manifest,
    libraries: &Libraries,
    mut stage: impl FnMut(Stage),
) -> Result<(), LoadFault> {
    resident::check(libraries, None)?;
    let opened = open(path, manifest, true, &mut stage)?;
    let _stays_mapped = ManuallyDrop::new(opened.library);
    stage(Stage::Init);
    // SAFETY: `open` checked the table; the library stays until the process ends.
    let done = unsafe { call_init(opened.table, &manifest.name, note, 0) };
    done.map_err(|fault| match fault {
        LoadFault::Init { status, .. } => {
            let said = SAID.lock().clone();
            LoadFault::Init { status, said }
        }
        other => other,
    })
}

fn open(
    path: &Path,
    manifest: &Manifest,
    judge_layout: bool,
    mut stage: impl FnMut(Stage),
) -> Result<Opened, LoadFault> {
    stage(Stage::Loading);
    const FLAGS: c_int = RTLD_NOW | RTLD_LOCAL;
    // SAFETY: runs the library's constructors. In the host that happens only after a child process survived
    // it.
    let library = unsafe { Library::open(Some(path), FLAGS) }.map_err(|e| classify(&chain(&e), path))?;
    if judge_layout {
        stage(Stage::Layout);
        check_layout(&library, manifest)?;
    }
    stage(Stage::Entry);
    // SAFETY: the contract fixes the type behind this name.
    let entry = unsafe { library.get::<EntryFn>(ENTRY_SYMBOL) }.map_err(|_| LoadFault::NoEntry)?;
    // SAFETY: the entry takes nothing and returns a table that lives as long as the library.
    let table = unsafe { entry() };
    // SAFETY: what the entry returned is a table or null, and is checked before it is read.
    let classes = unsafe { check_table(table, manifest) }.map_err(|what| LoadFault::EntryDiffers { what })?;
    Ok(Opened { library, table, classes })
}

fn check_layout(library: &Library, manifest: &Manifest) -> Result<(), LoadFault> {
    type LayoutFn = unsafe extern "C" fn() -> *const AbiHeader;
    // SAFETY: the contract fixes the type behind this name; an abi_stable header begins with its `AbiHeader`.
    let Ok(symbol) = (unsafe { library.get::<LayoutFn>(LAYOUT_SYMBOL) }) else { return Ok(()) };
    // SAFETY: takes nothing, returns a static.
    let header = unsafe { symbol() };
    let differs = |difference: &str| LoadFault::Layout { difference: difference.into() };
    // SAFETY: a plugin's header lives as long as the library; a null pointer is no reference.
    match unsafe { header.as_ref() } {
        None => return Err(differs("its layout description is missing")),
        Some(header) if !header.is_valid() => return Err(differs("it was described by another abi_stable")),
        Some(_) => {}
    }
    // SAFETY: a valid abi_stable header of this version is the beginning of a `LibHeader`.
    let described: &'static LibHeader = unsafe { &*header.cast::<LibHeader>() };
    layout::judge(described, manifest.abi[1]).map_err(|difference| LoadFault::Layout { difference })
}

/// libloading's own text says only "dlopen failed".
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(source) = next {
        text = format!("{text}: {source}");
        next = source.source();
    }
    text
}

fn classify(chain: &str, path: &Path) -> LoadFault {
    let word = |after: &str| {
        let (_, rest) = chain.split_once(after)?;
        Some(rest.split_whitespace().next().unwrap_or_default().trim_matches(',').to_string())
    };
    if let Some(symbol) = word("undefined symbol: ") {
        return LoadFault::UndefinedSymbol { symbol };
    }
    if let Some((before, _)) = chain.split_once(": cannot open shared object file")
        && let Some(name) = before.rsplit(": ").next()
        && !name.contains('/')
    {
        return LoadFault::MissingLibrary { name: name.to_string() };
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    LoadFault::DlOpen { because: chain.replace(&*path.to_string_lossy(), &name) }
}
