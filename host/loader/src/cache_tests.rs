//! Write permissions where plugins are loaded from.
#![allow(clippy::unwrap_used)]

use super::*;

fn content() -> Content {
    Content::of(b"bytes", &[("libvendor.so.1", b"of a vendor")])
}

#[test]
fn a_cache_open_to_others_is_closed() {
    let state = tempfile::tempdir().unwrap();
    let root = state.path().join("plugins");
    fs::create_dir(&root).unwrap();
    fs::set_permissions(&root, Permissions::from_mode(0o777)).unwrap();
    assert!(Cache::open(state.path()).is_ok());
    assert_eq!(fs::metadata(&root).unwrap().mode() & 0o777, 0o700);
}

#[test]
fn a_cache_of_another_user_is_refused() {
    let state = tempfile::tempdir().unwrap();
    let root = state.path().join("plugins");
    fs::create_dir(&root).unwrap();
    if std::os::unix::fs::chown(&root, Some(65534), None).is_err() {
        eprintln!("not run: giving a directory away needs root");
        return;
    }
    let error = Cache::open(state.path()).err().unwrap();
    assert!(matches!(error, StoreError::StateForeign { owner: 65534, .. }), "{error}");
}

#[test]
fn a_noexec_filesystem_is_seen() {
    if Path::new("/proc/self").exists() && is_noexec(Path::new("/proc")).unwrap() {
        let error = StoreError::StateNoExec { dir: "/proc".into() }.to_string();
        assert!(error.contains("noexec") && error.contains("--state DIR"), "{error}");
    } else {
        eprintln!("not run: /proc is not mounted noexec here");
    }
}

#[test]
fn old_versions_go_but_for_those_that_are_kept_and_the_last_one() {
    let state = tempfile::tempdir().unwrap();
    let cache = Cache::open(state.path()).unwrap();
    let day = |n: u64| std::time::SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(n * 86_400);
    let versions: Vec<Hash> = (0..6u8).map(|n| Hash::of(&[n])).collect();
    for (n, hash) in versions.iter().enumerate() {
        cache.put(hash, "sine", &content()).unwrap();
        cache.set_vetted(hash);
        File::open(cache.dir(hash)).unwrap().set_modified(day(n as u64)).unwrap();
    }
    let other = Hash::of(b"of another plugin");
    cache.put(&other, "cosine", &content()).unwrap();
    File::open(cache.dir(&other)).unwrap().set_modified(day(0)).unwrap();
    fs::write(cache.root.join("what-a-person-left"), "").unwrap();
    cache.prune(&[versions[1], versions[5]].into());
    let left: Vec<bool> = versions.iter().map(|hash| cache.dir(hash).exists()).collect();
    assert_eq!(
        left,
        [false, true, false, false, true, true],
        "two that are kept, and the newest of the rest"
    );
    assert!(cache.dir(&other).exists(), "the last one of another name");
    assert!(cache.root.join("what-a-person-left").exists());
}

#[test]
fn nothing_temporary_is_left_behind() {
    let state = tempfile::tempdir().unwrap();
    let cache = Cache::open(state.path()).unwrap();
    let hash = Hash::of(b"bytes");
    let path = cache.put(&hash, "sine", &content()).unwrap();
    assert_eq!(cache.put(&hash, "sine", &content()).unwrap(), path);
    cache.set_vetted(&hash);
    assert!(cache.is_vetted(&hash));
    let names: Vec<_> =
        fs::read_dir(path.parent().unwrap()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(names.iter().all(|n| !n.to_string_lossy().starts_with('.')), "{names:?}");
}
