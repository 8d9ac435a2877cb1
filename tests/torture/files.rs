//! Where the built things are, and what lies in a directory.
//!
//! Invariant: nothing is built or skipped here: what is missing is an error that says what provides it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A file of the directory of the built program and plugins.
pub(crate) fn built(file: &str) -> Result<PathBuf, String> {
    let dir = std::env::var_os("TROCAR_BIN_DIR")
        .ok_or("TROCAR_BIN_DIR is not set: ./tests/run --torture builds what is needed and names it")?;
    let path = Path::new(&dir).join(file);
    if path.exists() { Ok(path) } else { Err(format!("{} is not there: build it", path.display())) }
}

/// The library of a plugin: `sine`, `fixture_torture`.
pub(crate) fn plugin(name: &str) -> Result<PathBuf, String> {
    built(&format!("libtrocar_{name}.so"))
}

/// Every file below a directory, relative to it.
pub(crate) fn below(dir: &Path) -> BTreeSet<PathBuf> {
    let (mut found, mut open) = (BTreeSet::new(), vec![dir.to_path_buf()]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            match entry.file_type() {
                Ok(kind) if kind.is_dir() => open.push(path),
                _ => {
                    found.insert(path.strip_prefix(dir).unwrap_or(&path).to_path_buf());
                }
            }
        }
    }
    found
}

/// No process whose output lies in this directory, or in that of `up`, has said that; at least one has said
/// something.
pub(crate) fn nowhere_in(dir: &Path, words: &str) -> Result<(), String> {
    let printed =
        |file: &PathBuf| file.extension().is_some_and(|e| ["out", "err", "log"].iter().any(|x| e == *x));
    let mut said = 0;
    for file in below(dir).into_iter().filter(printed) {
        let bytes = std::fs::read(dir.join(&file)).map_err(|e| format!("{}: {e}", file.display()))?;
        let text = String::from_utf8_lossy(&bytes);
        if let Some(line) = text.lines().find(|line| line.contains(words)) {
            return Err(format!("{}: {line}", file.display()));
        }
        said += text.len();
    }
    if said > 0 { Ok(()) } else { Err(format!("nobody has said anything in {}", dir.display())) }
}

#[cfg(test)]
mod tests {
    use super::nowhere_in;

    #[test]
    fn what_a_child_of_up_printed_is_read_too() {
        let dir = tempfile::tempdir().unwrap();
        assert!(nowhere_in(dir.path(), "panicked at").unwrap_err().contains("nobody"));
        std::fs::create_dir(dir.path().join("state")).unwrap();
        for file in ["up.out", "state/a.output.old.log"] {
            std::fs::write(dir.path().join(file), "host a listening\n").unwrap();
        }
        assert_eq!(nowhere_in(dir.path(), "panicked at"), Ok(()));
        std::fs::write(dir.path().join("state/output.log"), b"\xffthread 'x' panicked at a.rs:1\n").unwrap();
        let found = nowhere_in(dir.path(), "panicked at").unwrap_err();
        assert!(found.starts_with("state/output.log: ") && found.contains("a.rs:1"), "{found}");
    }
}
