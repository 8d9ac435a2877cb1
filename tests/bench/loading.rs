//! From a file in the drop directory to a class that can be created.

use std::hint::black_box;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use trocar::loader::{PluginStore, PluginStoreConfig, inspect_file};
use trocar_tests::{Built, HostProcess, World};

use crate::table::{Goal, Table, median, timed};

/// Repetitions; the median counts.
const RUNS: usize = 7;

/// From a file in the drop directory to a class that can be created.
pub(crate) fn measure(table: &mut Table) {
    let file = Built::plugin("eyerobot");
    let read = timed(|| {
        black_box(std::fs::read(&file).expect("the plugin is built"));
    });
    table.title("Loading a plugin (libtrocar_eyerobot.so)");
    let inspect = timed(|| {
        black_box(inspect_file(&file).expect("the plugin is good"));
    });
    table.row("read, hashed, judged, listed", inspect, Goal::None, "reading the file", read);
    let world = World::new();
    world.drop_in(&file);
    // A file counts as finished when it has not changed for 200 ms; that wait is not the loader's.
    thread::sleep(Duration::from_millis(300));
    let first = |state: &Path| {
        let dirs = vec![world.plugins()];
        let began = Instant::now();
        let config = PluginStoreConfig::new(dirs, state.to_path_buf(), Built::trocar());
        let store = PluginStore::open(config).expect("the directories are good");
        let class = store.class("eyerobot/eyerobot").expect("the class is listed");
        store.load(&class).expect("the plugin loads");
        began.elapsed().as_nanos() as f64
    };
    let vetted = first(&world.path("state-a"));
    table.row(
        "the whole way the first time, with the vetting child",
        vetted,
        Goal::None,
        "reading the file",
        read,
    );
    let again = first(&world.path("state-a"));
    table.row("the whole way, vetted before", again, Goal::None, "reading the file", read);
    table.row(
        "dropped into the directory of a running host → class available",
        appears(&file),
        Goal::None,
        "the wait for a quiet file",
        QUIET_NS,
    );
}

/// Debounce of a watched directory, ns: the least a dropped file can take.
const QUIET_NS: f64 = 100e6;

/// From the copy into the directory to the class in the host's answer, ns.
fn appears(file: &Path) -> f64 {
    let once = || {
        let world = World::new();
        let host = HostProcess::start(&world);
        let grpcurl = host.grpcurl();
        let began = Instant::now();
        world.drop_in(file);
        while grpcurl.classes("host").is_empty() {
            thread::sleep(Duration::from_millis(2));
        }
        began.elapsed().as_nanos() as f64
    };
    median((0..RUNS).map(|_| once()).collect())
}
