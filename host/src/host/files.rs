//! Files this process may still open: without any, it takes part in nothing new, and is said to be unfit.
//!
//! Invariant: a look opens no file; the list it reads was opened at the beginning.

use std::os::fd::OwnedFd;
use std::sync::{Arc, Weak};
use std::time::Duration;

use rustix::fs::{Dir, Mode, OFlags};
use rustix::process::{Resource, getrlimit};

use crate::lcm::{Concern, LocalLcm};

/// Pause between two looks.
const LOOK: Duration = Duration::from_secs(1);
/// A connection, a plugin, a recording need several files at once: fewer than this are as good as none.
const NONE: u64 = 8;
/// Number of free files that take the warning back, so that it does not come and go.
const BACK: u64 = 32;

/// Looks after them as long as the LCM is there.
pub(super) fn keep(lcm: &Arc<LocalLcm>) {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let list = rustix::fs::open("/proc/self/fd", flags, Mode::empty());
    match list.and_then(|list: OwnedFd| Dir::new(list)) {
        Ok(list) => _ = tokio::spawn(watch(Arc::downgrade(lcm), list)),
        Err(e) => log::warn!("how many files the process has open is not watched: {e}"),
    }
}

async fn watch(lcm: Weak<LocalLcm>, mut list: Dir) {
    let mut looks = tokio::time::interval(LOOK);
    looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut told = false;
    loop {
        looks.tick().await;
        let Some(lcm) = lcm.upgrade() else { return };
        let Some(limit) = getrlimit(Resource::Nofile).current else { continue };
        // Once another part of the program has closed the list, it is of no use any more.
        let Some(open) = count(&mut list) else { return };
        if let Some(warning) = judge(&mut told, open, limit) {
            warning.iter().for_each(|warning| log::error!("{warning}"));
            lcm.warn(Concern::Files, warning);
        }
    }
}

/// Files that are open.
fn count(list: &mut Dir) -> Option<u64> {
    list.rewind();
    let mut all = 0u64;
    while let Some(entry) = list.read() {
        // Without the directory itself and the one above it.
        all += u64::from(!matches!(entry.ok()?.file_name().to_bytes(), b"." | b".."));
    }
    Some(all)
}

/// The warning from now on; `None`: as before.
fn judge(told: &mut bool, open: u64, limit: u64) -> Option<Option<String>> {
    let beyond = open + if *told { BACK } else { NONE } > limit;
    if beyond == std::mem::replace(told, beyond) {
        return None;
    }
    Some(beyond.then(|| {
        format!(
            "nearly all of the {limit} files it may open are in use: nothing new can be made or connected in it; a restart \
             frees them, and `ulimit -n` before its start allows more"
        )
    }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::fs::File;

    use super::*;

    #[test]
    fn it_is_unfit_near_the_limit_and_fit_again_well_below() {
        let mut told = false;
        let mut at = |open| judge(&mut told, open, 1024);
        assert_eq!(at(1016), None, "eight are left");
        assert!(at(1017).unwrap().unwrap().contains("1024 files"));
        assert_eq!(at(1024), None, "told already");
        assert_eq!(at(1000), None, "hardly below");
        assert_eq!(at(992), Some(None));
        assert_eq!(at(1016), None);
        assert!(judge(&mut told, 3, 0).unwrap().is_some(), "a limit that was taken away");
    }

    #[test]
    fn open_files_are_counted_without_another_one() {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
        let mut list = Dir::new(rustix::fs::open("/proc/self/fd", flags, Mode::empty()).unwrap()).unwrap();
        assert!(count(&mut list).unwrap() >= 4, "three streams and the list");
        // Tests beside this one open and close some.
        let many: Vec<File> = (0..400).map(|_| File::open("/dev/null").unwrap()).collect();
        assert!(count(&mut list).unwrap() >= 404);
        drop(many);
    }
}
