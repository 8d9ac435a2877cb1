//! The home directory of this process, to which it is brought back.

use std::path::PathBuf;

use parking_lot::Mutex;

/// Home of this process: its working directory when components were first looked after. The lock guards the
/// word only.
static HOME: Mutex<Option<PathBuf>> = Mutex::new(None);

/// The present working directory, and the home directory; `None` if the present one is unknown.
pub(super) fn whereabouts() -> Option<(PathBuf, PathBuf)> {
    let now = std::env::current_dir().ok()?;
    let mut home = HOME.lock();
    let home = home.get_or_insert_with(|| now.clone()).clone();
    Some((now, home))
}

/// Takes the present working directory as the home of the process, before any component's code has run.
pub(super) fn settle() {
    let _ = whereabouts();
}

/// Brings the process back home, or makes the present directory its home; returns the result in words.
pub(super) fn go_home(now: PathBuf, home: &PathBuf) -> String {
    match std::env::set_current_dir(home) {
        Ok(()) => "which was put back".to_owned(),
        Err(e) => {
            *HOME.lock() = Some(now);
            format!("which could not be put back to {}: {e}", home.display())
        }
    }
}
