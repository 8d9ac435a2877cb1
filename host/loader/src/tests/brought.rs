//! Libraries that lie beside a plugin and go into the cache with it. Each test has names of its own: the
//! dynamic linker keeps one library of each name in this process.

use super::*;

/// Compiles a library whose function `name` answers `value`; `more` is what it needs.
fn library(world: &World, file: &str, name: &str, value: i32, more: &[&str]) -> Vec<u8> {
    let out = world.beside(file);
    let source = format!("__attribute__((visibility(\"default\"))) int {name}(void) {{ return {value}; }}");
    let mut flags = vec!["-shared".to_string(), format!("-Wl,-soname,{file}")];
    flags.extend(more.iter().map(|flag| flag.replace("@", world.beside("").to_str().unwrap())));
    compile(&world.beside("library.c"), &source, &out, &flags);
    std::fs::read(out).unwrap()
}

/// A plugin that needs the library and aborts unless `name` answers `value`; it looks beside itself.
fn needing(world: &World, plugin: &'static str, file: &str, name: &str, value: i32) -> Vec<u8> {
    let code = format!(
        "#include <stdlib.h>\nint {name}(void);
         __attribute__((constructor)) static void check(void) {{ if ({name}() != {value}) abort(); }}"
    );
    let flags = vec!["-shared".into(), "-Wl,-rpath,$ORIGIN".into(), world.beside(file).display().to_string()];
    Source { name: plugin, code: code.leak(), flags, ..Source::default() }.build()
}

fn load(store: &PluginStore, plugin: &str) -> Result<LoadedClass, PluginError> {
    store.load(&store.class(&format!("{plugin}/probe_class")).unwrap_or_else(|e| panic!("not listed: {e}")))
}

#[test]
fn a_library_beside_a_plugin_goes_into_the_cache_with_it() {
    let world = World::new();
    let vendor = library(&world, "libalong.so.1", "along", 1, &[]);
    let plugin = needing(&world, "along", "libalong.so.1", "along", 1);
    world.put("libalong_plugin.so", &plugin);
    world.put("libalong.so.1", &vendor);
    let store = world.open();
    let loaded = load(&store, "along").unwrap_or_else(|e| panic!("{e}")).plugin.clone();
    assert_ne!(loaded.hash, Hash::of(&plugin), "another library is another version");
    assert_eq!(std::fs::read(loaded.file.with_file_name("libalong.so.1")).unwrap(), vendor);
    let exe = std::env::current_exe().unwrap();
    try_file(&world.path("libalong_plugin.so"), &exe).unwrap_or_else(|e| panic!("{e}"));
    let seen = inspect_file(&world.path("libalong_plugin.so")).unwrap();
    assert_eq!(seen.brought, [("libalong.so.1".to_string(), Hash::of(&vendor))]);
}

#[test]
fn what_a_brought_library_needs_is_brought_too_and_none_of_them_is_taken_for_a_plugin() {
    let world = World::new();
    library(&world, "libdeep.so", "deep", 3, &[]);
    library(
        &world,
        "libmiddle.so",
        "middle",
        2,
        &["-Wl,--no-as-needed", "@/libdeep.so", "-Wl,-rpath,$ORIGIN"],
    );
    world.put("libtop_plugin.so", &needing(&world, "top", "libmiddle.so", "middle", 2));
    world.put("libmiddle.so", &std::fs::read(world.beside("libmiddle.so")).unwrap());
    let said = world.fault("libtop_plugin.so").to_string();
    assert!(
        said.starts_with("brings the library `libmiddle.so`, which needs the library `libdeep.so`"),
        "{said}"
    );
    world.put("libdeep.so", &std::fs::read(world.beside("libdeep.so")).unwrap());
    let store = world.open();
    assert!(load(&store, "top").is_ok());
    assert_eq!(store.list().len(), 1, "{:?}", store.list());
}

#[test]
fn a_plugin_is_looked_at_again_when_its_library_comes_changes_or_goes() {
    let world = World::new();
    let vendor = library(&world, "libcomes.so.1", "comes", 1, &[]);
    world.put("libcomes_plugin.so", &needing(&world, "comes", "libcomes.so.1", "comes", 1));
    let store = world.open();
    let said = store.class("comes/probe_class").unwrap_err().to_string();
    assert!(said.contains("needs the library `libcomes.so.1`") && said.contains("$ORIGIN"), "{said}");
    let hash = || store.class("comes/probe_class").map(|class| class.plugin.hash);
    let put = |bytes: &[u8]| {
        world.put("libcomes.so.1", bytes);
        store.rescan();
    };
    put(&vendor);
    let first = hash().unwrap();
    put(&library(&world, "libcomes.so.1", "comes", 2, &[]));
    assert_ne!(hash().unwrap(), first, "another version");
    put(&vendor);
    assert_eq!(hash().unwrap(), first);
    std::fs::remove_file(world.path("libcomes.so.1")).unwrap();
    store.rescan();
    assert!(hash().is_err());
}

#[test]
fn a_library_is_judged_like_the_plugin_that_brings_it() {
    let mut world = World::new();
    let vendor = library(&world, "libjudged.so.1", "judged", 1, &[]);
    let plugin = needing(&world, "judged", "libjudged.so.1", "judged", 1);
    world.put("p.so", &plugin);
    let refused = |world: &World, part: &str| {
        let fault = world.fault("p.so");
        let said = fault.to_string();
        assert!(
            said.starts_with("brings the library `libjudged.so.1`, which ") && said.contains(part),
            "{said}"
        );
        fault.reason()
    };
    chmod(&world.put("libjudged.so.1", &vendor), 0o646);
    assert_eq!(refused(&world, "mode 646"), "PLUGIN_UNTRUSTED");
    world.put("libjudged.so.1", &vendor[..vendor.len() / 2]);
    assert_eq!(refused(&world, "truncated"), "PLUGIN_BAD_FILE");
    world.put("libjudged.so.1", &vendor);
    world.trust = Trust::AllowList(AllowList::new("list.json", [Hash::of(&plugin)]));
    assert_eq!(refused(&world, &Hash::of(&vendor).to_string()), "PLUGIN_UNTRUSTED");
    world.trust = Trust::AllowList(AllowList::new("list.json", [Hash::of(&plugin), Hash::of(&vendor)]));
    assert!(world.open().class("judged/probe_class").is_ok());
    std::fs::rename(world.path("libjudged.so.1"), world.path("libjudged.so.1.2")).unwrap();
    std::os::unix::fs::symlink("libjudged.so.1.2", world.path("libjudged.so.1")).unwrap();
    refused(&world, "is a symbolic link");
    world.trust = Trust::Dev;
    assert!(world.open().class("judged/probe_class").is_ok());
}

#[test]
fn a_library_whose_name_stands_for_another_file_in_the_process_is_refused_with_that_file() {
    let world = World::new();
    let dir = |n: i32| {
        let own = World::new();
        let vendor = library(&own, "libshared.so.1", "shared", n, &[]);
        let name = if n == 1 { "first" } else { "second" };
        let plugin = needing(&own, name, "libshared.so.1", "shared", n);
        own.put(&format!("{name}.so"), &plugin);
        own.put("libshared.so.1", &vendor);
        own
    };
    let (first, second) = (dir(1), dir(2));
    let dirs = vec![first.path(""), second.path("")];
    let store = PluginStore::open(PluginStoreConfig { dirs, ..world.config() }).unwrap();
    let loaded = load(&store, "first").unwrap_or_else(|e| panic!("{e}"));
    let error = load(&store, "second").err().unwrap().to_string();
    let there = loaded.plugin.file.with_file_name("libshared.so.1");
    assert!(error.contains(there.to_str().unwrap()) && error.contains("isolation"), "{error}");
    // The same file is no harm.
    let third = needing(&first, "third", "libshared.so.1", "shared", 1);
    first.put("third.so", &third);
    store.rescan();
    assert!(load(&store, "third").is_ok());
    // A plugin that expects the system's is not given that of another plugin.
    let expects = resident::Libraries { needed: vec!["libshared.so.1".into()], brought: Vec::new() };
    let cache = loaded.plugin.file.parent().and_then(Path::parent);
    assert!(matches!(resident::check(&expects, cache), Err(load_fault::LoadFault::OtherLibrary { .. })));
}
