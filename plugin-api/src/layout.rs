//! Judges whether a plugin was compiled against the same layout of the contract, with abi_stable's
//! descriptions.
//!
//! Invariant: `layouts/1.N.txt` is the layout of ABI 1.N for ever. A plugin is compared with the text of its
//! own minor, a newer one with ours as its beginning, so that old and new load each other and only real
//! breaks are refused.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use abi_stable::StableAbi;
use abi_stable::abi_stability::check_layout_compatibility;
use abi_stable::library::RootModule;
pub use abi_stable::library::{AbiHeader, LibHeader};
use abi_stable::prefix_type::PrefixTypeTrait;
use abi_stable::sabi_types::VersionStrings;
use abi_stable::type_layout::{TLField, TLFunction, TypeLayout};

use crate::abi::{ABI_MINOR, PluginTable};

/// The optional second symbol of a plugin, `extern "C" fn() -> &'static LibHeader`.
pub const LAYOUT_SYMBOL: &str = "trocar_layout_v1";

/// Layouts that were released, by ABI minor.
const FROZEN: [&str; 3] = [
    include_str!("../layouts/1.0.txt"),
    include_str!("../layouts/1.1.txt"),
    include_str!("../layouts/1.2.txt"),
];

/// abi_stable's root module: every struct of the contract is reached from the entry's type.
#[repr(C)]
#[derive(StableAbi)]
#[sabi(kind(Prefix(prefix_ref = ContractRef, prefix_fields = ContractPrefix)))]
pub struct Contract {
    /// The function a file exports.
    #[sabi(last_prefix_field)]
    pub entry: extern "C" fn() -> *const PluginTable,
}

impl RootModule for ContractRef {
    abi_stable::declare_root_module_statics! {ContractRef}
    const BASE_NAME: &'static str = "trocar_plugin";
    const NAME: &'static str = "trocar_plugin";
    const VERSION_STRINGS: VersionStrings = abi_stable::package_version_strings!();
}

/// Header that a plugin's [`LAYOUT_SYMBOL`] returns.
pub fn header() -> &'static LibHeader {
    extern "C" fn no_table() -> *const PluginTable {
        std::ptr::null()
    }
    static HEADER: OnceLock<LibHeader> = OnceLock::new();
    HEADER.get_or_init(|| LibHeader::from_module(Contract { entry: no_table }.leak_into_prefix()))
}

/// Exports [`LAYOUT_SYMBOL`] from a plugin.
#[macro_export]
macro_rules! export_layout {
    () => {
        #[cfg_attr(not(test), unsafe(no_mangle))]
        #[cfg_attr(test, allow(dead_code))]
        pub extern "C" fn trocar_layout_v1() -> &'static $crate::layout::LibHeader {
            $crate::layout::header()
        }
    };
}

/// Compares the layout a plugin of ABI 1.`minor` carries with the one it must have.
///
/// # Errors
/// The first difference, as `Struct.field`.
pub fn judge(plugin: &'static LibHeader, minor: u32) -> Result<(), String> {
    let Some(theirs) = plugin.layout() else { return Err("it carries no layout".into()) };
    compare(minor, &describe(theirs))?;
    let ours = <ContractRef as StableAbi>::LAYOUT;
    let same_crate = ours.package_version() == theirs.package_version();
    if minor == ABI_MINOR && same_crate {
        check_layout_compatibility(ours, theirs).into_result().map_err(|e| first_line(&e.to_string()))?;
    }
    Ok(())
}

/// Compares a description with the frozen one of `minor`, or with our newest as a beginning.
fn compare(minor: u32, theirs: &str) -> Result<(), String> {
    let frozen = FROZEN.get(minor as usize);
    let expected = parse(frozen.or(FROZEN.last()).unwrap_or(&""));
    let theirs = parse(theirs);
    for (name, want) in &expected {
        let Some(have) = theirs.get(name) else { return Err(format!("it has no `{name}`")) };
        for (i, field) in want.fields.iter().enumerate() {
            let label = field.split(':').next().unwrap_or_default();
            match have.fields.get(i) {
                Some(other) if other == field => {}
                Some(other) => {
                    return Err(format!(
                        "`{name}.{label}`: the contract has `{field}`, the plugin `{other}`"
                    ));
                }
                None => return Err(format!("`{name}.{label}` is missing in the plugin")),
            }
        }
        if frozen.is_some()
            && let Some(extra) = have.fields.get(want.fields.len())
        {
            return Err(format!("`{name}` has `{extra}`, which ABI 1.{minor} does not have"));
        }
        if frozen.is_some() && have.extent != want.extent {
            return Err(format!("`{name}`: the contract has {}, the plugin {}", want.extent, have.extent));
        }
    }
    Ok(())
}

struct Described<'a> {
    /// "size 16 align 8", bytes.
    extent: &'a str,
    fields: Vec<&'a str>,
}

fn parse(text: &str) -> BTreeMap<&str, Described<'_>> {
    let mut structs = BTreeMap::new();
    let mut current = "";
    for line in text.lines() {
        if let Some(field) = line.strip_prefix("  ") {
            structs.entry(current).and_modify(|s: &mut Described<'_>| s.fields.push(field));
        } else if let Some((name, extent)) = line.split_once(' ') {
            current = name;
            structs.insert(name, Described { extent, fields: Vec::new() });
        }
    }
    structs
}

/// Describes all contract structs reachable from `root` as text: `Name size S align A`, then a line per
/// field, sorted by name.
fn describe(root: &'static TypeLayout) -> String {
    let (mut open, mut seen, mut structs) = (vec![root], BTreeSet::new(), BTreeMap::new());
    while let Some(layout) = open.pop() {
        if !seen.insert(layout.full_type().to_string()) {
            continue;
        }
        open.extend(layout.generics().type_params().iter().map(|ty| ty()));
        let Some(fields) = layout.get_fields() else { continue };
        let mut text = format!("{} size {} align {}\n", layout.name(), layout.size(), layout.alignment());
        for field in fields.iter() {
            open.push(field.layout());
            for f in field.function_range().iter() {
                open.extend(f.param_type_layouts.iter().map(|ty| ty()));
                open.extend(f.return_type_layout().map(|ty| ty()));
            }
            text.push_str(&format!("  {}: {}\n", field.name(), field_type(&field)));
        }
        if layout.mod_path().to_string().ends_with("::abi") && layout.package() == env!("CARGO_PKG_NAME") {
            structs.insert(layout.name(), text);
        }
    }
    structs.into_values().collect()
}

fn field_type(field: &TLField) -> String {
    let functions: Vec<_> = field.function_range().iter().map(|f| function_type(&f)).collect();
    match functions.is_empty() {
        true => type_name(field.layout()),
        false if field.is_function() => functions.join(", "),
        false => format!("{}<{}>", field.layout().name(), functions.join(", ")),
    }
}

/// abi_stable prints a space behind each pointee.
fn type_name(layout: &TypeLayout) -> String {
    layout.full_type().to_string().trim_end().to_string()
}

fn function_type(f: &TLFunction) -> String {
    let params: Vec<_> = f.param_type_layouts.iter().map(|ty| type_name(ty())).collect();
    let safety = if f.fn_qualifs.is_unsafe() { "unsafe " } else { "" };
    let ret = f.return_type_layout().map(|ty| format!(" -> {}", type_name(ty()))).unwrap_or_default();
    format!("{safety}fn({}){ret}", params.join(", "))
}

/// abi_stable's report is long; its first statement of a difference is enough.
fn first_line(report: &str) -> String {
    let line = report.lines().find(|l| l.contains("Expected") || l.contains("error"));
    line.unwrap_or("abi_stable sees a difference").trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ours() -> String {
        describe(<ContractRef as StableAbi>::LAYOUT)
    }

    #[test]
    fn the_contract_has_the_layout_frozen_for_its_minor() {
        assert_eq!(FROZEN.len(), ABI_MINOR as usize + 1, "a new minor needs its layouts/1.{ABI_MINOR}.txt");
        let frozen = FROZEN[ABI_MINOR as usize];
        assert!(
            ours() == frozen,
            "the contract of ABI 1.{ABI_MINOR} changed. Entries are only appended, and raise ABI_MINOR; the text of \
             the new minor is:\n{}",
            ours()
        );
    }

    #[test]
    fn every_frozen_layout_is_the_beginning_of_the_next() {
        for (minor, pair) in FROZEN.windows(2).enumerate() {
            assert_eq!(compare_as_beginning(pair[0], pair[1]), Ok(()), "1.{minor} and its successor");
        }
    }

    fn compare_as_beginning(old: &str, new: &str) -> Result<(), String> {
        let new = parse(new);
        for (name, old) in parse(old) {
            let have = new.get(name).ok_or_else(|| format!("{name} is gone"))?;
            if !have.fields.starts_with(&old.fields) {
                return Err(format!("{name} was changed, not appended to"));
            }
        }
        Ok(())
    }

    #[test]
    fn a_plugin_of_the_same_contract_is_accepted() {
        assert_eq!(judge(header(), ABI_MINOR), Ok(()));
    }

    #[test]
    fn a_changed_field_is_named() {
        let theirs = ours().replace("cycle: u64", "cycle: u32");
        let said = compare(ABI_MINOR, &theirs).expect_err("a changed type is accepted");
        assert!(said.contains("`Tick.cycle`"), "{said}");
    }

    #[test]
    fn a_missing_or_additional_field_of_the_same_minor_is_named() {
        let missing = ours().replace("  elapsed_ns: u64\n", "");
        let said = compare(ABI_MINOR, &missing).expect_err("a missing field is accepted");
        assert!(said.contains("`Tick.elapsed_ns`"), "{said}");
        let additional = ours().replace("  elapsed_ns: u64\n", "  elapsed_ns: u64\n  phase: u64\n");
        let said = compare(ABI_MINOR, &additional).expect_err("an additional field is accepted");
        assert!(said.contains("phase"), "{said}");
    }

    #[test]
    fn a_newer_minor_may_append_and_may_not_change() {
        let newer = ABI_MINOR + 1;
        let appended = ours()
            .replace("Tick size 48", "Tick size 56")
            .replace("  elapsed_ns: u64\n", "  elapsed_ns: u64\n  phase: u64\n");
        assert_eq!(compare(newer, &appended), Ok(()));
        assert!(compare(newer, &appended.replace("now_ns: u64", "now_ns: i64")).is_err());
    }
}
