//! The place of a recording, and the reasons why it cannot lie there.
//!
//! Invariant: a file is made only inside of the directory that was configured, and never where there is
//! something already.

use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

/// Makes the file `name` in `directory`.
///
/// # Errors
/// A sentence with what to do.
pub(crate) fn make(directory: &str, name: &str) -> Result<(File, PathBuf), String> {
    let directory = Path::new(if directory.is_empty() { "." } else { directory });
    let inside = directory.canonicalize().map_err(|why| {
        let shown = directory.display();
        format!("directory: {shown:?} is not there: {why}; make it, or configure another")
    })?;
    let asked = Path::new(name);
    if name.is_empty() {
        return Err("path: is empty: say how the recording is to be called, such as trial.mcap".into());
    }
    if name.contains(char::is_control) {
        return Err(format!("path: {name:?} has characters that cannot be seen: leave them out"));
    }
    if asked.extension().is_none_or(|end| !end.eq_ignore_ascii_case("mcap")) {
        return Err(format!(
            "path: {name:?} does not end with .mcap, and MCAP is what is written: add the ending"
        ));
    }
    if asked.components().any(|part| part == Component::ParentDir) {
        return Err(format!(
            "path: {name:?} leads out of the directory with \"..\": name a file inside of {inside:?}"
        ));
    }
    let path = inside.join(asked);
    let (Some(parent), Some(file_name)) = (path.parent(), path.file_name()) else {
        return Err(format!("path: {name:?} names no file: add one"));
    };
    let parent = parent.canonicalize().map_err(|why| {
        format!("path: the directory {:?} is not there: {why}; make it first", parent.display().to_string())
    })?;
    if !parent.starts_with(&inside) {
        return Err(format!(
            "path: {name:?} lies outside of {inside:?}: name a file in there, or configure `directory`"
        ));
    }
    let path = parent.join(file_name);
    match OpenOptions::new().read(true).write(true).create_new(true).open(&path) {
        Ok(file) => {
            // The lock shows others that the file is being written; not every place knows locks, and none
            // needs one.
            let _ = file.try_lock();
            Ok((file, path))
        }
        Err(why) if why.kind() == ErrorKind::AlreadyExists => Err(format!(
            "path: {path:?} exists, and nothing is written over: choose another name, or remove it"
        )),
        Err(why) => Err(format!(
            "path: {path:?} cannot be made: {why}; choose a directory that the host may write to"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_lies_in_its_directory_or_nowhere() {
        let outer = tempfile::tempdir().unwrap();
        let inner = outer.path().join("inner");
        std::fs::create_dir_all(inner.join("day")).unwrap();
        std::os::unix::fs::symlink(outer.path(), inner.join("out")).unwrap();
        std::fs::write(inner.join("there.mcap"), "precious").unwrap();
        let at = |name: &str| make(inner.to_str().unwrap(), name).map(|(_, path)| path);
        for (name, wanted) in [
            ("../a.mcap", "leads out"),
            ("day/../../a.mcap", "leads out"),
            ("/tmp/a.mcap", "lies outside"),
            ("out/a.mcap", "lies outside"),
            ("a.txt", "does not end with .mcap"),
            ("", "is empty"),
            ("a\nb.mcap", "cannot be seen"),
            ("nowhere/a.mcap", "is not there"),
            ("there.mcap", "exists, and nothing is written over"),
        ] {
            let why = at(name).expect_err(name);
            assert!(why.contains(wanted), "{name}: {why}");
        }
        assert_eq!(std::fs::read(inner.join("there.mcap")).unwrap(), b"precious");
        assert!(at("a.mcap").unwrap().ends_with("inner/a.mcap"));
        assert!(at("day/b.mcap").is_ok());
        let whole = inner.canonicalize().unwrap().join("c.mcap");
        assert!(at(whole.to_str().unwrap()).is_ok(), "an absolute path inside is one, too");
        assert!(make("/no/such/place", "a.mcap").unwrap_err().contains("configure another"));
    }
}
