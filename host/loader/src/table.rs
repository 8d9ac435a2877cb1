//! The tables a plugin's entry returns: checked against its manifest before anything is called through them.
//!
//! Invariant: a table is read no further than its `struct_size`; names, counts and versions must equal the
//! manifest's, and every entry the description makes necessary is there. Later code gets complete copies of
//! the class tables, so it never needs to ask `has_entry`.

use std::mem::{MaybeUninit, offset_of};

use serde_json::{Map, Value};
use trocar_plugin_api::abi::{Bytes, ClassTable, PluginTable};
use trocar_plugin_api::manifest::{Class, Manifest};
use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR, has_entry};

/// No table of any version has more bytes.
const LARGEST: usize = 4096;

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
        let needs = offset_of!(PluginTable, classes) + size_of::<usize>();
        return Err(format!("its table says it has {size} bytes, and needs {needs}"));
    }
    // SAFETY: both fields lie inside the table.
    let abi = unsafe { [(&raw const (*table).abi_major).read(), (&raw const (*table).abi_minor).read()] };
    // The manifest's major is the host's, or nothing of the plugin would have run. Minors may differ: a
    // manifest is written by hand, and the header it is compiled with may be newer.
    if abi[0] != ABI_MAJOR {
        let [[a, b], [c, d]] = [manifest.abi, abi];
        return Err(format!("ABI {a}.{b} in the manifest, {c}.{d} in the entry"));
    }
    // SAFETY: all fields up to `classes` lie inside the table.
    let (name, version, count, classes) = unsafe {
        let t = table;
        (
            text((&raw const (*t).name).read())?,
            text((&raw const (*t).version).read())?,
            (&raw const (*t).class_count).read() as usize,
            (&raw const (*t).classes).read(),
        )
    };
    size_fits("its table", size, size_of::<PluginTable>(), abi)?;
    same("plugin name", &manifest.name, name)?;
    same("version", &manifest.version, version)?;
    if count != manifest.classes.len() || classes.is_null() {
        return Err(format!("{} classes in the manifest, {count} in the entry", manifest.classes.len()));
    }
    let mut tables = Vec::with_capacity(count);
    for (i, class) in manifest.classes.iter().enumerate() {
        // SAFETY: the array has `count` pointers.
        let table = unsafe { classes.add(i).read() };
        // SAFETY: it is what the entry returned for this class.
        unsafe { check_class(table, class, abi)? };
        tables.push(table);
    }
    Ok(tables)
}

/// Compares the table of one class with the manifest; `abi` is the entry's, major and minor.
///
/// # Safety
/// `table` is null or what a plugin's entry returned for a class.
unsafe fn check_class(table: *const ClassTable, class: &Class, abi: [u32; 2]) -> Result<(), String> {
    if table.is_null() || !table.is_aligned() {
        return Err(format!("the table of class `{}` is missing", class.name));
    }
    // SAFETY: every table begins with its size.
    let size = unsafe { (&raw const (*table).struct_size).read() };
    if !has_entry(size, offset_of!(ClassTable, create), size_of::<usize>()) {
        let needs = offset_of!(ClassTable, create) + size_of::<usize>();
        return Err(format!(
            "the table of class `{}` says it has {size} bytes, and needs {needs}",
            class.name
        ));
    }
    // SAFETY: `name` lies inside the table.
    let name = unsafe { text((&raw const (*table).name).read())? };
    same("class", &class.name, name)?;
    size_fits(&format!("the table of class `{}`", class.name), size, size_of::<ClassTable>(), abi)?;
    // SAFETY: its first `size` bytes were written by the plugin, and the size makes sense for its
    // version.
    let whole = unsafe { copy(table) };
    if let Some((entry, because)) = missing(&whole, class) {
        return Err(format!("class `{}` has {because}, but its entry `{entry}` is null", class.name));
    }
    Ok(())
}

/// Checks that a table of this host's version, or of an earlier one, is not larger than this host knows it.
fn size_fits(what: &str, size: u32, known: usize, [major, minor]: [u32; 2]) -> Result<(), String> {
    let largest = if minor <= ABI_MINOR { known } else { LARGEST };
    if size as usize <= largest {
        return Ok(());
    }
    Err(format!("{what} says it has {size} bytes, and one of ABI {major}.{minor} has at most {largest}"))
}

/// Returns the first entry that is null although the description makes it necessary, and what makes it so.
fn missing(table: &ClassTable, class: &Class) -> Option<(&'static str, &'static str)> {
    let commands = || class.provided.iter().flat_map(|p| &p.commands);
    let is_read = |kind: &str| matches!(kind, "read" | "qualified_read");
    let slots = !class.inputs.is_empty()
        || !class.outputs.is_empty()
        || class.required.iter().any(|r| !r.functions.is_empty())
        || class.provided.iter().any(|p| !p.events.is_empty());
    let fields = class.config.get("properties").and_then(Value::as_object);
    let steps = matches!(class.execution.model.as_str(), "periodic" | "continuous" | "stream");
    let needs = [
        ("create", table.create.is_none(), true, "instances"),
        ("destroy", table.destroy.is_none(), true, "instances"),
        ("configure", table.configure.is_none(), !fields.is_none_or(Map::is_empty), "configuration fields"),
        ("step", table.step.is_none(), steps, "an execution model that steps"),
        ("bind", table.bind.is_none(), slots, "inputs, outputs, functions or events"),
        ("command", table.command.is_none(), commands().any(|c| !is_read(&c.kind)), "commands"),
        ("read", table.read.is_none(), commands().any(|c| is_read(&c.kind)), "reads"),
        (
            "on_event",
            table.on_event.is_none(),
            class.required.iter().any(|r| !r.handlers.is_empty()),
            "event handlers",
        ),
        ("state_copy", table.state_copy.is_none(), class.state.is_some(), "a state"),
        ("make_safe", table.make_safe.is_none(), class.safety == "actuator", "the safety `actuator`"),
    ];
    needs.iter().find(|(_, null, needed, _)| *null && *needed).map(|(entry, .., because)| (*entry, *because))
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
/// `table` came out of [`check_table`].
pub(super) unsafe fn complete(table: *const ClassTable) -> &'static ClassTable {
    // SAFETY: the caller's promise.
    let mut copy = unsafe { copy(table) };
    copy.struct_size = size_of::<ClassTable>() as u32;
    Box::leak(Box::new(copy))
}

/// # Safety
/// `table` points to a class table whose `struct_size` is true.
unsafe fn copy(table: *const ClassTable) -> ClassTable {
    let mut copy = MaybeUninit::<ClassTable>::zeroed();
    // SAFETY: every table begins with its size.
    let size = unsafe { (&raw const (*table).struct_size).read() } as usize;
    // A half entry is no entry.
    let size = size.min(size_of::<ClassTable>()) & !(size_of::<usize>() - 1);
    // SAFETY: both sides have at least `size` bytes and do not overlap.
    unsafe { std::ptr::copy_nonoverlapping(table.cast::<u8>(), copy.as_mut_ptr().cast::<u8>(), size) };
    // SAFETY: zero is a valid value of every field: integers, raw pointers, optional functions.
    unsafe { copy.assume_init() }
}
