//! Libraries that may leave the process, and when they do.

use super::*;

/// The test that is run alone, in a process of its own: threads of other tests would be taken for the
/// plugin's.
const ALONE: &str = "__leaves_when_alone";

#[test]
fn a_library_that_says_unload_leaves_with_its_file_and_last_handle_but_not_under_a_thread() {
    let exe = std::env::current_exe().unwrap();
    let ran = Command::new(exe).args([ALONE, "--test-threads=1", "--nocapture"]).output().unwrap();
    let said = String::from_utf8_lossy(&ran.stdout);
    assert!(
        ran.status.success() && said.contains("1 passed"),
        "{said}{}",
        String::from_utf8_lossy(&ran.stderr)
    );
}

#[test]
fn __leaves_when_alone() {
    if std::env::args().nth(1).as_deref() != Some(ALONE) {
        return;
    }
    let world = World::new();
    let store = world.open();
    let put = |unload: bool, code: &'static str| {
        let manifest = Source::default().manifest_text().replacen('{', &format!("{{\"unload\":{unload},"), 1);
        world.put("p.so", &Source { manifest: Some(manifest), code, ..Source::default() }.build());
        store.rescan();
        store.load(&store.class("probe_class").unwrap()).unwrap_or_else(|e| panic!("{e}"))
    };
    let is_there = |file: &Path| {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
        maps.contains(file.to_str().unwrap())
    };
    let stays = put(false, "int stays;").plugin.file.clone();
    let first = put(true, "int first;");
    let (file, hash) = (first.plugin.file.clone(), first.plugin.hash);
    let second = put(true, "int second;").plugin.file.clone();
    store.rescan();
    assert!(is_there(&file) && store.is_loaded(&hash), "a handle is left");
    drop(first);
    store.rescan();
    assert!(!is_there(&file) && !store.is_loaded(&hash));
    assert!(is_there(&second), "its file is listed");
    std::fs::remove_file(world.path("p.so")).unwrap();
    store.rescan();
    assert!(!is_there(&second));
    assert!(is_there(&stays), "it does not say unload");
    // The same bytes may come again.
    assert!(is_there(&put(true, "int first;").plugin.file));
    let threaded = put(
        true,
        "#include <pthread.h>\n#include <unistd.h>\nstatic void *wait(void *none) { for (;;) pause(); }
         __attribute__((constructor)) static void begin(void) { pthread_t t; pthread_create(&t, 0, wait, 0); }",
    );
    let file = threaded.plugin.file.clone();
    drop(threaded);
    std::fs::remove_file(world.path("p.so")).unwrap();
    store.rescan();
    assert!(is_there(&file), "a thread of it runs");
}
