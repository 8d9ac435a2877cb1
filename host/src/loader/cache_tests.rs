//! Who may write where plugins are loaded from.
#![allow(clippy::unwrap_used)]

use super::*;

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
fn nothing_temporary_is_left_behind() {
    let state = tempfile::tempdir().unwrap();
    let cache = Cache::open(state.path()).unwrap();
    let hash = Hash::of(b"bytes");
    let path = cache.put(&hash, "sine", b"bytes").unwrap();
    assert_eq!(cache.put(&hash, "sine", b"bytes").unwrap(), path);
    cache.set_vetted(&hash);
    assert!(cache.is_vetted(&hash));
    let names: Vec<_> =
        fs::read_dir(path.parent().unwrap()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(names.iter().all(|n| !n.to_string_lossy().starts_with('.')), "{names:?}");
}
