//! Looks at a component around its step, while it is one of several suspects.
//!
//! Invariant: a step costs these system calls only while its component is suspected.

use std::path::PathBuf;

use trocar_rt::os;

use super::super::watch::{Misdeed, Watch};
use super::home::whereabouts;

/// State before a step of a suspect. Only then a step costs some system calls.
pub(crate) struct Suspicion {
    sigmask: u64,
    directory: Option<PathBuf>,
}

impl Suspicion {
    pub(crate) fn before(watch: &Watch) -> Option<Suspicion> {
        watch.is_suspected().then(|| Suspicion {
            sigmask: os::thread_hygiene().sigmask,
            directory: std::env::current_dir().ok(),
        })
    }

    /// Notes the changes that the step made. The signal mask is restored here, the directory by the watchdog,
    /// which owns its place.
    pub(crate) fn after(self, watch: &Watch) {
        if os::thread_hygiene().sigmask != self.sigmask {
            os::set_sigmask(self.sigmask);
            watch.find_out(Misdeed::Signals);
        }
        // If the process is back home, the watchdog went there meanwhile.
        if whereabouts().is_some_and(|(now, home)| now != home && self.directory.is_some_and(|b| b != now)) {
            watch.find_out(Misdeed::Directory);
        }
    }
}
