//! dlopen and the first calls into a plugin, the same code in the vetting child and in the host.
//!
//! Invariant: only a cache file is opened. A table is read no further than its `struct_size`; names and counts must equal
//! the manifest's; what is handed on are complete copies of the class tables, so nobody later needs to ask `has_entry`.

use std::ffi::c_int;
use std::mem::{ManuallyDrop, MaybeUninit, offset_of};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
use serde::{Deserialize, Serialize};
use trocar_plugin_api::abi::{Bytes, ClassTable, PluginTable, STATUS_OK};
use trocar_plugin_api::layout::{AbiHeader, LAYOUT_SYMBOL, LibHeader};
use trocar_plugin_api::manifest::{Class, Manifest};
use trocar_plugin_api::{ABI_MAJOR, ENTRY_SYMBOL, EntryFn, has_entry, layout};

use super::error::Stage;
use super::host_table::{self, LogFn};
use super::{Fault, Hash};

/// A library that is in this process, and stays.
pub struct LoadedPlugin {
    pub manifest: Manifest,
    pub hash: Hash,
    /// The cache file it was loaded from.
    pub file: PathBuf,
    classes: Vec<&'static ClassTable>,
    /// Never closed: its threads, thread-locals and exit handlers may outlive every instance.
    _library: ManuallyDrop<Library>,
}

/// A class whose instances can be created.
#[derive(Clone)]
pub struct LoadedClass {
    /// Complete whatever the plugin's age: an entry its own table does not have is null.
    pub table: &'static ClassTable,
    pub class: Class,
    pub plugin: Arc<LoadedPlugin>,
}

// SAFETY: the tables are immutable for the life of the process, and their entries may be called from any thread under the
// rules of the contract, which the LCM keeps.
unsafe impl Send for LoadedPlugin {}
// SAFETY: as above.
unsafe impl Sync for LoadedPlugin {}
// SAFETY: as above.
unsafe impl Send for LoadedClass {}
// SAFETY: as above.
unsafe impl Sync for LoadedClass {}

impl LoadedPlugin {
    pub(crate) fn class(self: &Arc<Self>, index: usize) -> Option<LoadedClass> {
        let table = *self.classes.get(index)?;
        let class = self.manifest.classes.get(index)?.clone();
        Some(LoadedClass { table, class, plugin: self.clone() })
    }
}

/// What the child reports and the host may also meet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum LoadFault {
    UndefinedSymbol { symbol: String },
    MissingLibrary { name: String },
    DlOpen { because: String },
    NoEntry,
    Layout { difference: String },
    EntryDiffers { what: String },
}

impl From<LoadFault> for Fault {
    fn from(fault: LoadFault) -> Fault {
        match fault {
            LoadFault::UndefinedSymbol { symbol } => Fault::UndefinedSymbol { symbol },
            LoadFault::MissingLibrary { name } => Fault::MissingLibrary { name },
            LoadFault::DlOpen { because } => Fault::DlOpen { because },
            LoadFault::NoEntry => Fault::NoEntry,
            LoadFault::Layout { difference } => Fault::Layout { difference },
            LoadFault::EntryDiffers { what } => Fault::EntryDiffers { what },
        }
    }
}

/// A library that was opened and whose entry agrees with its manifest.
struct Opened {
    library: Library,
    table: *const PluginTable,
    classes: Vec<*const ClassTable>,
}

/// Loads a vetted cache file into the host and calls its `init`.
pub(crate) fn load(path: &Path, hash: Hash, manifest: &Manifest, log: LogFn) -> Result<LoadedPlugin, Fault> {
    let opened = open(path, manifest, false, |_| ())?;
    // From here on the code has run; unmapping it is never safe again.
    let library = ManuallyDrop::new(opened.library);
    // SAFETY: `open` checked table and classes, which live as long as the library, and that stays.
    let classes = unsafe { settle_in(opened.table, &opened.classes, &manifest.name, log, 0) }?;
    Ok(LoadedPlugin { manifest: manifest.clone(), hash, file: path.into(), classes, _library: library })
}

/// Calls `init` and completes the class tables.
///
/// # Safety
/// `table` and `classes` came out of [`check_table`] and live as long as the process. Once for each plugin.
pub(super) unsafe fn settle_in(
    table: *const PluginTable,
    classes: &[*const ClassTable],
    name: &str,
    log: LogFn,
    flags: u32,
) -> Result<Vec<&'static ClassTable>, Fault> {
    // SAFETY: `check_table` proved that the table reaches beyond `init`.
    let init = unsafe { (&raw const (*table).init).read() };
    if let Some(init) = init {
        let host = host_table::for_plugin(name, log, flags);
        // SAFETY: `init` is the plugin's own, called once, with a host table that lives as long as the process.
        let status = unsafe { init(host) };
        if status != STATUS_OK {
            return Err(Fault::Init { status });
        }
    }
    // SAFETY: `check_table` proved that each pointer is a class table.
    Ok(classes.iter().map(|table| unsafe { complete(*table) }).collect())
}

/// What the vetting child does: everything but `init`, and the layout as well.
pub(crate) fn try_out(path: &Path, manifest: &Manifest, stage: impl FnMut(Stage)) -> Result<(), LoadFault> {
    let opened = open(path, manifest, true, stage)?;
    let _stays_mapped = ManuallyDrop::new(opened.library);
    Ok(())
}

fn open(
    path: &Path,
    manifest: &Manifest,
    judge_layout: bool,
    mut stage: impl FnMut(Stage),
) -> Result<Opened, LoadFault> {
    stage(Stage::Loading);
    const FLAGS: c_int = RTLD_NOW | RTLD_LOCAL;
    // SAFETY: runs the library's constructors. In the host that happens only after a child process survived it.
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

/// Compares the entry's table with the manifest and returns its class tables.
///
/// # Safety
/// `table` is null or what a plugin's entry returned.
pub(super) unsafe fn check_table(
    table: *const PluginTable,
    manifest: &Manifest,
) -> Result<Vec<*const ClassTable>, String> {
    if table.is_null() || !table.is_aligned() {
        return Err("it returns no table".into());
    }
    // SAFETY: every table begins with its size.
    let size = unsafe { (&raw const (*table).struct_size).read() };
    if !has_entry(size, offset_of!(PluginTable, classes), size_of::<usize>()) {
        return Err(format!("its table has only {size} bytes"));
    }
    // SAFETY: all fields up to `classes` lie inside the table.
    let (major, name, version, count, classes) = unsafe {
        let t = table;
        (
            (&raw const (*t).abi_major).read(),
            text((&raw const (*t).name).read())?,
            text((&raw const (*t).version).read())?,
            (&raw const (*t).class_count).read() as usize,
            (&raw const (*t).classes).read(),
        )
    };
    if major != ABI_MAJOR {
        return Err(format!("the entry speaks ABI {major}"));
    }
    same("plugin name", &manifest.name, name)?;
    same("version", &manifest.version, version)?;
    if count != manifest.classes.len() || classes.is_null() {
        return Err(format!("{} classes in the manifest, {count} in the entry", manifest.classes.len()));
    }
    let mut tables = Vec::with_capacity(count);
    for (i, class) in manifest.classes.iter().enumerate() {
        // SAFETY: the array has `count` pointers.
        let table = unsafe { classes.add(i).read() };
        if table.is_null() || !table.is_aligned() {
            return Err(format!("the table of class `{}` is missing", class.name));
        }
        // SAFETY: every table begins with its size.
        let size = unsafe { (&raw const (*table).struct_size).read() };
        if !has_entry(size, offset_of!(ClassTable, create), size_of::<usize>()) {
            return Err(format!("the table of class `{}` has only {size} bytes", class.name));
        }
        // SAFETY: `name` and `create` lie inside the table.
        let (name, create) =
            unsafe { (text((&raw const (*table).name).read())?, (&raw const (*table).create).read()) };
        same("class", &class.name, name)?;
        if create.is_none() {
            return Err(format!("class `{}` cannot be created: `create` is null", class.name));
        }
        tables.push(table);
    }
    Ok(tables)
}

fn same(what: &str, manifest: &str, entry: &str) -> Result<(), String> {
    match manifest == entry {
        true => Ok(()),
        false => Err(format!("{what} `{manifest}` in the manifest, `{entry}` in the entry")),
    }
}

/// # Safety
/// `bytes` comes from a plugin's table: null, or as many bytes as it says, for the life of the library.
unsafe fn text(bytes: Bytes) -> Result<&'static str, String> {
    const LONGEST: usize = 4096;
    if bytes.len == 0 {
        return Ok("");
    }
    if bytes.ptr.is_null() || bytes.len > LONGEST {
        return Err("a name in its table is unreadable".into());
    }
    // SAFETY: the caller's promise.
    let bytes = unsafe { std::slice::from_raw_parts(bytes.ptr, bytes.len) };
    std::str::from_utf8(bytes).map_err(|_| "a name in its table is not UTF-8".into())
}

/// A copy of full size for the life of the process; entries beyond the plugin's own table are null.
///
/// # Safety
/// `table` points to a class table whose `struct_size` is true.
unsafe fn complete(table: *const ClassTable) -> &'static ClassTable {
    let mut copy = MaybeUninit::<ClassTable>::zeroed();
    // SAFETY: every table begins with its size.
    let size = unsafe { (&raw const (*table).struct_size).read() } as usize;
    // A half entry is no entry.
    let size = size.min(size_of::<ClassTable>()) & !(size_of::<usize>() - 1);
    // SAFETY: both sides have at least `size` bytes and do not overlap.
    unsafe { std::ptr::copy_nonoverlapping(table.cast::<u8>(), copy.as_mut_ptr().cast::<u8>(), size) };
    // SAFETY: zero is a valid value of every field: integers, raw pointers, optional functions.
    let mut copy = unsafe { copy.assume_init() };
    copy.struct_size = size_of::<ClassTable>() as u32;
    Box::leak(Box::new(copy))
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
