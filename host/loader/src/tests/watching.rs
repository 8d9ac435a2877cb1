//! News for an observer while files come, change and go under a running store.

use std::io::Write;
use std::sync::mpsc::{Receiver, channel};

use super::*;
use crate::watchdog::Watchdog;

/// Time between two looks of the watchdog.
const LOOK: Duration = Duration::from_secs(1);

struct Watched {
    store: Arc<PluginStore>,
    news: Receiver<CatalogChange>,
    _handle: WatchHandle,
}

fn watched(world: &World) -> Watched {
    let store = world.open();
    let (tell, news) = channel();
    let handle = store.watch(move |change| tell.send(change.clone()).unwrap());
    Watched { store, news, _handle: handle }
}

impl Watched {
    fn next(&self) -> CatalogChange {
        let mut watchdog = Watchdog::of("a change is told");
        loop {
            match self.news.recv_timeout(LOOK) {
                Ok(change) => return change,
                Err(none) => watchdog.saw(none),
            }
        }
    }
}

#[test]
fn a_file_that_arrives_is_told_and_its_class_is_there() {
    let world = World::new();
    let watched = watched(&world);
    world.put("libprobe.so", probe());
    assert!(matches!(watched.next(), CatalogChange::Added(p) if p.name() == "probe"));
    assert!(watched.store.class("probe_class").is_ok());
}

#[test]
fn a_half_copied_file_is_invisible_until_it_is_whole() {
    let world = World::new();
    let watched = watched(&world);
    let (begin, rest) = probe().split_at(probe().len() / 2);
    let mut file = std::fs::File::create(world.path("libprobe.so")).unwrap();
    chmod(&world.path("libprobe.so"), 0o644);
    file.write_all(begin).unwrap();
    // News of another file prove that a look took place meanwhile.
    world.put("libzzz.so", b"text");
    assert!(matches!(watched.next(), CatalogChange::Refused { file, .. } if file.ends_with("libzzz.so")));
    file.write_all(rest).unwrap();
    drop(file);
    assert!(matches!(watched.next(), CatalogChange::Added(p) if p.name() == "probe"));
}

#[test]
fn a_hard_linked_file_is_told_although_nobody_closes_it() {
    let world = World::new();
    std::fs::write(world.beside("built.so"), probe()).unwrap();
    chmod(&world.beside("built.so"), 0o644);
    let watched = watched(&world);
    std::fs::hard_link(world.beside("built.so"), world.path("libprobe.so")).unwrap();
    assert!(matches!(watched.next(), CatalogChange::Added(_)));
}

#[test]
fn a_new_version_is_an_update_and_a_touch_is_nothing() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let watched = watched(&world);
    world.put("libprobe.so", probe());
    let newer = Source { code: "int newer;", ..Source::default() }.build();
    world.put("libother.so", &Source { name: "other", ..Source::default() }.build());
    assert!(matches!(watched.next(), CatalogChange::Added(p) if p.name() == "other"));
    world.put("libprobe.so", &newer);
    match watched.next() {
        CatalogChange::Updated { old, new } => {
            assert_eq!((old.hash, new.hash), (Hash::of(probe()), Hash::of(&newer)));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_removed_file_is_told() {
    let world = World::new();
    let path = world.put("libprobe.so", probe());
    let watched = watched(&world);
    std::fs::remove_file(path).unwrap();
    assert!(matches!(watched.next(), CatalogChange::Removed(p) if p.name() == "probe"));
    assert!(watched.store.class("probe_class").is_err());
}

#[test]
fn a_directory_that_is_made_anew_is_watched_again() {
    let world = World::new();
    world.put("libprobe.so", probe());
    let watched = watched(&world);
    std::fs::rename(world.path(""), world.beside("away")).unwrap();
    assert!(matches!(watched.next(), CatalogChange::Removed(_)));
    std::fs::create_dir(world.path("")).unwrap();
    world.put("libprobe.so", probe());
    assert!(matches!(watched.next(), CatalogChange::Added(_)));
}

#[test]
fn a_dropped_handle_hears_nothing_more() {
    let world = World::new();
    let store = world.open();
    let (tell, news) = channel::<CatalogChange>();
    drop(store.watch(move |change| tell.send(change.clone()).unwrap()));
    world.put("libprobe.so", probe());
    store.rescan();
    assert!(news.recv().is_err(), "the observer still exists");
}
