//! Pure decisions: which of the found files are listed, and what changed.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use trocar_plugin_api::manifest::Manifest;

use super::*;
use crate::file::FileBytes;
use crate::inspect::Facts;

fn plugin(file: &str, name: &str, content: &[u8]) -> Finding {
    let text = format!(r#"{{"trocar":1,"abi":[1,0],"name":"{name}","version":"1.0.0","classes":[]}}"#);
    let manifest = Manifest::parse(text.as_bytes()).unwrap();
    let facts = Facts { manifest, needed: Vec::new(), brought: Vec::new(), warnings: Vec::new() };
    let hash = crate::Hash::of(content);
    let read = FileBytes { bytes: content.to_vec(), hash, owner: 0, mode: 0o644, warnings: Vec::new() };
    let listed = ListedPlugin::new(Path::new(file), read, facts);
    Finding { file: file.into(), outcome: Ok(Arc::new(listed)) }
}

fn bad(file: &str, fault: Fault) -> Finding {
    Finding { file: file.into(), outcome: Err(fault) }
}

fn listed(entries: &[PluginEntry]) -> Vec<&PathBuf> {
    entries.iter().filter_map(PluginEntry::listed).map(|p| &p.file).collect()
}

#[test]
fn of_two_files_with_one_name_the_first_is_listed_and_the_other_names_it() {
    let entries = assemble(&[], vec![plugin("a.so", "sine", b"1"), plugin("b.so", "sine", b"2")]);
    assert_eq!(listed(&entries), [Path::new("a.so")]);
    let PluginEntry::Refused { reason, plugin, .. } = &entries[1] else { panic!("{entries:?}") };
    assert!(reason.to_string().contains("a.so") && reason.to_string().contains("b.so"), "{reason}");
    assert_eq!(plugin.as_deref(), Some("sine"));
}

#[test]
fn a_newcomer_does_not_displace_the_file_listed_before() {
    let before = assemble(&[], vec![plugin("b.so", "sine", b"1")]);
    let after = assemble(&before, vec![plugin("a.so", "sine", b"2"), plugin("b.so", "sine", b"1")]);
    assert_eq!(listed(&after), [Path::new("b.so")]);
    let told = changes(&before, &after);
    assert!(
        matches!(&told[..], [CatalogChange::Refused { file, .. }] if file == Path::new("a.so")),
        "{told:?}"
    );
}

#[test]
fn a_renamed_file_is_no_change() {
    let before = assemble(&[], vec![plugin("a.so", "sine", b"1")]);
    let after = assemble(&before, vec![plugin("b.so", "sine", b"1")]);
    assert_eq!(listed(&after), [Path::new("b.so")]);
    assert!(changes(&before, &after).is_empty());
}

#[test]
fn an_update_that_is_bad_removes_the_plugin_and_says_why() {
    let before = assemble(&[], vec![plugin("a.so", "sine", b"1")]);
    let after = assemble(&before, vec![bad("a.so", Fault::Empty)]);
    let told = changes(&before, &after);
    assert!(matches!(&told[..], [CatalogChange::Removed(_), CatalogChange::Refused { .. }]), "{told:?}");
}

#[test]
fn a_refusal_is_told_once() {
    let before = assemble(&[], vec![bad("a.so", Fault::Empty)]);
    let after = assemble(&before, vec![bad("a.so", Fault::Empty)]);
    assert!(changes(&before, &after).is_empty());
    let other = assemble(&before, vec![bad("a.so", Fault::NoNote)]);
    assert_eq!(changes(&before, &other).len(), 1);
}
