//! Faults of the tables an entry returns are found before anything is called through them, and named.

use super::*;

const SOURCE: &str = r#"
#include "trocar_plugin.h"
#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>
TROCAR_MANIFEST("{\"trocar\":1,\"abi\":[1,2],\"name\":\"probe\",\"version\":\"1\",\"classes\":[{\"name\":\"c\"@MORE@}]}\n");
static int made;
static void *create(const trocar_host *host, trocar_bytes name, trocar_err *err) {
    (void)host; (void)name; (void)err;
    return &made;
}
static void destroy(void *self) { (void)self; }
static trocar_class class_table = {
    .struct_size = sizeof class_table, .name = {(const uint8_t *)"c", 1}, .create = create, .destroy = destroy};
static const trocar_class *const classes[] = {&class_table};
static int32_t init(const trocar_host *host) { (void)host; @INIT@; return 0; }
static trocar_plugin table = {
    .struct_size = sizeof table, .abi_major = 1, .abi_minor = TROCAR_ABI_MINOR, .name = {(const uint8_t *)"probe", 5},
    .version = {(const uint8_t *)"1", 1}, .init = init, .class_count = 1, .classes = classes};
TROCAR_EXPORT const trocar_plugin *trocar_plugin_v1(void) { @ENTRY@; return &table; }
"#;

/// Builds a plugin whose class has `more` (JSON) in its manifest, with this code in its entry and its init.
fn built(more: &str, entry: &str, init: &str) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let source = SOURCE
        .replace("@MORE@", &more.replace('"', "\\\""))
        .replace("@ENTRY@", entry)
        .replace("@INIT@", init);
    let header = concat!("-I", env!("CARGO_MANIFEST_DIR"), "/../../sdk/c");
    let out = dir.path().join("probe.so");
    compile(&dir.path().join("probe.c"), &source, &out, &["-shared".into(), header.into()]);
    std::fs::read(out).unwrap()
}

#[track_caller]
fn refused(bytes: &[u8], parts: &[&str]) {
    let world = World::new();
    world.put("x.so", bytes);
    let text = world.load_fault("probe/c").to_string();
    for part in parts {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
}

#[test]
fn a_class_with_only_create_and_destroy_is_taken_when_its_description_needs_no_more() {
    let world = World::new();
    world.put("x.so", &built("", "", ""));
    let store = world.open();
    assert!(store.load(&store.class("probe/c").unwrap()).is_ok());
}

#[test]
fn an_entry_that_the_description_makes_necessary_is_missed() {
    for (more, entry) in [
        (r#","inputs":[{"name":"i","type":{"plain":"f64"}}]"#, "bind"),
        (r#","outputs":[{"name":"o","type":{"plain":"f64"}}]"#, "bind"),
        (r#","required":[{"name":"r","functions":[{"name":"f"}]}]"#, "bind"),
        (r#","provided":[{"name":"p","events":[{"name":"e"}]}]"#, "bind"),
        (r#","provided":[{"name":"p","commands":[{"name":"go","kind":"void"}]}]"#, "command"),
        (r#","provided":[{"name":"p","commands":[{"name":"now","kind":"read","ret":"f64"}]}]"#, "read"),
        (r#","required":[{"name":"r","handlers":[{"name":"h"}]}]"#, "on_event"),
        (r#","state":"f64""#, "state_copy"),
        (r#","safety":"actuator""#, "make_safe"),
        (r#","execution":{"model":"periodic","period_ns":1000000}"#, "step"),
        (r#","config":{"type":"object","properties":{"gain":{"type":"number"}}}"#, "configure"),
    ] {
        refused(&built(more, "", ""), &["class `c` has ", &format!("its entry `{entry}` is null")]);
    }
    refused(&built("", "class_table.create = 0", ""), &["its entry `create` is null"]);
    refused(&built("", "class_table.destroy = 0", ""), &["its entry `destroy` is null"]);
}

#[test]
fn an_entry_behind_the_end_of_its_table_is_missed_too() {
    let state = r#","state":"f64""#;
    refused(&built(state, "class_table.struct_size = 48", ""), &["its entry `state_copy` is null"]);
}

#[test]
fn sizes_that_no_table_has_are_refused_with_both() {
    let class = size_of::<trocar_plugin_api::abi::ClassTable>().to_string();
    let plugin = size_of::<trocar_plugin_api::abi::PluginTable>().to_string();
    for (entry, parts) in [
        ("class_table.struct_size = 4000000000u", ["`c` says it has 4000000000 bytes", &class]),
        ("class_table.struct_size = 16", ["`c` says it has 16 bytes", "needs 32"]),
        ("table.struct_size = 4096", ["its table says it has 4096 bytes", &plugin]),
        ("table.struct_size = 24", ["its table says it has 24 bytes", "needs"]),
    ] {
        refused(&built("", entry, ""), &parts);
    }
}

#[test]
fn a_newer_minor_may_have_longer_tables_and_another_major_none() {
    let world = World::new();
    world.put("x.so", &built("", "table.abi_minor = 9, class_table.struct_size += 8", ""));
    let store = world.open();
    // Bytes behind the struct are never read.
    assert!(store.load(&store.class("probe/c").unwrap()).is_ok());
    refused(&built("", "table.abi_major = 2", ""), &["ABI 1.2 in the manifest, 2.2 in the entry"]);
}

#[test]
fn an_init_that_crashes_hangs_or_refuses_is_found_in_the_child() {
    refused(&built("", "", "abort()"), &["crashes while its init is called"]);
    refused(&built("", "", "return 5"), &["its init answers 5"]);
    let says = r#"static const char why[] = "no licence"; host->log(host->ctx, 1, (trocar_bytes){0, 0}, \
        (trocar_bytes){(const uint8_t *)why, sizeof why - 1}); return 5"#;
    refused(&built("", "", says), &["refuses to work (\"no licence\")"]);
    let mut world = World::new();
    world.vet_limit = Duration::from_millis(1500);
    world.put("x.so", &built("", "", "for (;;) pause()"));
    let text = world.load_fault("probe/c").to_string();
    assert!(text.contains("does not come back within 1 s while its init is called"), "{text}");
}

#[test]
fn what_crashed_is_tried_again_when_it_is_asked_for_and_its_words_are_told() {
    let world = World::new();
    let tries = world.beside("tries");
    let entry = format!(
        "int f = open(\"{}\", O_WRONLY | O_CREAT | O_APPEND, 0600); if (write(f, \"x\", 1) == 1 && write(2, \"no licence\\n\", 11) == 11 \
         && lseek(f, 0, SEEK_END) < 3) abort()",
        tries.display()
    );
    world.put("x.so", &built("", &entry, ""));
    let store = world.open();
    let tried = || store.load(&store.class("probe/c").unwrap()).err().map(|e| e.to_string());
    for _ in 0..2 {
        let error = tried().unwrap();
        assert!(error.contains("crashes while its entry is called"), "{error}");
        assert!(error.contains(r#"saying "no licence""#), "{error}");
    }
    assert_eq!(tried(), None, "what it wants is there");
    // Once more in the host itself.
    assert_eq!(std::fs::read(&tries).unwrap().len(), 4);
}

#[test]
fn another_look_forgets_verdicts_good_and_bad_and_tries_again_at_once() {
    let world = World::new();
    let licence = world.beside("licence");
    let entry = format!("if (access(\"{}\", R_OK) != 0) abort()", licence.display());
    world.put("x.so", &built("", &entry, ""));
    let store = world.open();
    let class = || store.class("probe/c").unwrap();
    let failure = || store.failure(&class().plugin).map(|e| e.to_string());
    store.recheck("");
    assert_eq!(failure(), None, "what was never tried is not tried unless it is named");
    store.recheck("probe");
    assert!(failure().unwrap().contains("crashes while its entry is called"));
    store.recheck("of-another-name.so");
    assert!(failure().is_some());
    std::fs::write(&licence, "").unwrap();
    store.recheck("x.so");
    assert_eq!(failure(), None, "what it wants is there");
    std::fs::remove_file(&licence).unwrap();
    store.recheck("");
    assert!(failure().is_some(), "a good verdict outlived its reason");
    std::fs::write(&licence, "").unwrap();
    assert!(store.load(&class()).is_ok());
    std::fs::remove_file(&licence).unwrap();
    store.recheck("probe");
    assert_eq!(failure(), None, "what is loaded stays");
}
