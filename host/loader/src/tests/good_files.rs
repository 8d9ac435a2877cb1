//! Way of a good plugin file: listed without running, loaded once, found by both names.

use parking_lot::Mutex;

use super::*;

#[test]
fn a_plugin_is_listed_described_and_loaded() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let store = world.open();
    let class = store.class("probe/probe_class").unwrap();
    assert_eq!(class.class().doc, "for tests");
    assert!(!store.is_loaded(&class.plugin.hash), "listing must not load");
    let loaded = store.load(&class).unwrap();
    assert!(store.is_loaded(&class.plugin.hash));
    assert!(loaded.table.create.is_some() && loaded.table.destroy.is_some());
    assert_eq!(loaded.class.name, "probe_class");
}

#[test]
fn an_entry_beyond_an_old_plugins_table_reads_as_not_implemented() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let store = world.open();
    let loaded = store.load(&store.class("probe_class").unwrap()).unwrap();
    let table = loaded.table;
    assert!(table.configure.is_none() && table.step.is_none() && table.extension.is_none());
    assert_eq!(table.struct_size as usize, size_of_val(table));
}

#[test]
fn a_second_load_of_the_same_content_gives_the_same_library() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let store = world.open();
    let class = store.class("probe_class").unwrap();
    let (a, b) = (store.load(&class).unwrap(), store.load(&class).unwrap());
    assert!(Arc::ptr_eq(&a.plugin, &b.plugin));
}

#[test]
fn loaded_code_is_found_by_its_hash_after_another_file_took_its_place() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let store = world.open();
    let old = store.class("probe_class").unwrap();
    assert!(store.resident("probe/probe_class", &old.plugin.hash).is_none(), "it was not loaded yet");
    let loaded = store.load(&old).unwrap();
    world.put("libprobe.so", &Source { code: "int other;", ..Source::default() }.build());
    store.rescan();
    let new = store.class("probe_class").unwrap();
    assert_ne!(new.plugin.hash, old.plugin.hash);
    let found = store.resident("probe/probe_class", &old.plugin.hash).expect("its code is in the process");
    assert!(Arc::ptr_eq(&found.plugin, &loaded.plugin));
    for (name, hash) in [
        ("probe/other_class", old.plugin.hash),
        ("prob/probe_class", old.plugin.hash),
        ("probe_class", old.plugin.hash),
        ("probe/probe_class", new.plugin.hash),
    ] {
        assert!(store.resident(name, &hash).is_none(), "{name} of {}", hash.short());
    }
}

#[test]
fn the_cache_is_private_and_a_damaged_copy_in_it_is_replaced() {
    use std::os::unix::fs::MetadataExt;
    let world = World::new();
    world.put("libprobe.so", probe());
    let file =
        |store: &PluginStore| store.load(&store.class("probe_class").unwrap()).unwrap().plugin.file.clone();
    let cached = file(&world.open());
    assert_eq!(std::fs::metadata(&cached).unwrap().mode() & 0o777, 0o500);
    assert_eq!(std::fs::metadata(cached.parent().unwrap()).unwrap().mode() & 0o777, 0o700);
    std::fs::remove_file(&cached).unwrap();
    std::fs::write(&cached, b"not the plugin").unwrap();
    assert_eq!(file(&world.open()), cached);
    assert_eq!(std::fs::read(&cached).unwrap(), probe());
}

#[test]
fn truncating_the_dropped_file_of_a_loaded_plugin_does_not_touch_it() {
    let world = World::new();
    let path = world.put("libprobe.so", probe());
    let store = world.open();
    let loaded = store.load(&store.class("probe_class").unwrap()).unwrap();
    std::fs::File::options().write(true).open(&path).unwrap().set_len(100).unwrap();
    store.rescan();
    assert!(store.class("probe_class").is_err(), "the damaged file is still listed");
    let create = loaded.table.create.unwrap();
    let name = trocar_plugin_api::abi::Bytes { ptr: std::ptr::null(), len: 0 };
    // SAFETY: the probe's `create` ignores its arguments.
    assert!(!unsafe { create(std::ptr::null(), name, std::ptr::null_mut()) }.is_null());
}

#[test]
fn the_vetting_verdict_is_kept_by_content() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let store = world.open();
    store.load(&store.class("probe_class").unwrap()).unwrap();
    let config = PluginStoreConfig { host_exe: "/nowhere/trocar".into(), ..world.config() };
    let again = PluginStore::open(config.clone()).unwrap();
    again.load(&again.class("probe_class").unwrap()).unwrap();
    world.put("libprobe.so", &Source { code: "int other;", ..Source::default() }.build());
    again.rescan();
    let error = again.load(&again.class("probe_class").unwrap()).err().unwrap().to_string();
    assert!(error.contains("/nowhere/trocar"), "{error}");
}

#[test]
fn an_unknown_class_names_the_nearest_and_what_exists() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let error = world.open().class("prob_class").unwrap_err();
    assert_eq!(error.reason(), "CLASS_NOT_FOUND");
    let said = error.to_string();
    assert!(said.contains("did you mean `probe/probe_class`"), "{said}");
}

#[test]
fn an_unknown_class_of_a_refused_file_says_why_the_file_is_refused() {
    let world = World::new();
    world.put("libtrocar_sine.so", b"");
    let said = world.open().class("sine").unwrap_err().to_string();
    assert!(said.contains("libtrocar_sine.so: is empty"), "{said}");
}

#[test]
fn a_short_class_name_of_two_plugins_names_both_full_names() {
    let world = World::new();
    world.put("liba.so", probe());
    world.put("libb.so", &Source { name: "other", ..Source::default() }.build());
    let store = world.open();
    let said = store.class("probe_class").unwrap_err().to_string();
    assert!(said.contains("probe/probe_class") && said.contains("other/probe_class"), "{said}");
    assert!(store.class("other/probe_class").is_ok());
}

#[test]
fn what_a_plugin_prints_while_it_is_tried_out_does_not_disturb_the_verdict() {
    let world = World::new();
    let code = "#include <stdio.h>\n__attribute__((constructor)) static void hello(void) \
                { puts(\"trocar-vet {\\\"no_entry\\\":null}\"); fflush(stdout); }";
    world.put("libprobe.so", &Source { code, ..Source::default() }.build());
    let store = world.open();
    assert!(store.load(&store.class("probe_class").unwrap()).is_ok());
}

#[test]
fn a_plugin_logs_to_the_stores_log_under_its_name() {
    static LINES: Mutex<Vec<String>> = Mutex::new(Vec::new());
    fn take(plugin: &str, level: u32, target: &str, message: &str) {
        LINES.lock().push(format!("{plugin} {level} {target} {message}"));
    }
    let host = host_table::for_plugin("probe", take, 0);
    let text = |s: &'static str| trocar_plugin_api::abi::Bytes { ptr: s.as_ptr(), len: s.len() };
    // SAFETY: the table is complete and lives for ever.
    let host = unsafe { &*host };
    // SAFETY: called as the contract says.
    unsafe { (host.log)(host.ctx, trocar_plugin_api::abi::LOG_WARN, text("filter"), text("late")) };
    assert_eq!(*LINES.lock(), ["probe 2 filter late"]);
    // SAFETY: as above.
    assert!(unsafe { (host.now_ns)(host.ctx) } > 0);
}

#[test]
fn inspection_of_a_named_file_tells_the_same_without_a_store() {
    let world = World::new();
    let flags = vec!["-shared".into(), "-Wl,--no-as-needed".into(), "-lm".into()];
    let bytes = Source { flags, ..Source::default() }.build();
    let inspection = inspect_file(&world.put("libprobe.so", &bytes)).unwrap();
    assert_eq!(inspection.manifest.name, "probe");
    assert_eq!(inspection.hash, Hash::of(&bytes));
    assert!(inspection.needed.iter().any(|n| n.starts_with("libm.so")), "{:?}", inspection.needed);
}

#[test]
fn a_missing_plugin_directory_says_how_to_make_it() {
    let world = World::new();
    let dirs = vec![world.beside("none")];
    let error = PluginStore::open(PluginStoreConfig { dirs, ..world.config() }).err().unwrap();
    assert!(error.to_string().contains("mkdir -p"), "{error}");
    let dirs = vec![world.put("x.so", b"")];
    let error = PluginStore::open(PluginStoreConfig { dirs, ..world.config() }).err().unwrap();
    assert!(matches!(error, StoreError::DirNotADirectory { .. }), "{error}");
}

#[test]
fn a_state_directory_that_cannot_be_made_is_named() {
    let world = World::new();
    std::fs::write(world.beside("file"), b"").unwrap();
    let state = world.beside("file").join("state");
    let error = PluginStore::open(PluginStoreConfig { state, ..world.config() }).err().unwrap();
    assert!(error.to_string().contains("--state DIR"), "{error}");
}

#[test]
fn more_plugins_with_thread_locals_than_static_tls_has_room_for_are_loaded() {
    const NAMES: [&str; 20] = [
        "p00", "p01", "p02", "p03", "p04", "p05", "p06", "p07", "p08", "p09", "p10", "p11", "p12", "p13",
        "p14", "p15", "p16", "p17", "p18", "p19",
    ];
    let code = "static __thread char local[1024];
                __attribute__((constructor)) static void touch(void) { ((volatile char *)local)[7] = 1; }";
    let world = World::new();
    for name in NAMES {
        world.put(&format!("{name}.so"), &Source { name, code, ..Source::default() }.build());
    }
    let store = world.open();
    for name in NAMES {
        let class = store.class(&format!("{name}/probe_class")).unwrap();
        store.load(&class).unwrap_or_else(|e| panic!("{e}"));
    }
}

#[test]
fn a_unique_symbol_is_a_warning_that_names_it() {
    let code =
        "__asm__(\".pushsection .bss\\n.globl shared_by_all\\n.type shared_by_all, @gnu_unique_object\\n\"
                \".size shared_by_all, 8\\nshared_by_all: .zero 8\\n.popsection\\n\");";
    let facts = facts_of(&Source { code, ..Source::default() }.build()).unwrap();
    assert!(facts.warnings[0].contains("`shared_by_all`"), "{:?}", facts.warnings);
}
