//! Whether component code left its thread and its process as it found them: signal mask, rounding mode, working directory,
//! threads.
//!
//! Invariant: what can be put back is put back before anybody else's code runs on that thread; whoever did it is named.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use trocar_rt::os::{self, Hygiene};

use super::super::instance::Instance;
use super::super::realtime;
use super::roster::Ward;
use super::watch::{Entry, Misdeed};

/// Time between two looks at the signal masks of threads, ns.
const MASKS_NS: u64 = 1_000_000_000;

/// How long those are looked at one by one of whom one may have done something, ns.
const SUSPECTED_NS: u64 = 10_000_000_000;

/// How a thread and its process stood before an entry.
pub(in crate::lcm) struct Manners {
    thread: Hygiene,
    directory: Option<PathBuf>,
    /// Empty while the component runs: its threads are not to wait for this look.
    threads: BTreeSet<i32>,
}

/// Beginnings of the names of this program's own threads.
const HOUSE: [&str; 3] = ["trocar", "tokio", realtime::HELPER];

impl Manners {
    /// Looks before an entry of the component; not from a step.
    pub(in crate::lcm) fn before(instance: &Instance) -> Manners {
        Manners {
            thread: os::thread_hygiene(),
            directory: std::env::current_dir().ok(),
            threads: if instance.is_active() { BTreeSet::new() } else { threads() },
        }
    }

    /// Looks after it: puts back and says what was changed.
    pub(in crate::lcm) fn after(self, instance: &Instance, entry: Entry) {
        let now = os::thread_hygiene();
        let entry = entry.name();
        if now.rounding != self.thread.rounding {
            os::reset_rounding(self.thread.rounding);
            instance
                .warn(&format!("{entry}: it changed the rounding mode of its thread, which was put back"));
        }
        if now.sigmask != self.thread.sigmask {
            os::set_sigmask(self.thread.sigmask);
            instance.warn(&format!("{entry}: it changed the signal mask of its thread, which was put back"));
        }
        if !self.threads.is_empty() {
            let born = threads().into_iter().filter(|tid| !self.threads.contains(tid));
            let named = born.map(|tid| (tid, thread_name(tid)));
            instance.note_brood(named.filter(|(_, name)| !HOUSE.iter().any(|house| name.starts_with(house))));
        }
        let directory = std::env::current_dir().ok();
        if let Some(before) = &self.directory
            && directory.as_ref() != Some(before)
        {
            let put_back = match std::env::set_current_dir(before) {
                Ok(()) => "which was put back".to_owned(),
                Err(e) => format!("which could not be put back to {}: {e}", before.display()),
            };
            instance.warn(&format!("{entry}: it changed the working directory of the process, {put_back}"));
        }
    }
}

/// Looks at a component around its step, while it is one of several that may have done something. Then, and only then, a
/// step costs some system calls.
pub(in crate::lcm) struct Suspicion {
    sigmask: u64,
    directory: Option<PathBuf>,
}

impl Suspicion {
    pub(in crate::lcm) fn before(instance: &Instance) -> Option<Suspicion> {
        instance.watch.is_suspected().then(|| Suspicion {
            sigmask: os::thread_hygiene().sigmask,
            directory: std::env::current_dir().ok(),
        })
    }

    /// Notes what it did. The signal mask is put back here, the directory by the watchdog, which owns its place.
    pub(in crate::lcm) fn after(self, instance: &Instance) {
        if os::thread_hygiene().sigmask != self.sigmask {
            os::set_sigmask(self.sigmask);
            instance.watch.misdeed(Misdeed::Signals);
        }
        if self.directory.is_some() && std::env::current_dir().ok() != self.directory {
            instance.watch.misdeed(Misdeed::Directory);
        }
    }
}

/// What the watchdog knows of the process and its threads from earlier looks.
#[derive(Default)]
pub(super) struct Premises {
    directory: Option<PathBuf>,
    masks_ns: u64,
    /// Until when somebody is suspected, ns; 0 = nobody is.
    suspected_ns: u64,
}

impl Premises {
    /// One look. `busy` are those that were inside since the last look, the ones with commands first.
    pub(super) fn look(&mut self, now_ns: u64, wards: &[&Ward], busy: &[&Ward]) {
        let mut suspects = self.directory(busy);
        if now_ns.saturating_sub(self.masks_ns) >= MASKS_NS {
            self.masks_ns = now_ns;
            suspects |= wards.iter().filter(|ward| mask(ward, wards)).count() > 0;
        }
        if suspects {
            self.suspected_ns = now_ns + SUSPECTED_NS;
        } else if self.suspected_ns != 0 && now_ns > self.suspected_ns {
            self.suspected_ns = 0;
            wards.iter().for_each(|ward| ward.instance.watch.suspect(false));
        }
    }

    /// True when several are suspected.
    fn directory(&mut self, busy: &[&Ward]) -> bool {
        let Ok(now) = std::env::current_dir() else { return false };
        let before = self.directory.get_or_insert_with(|| now.clone());
        if *before == now {
            return false;
        }
        let put_back = match std::env::set_current_dir(&*before) {
            Ok(()) => "which was put back".to_owned(),
            Err(e) => {
                let text = format!("which could not be put back to {}: {e}", before.display());
                *before = now;
                text
            }
        };
        accuse(busy, &format!("the working directory of the process was changed, {put_back}"))
    }
}

/// Says to those it may have been what was done; alone under suspicion, it was that one. True when there are several: should
/// it happen again, they are looked at one by one, unless one of them has been found out already.
fn accuse(suspects: &[&Ward], what: &str) -> bool {
    let names: Vec<String> = suspects.iter().map(|w| w.instance.id.to_string()).collect();
    match suspects {
        [] => log::warn!("{what}, by no component that was seen running"),
        [ward] => ward.instance.warn(what),
        _ if suspects.iter().any(|w| w.instance.watch.is_suspected()) => return true,
        _ => {
            suspects.iter().for_each(|w| w.instance.warn(&format!("{what}, by one of {}", names.join(", "))));
            suspects.iter().for_each(|w| w.instance.watch.suspect(true));
            return true;
        }
    }
    false
}

/// Looks at the signal mask of one component's thread, as the kernel shows it; true when several are suspected.
fn mask(ward: &Ward, wards: &[&Ward]) -> bool {
    let executor = &ward.executor;
    let (Some(now), Some(own)) = (blocked(executor.tid()), executor.settings.hygiene()) else { return false };
    if now == own.sigmask
        || wards
            .iter()
            .find(|w| w.executor.id == executor.id)
            .is_some_and(|w| w.instance.number != ward.instance.number)
    {
        return false;
    }
    if executor.settings.mask_due.swap(true, Ordering::AcqRel) {
        // Asked for already: it hangs, and would only find more of the same when it comes back.
        return false;
    }
    let settings = executor.clone();
    executor.submit(move |_| {
        os::set_sigmask(own.sigmask);
        settings.settings.mask_due.store(false, Ordering::Release);
    });
    let suspects: Vec<&Ward> = wards.iter().copied().filter(|w| w.executor.id == executor.id).collect();
    accuse(&suspects, "the signal mask of its thread was changed, which was put back")
}

/// Signals a thread of this process blocks, bit 0 = signal 1.
fn blocked(tid: i32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/self/task/{tid}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("SigBlk:"))?;
    u64::from_str_radix(line.trim(), 16).ok()
}

/// Names of threads that run in this process and were started by the component's own code: they bear the name of its thread,
/// as new threads do, or came into being during one of its entries.
pub(in crate::lcm) fn left_behind(ward: &Ward, executors: &BTreeSet<i32>) -> Vec<String> {
    let own = ward.executor.name.as_str();
    let noted = ward.instance.brood();
    // A thread without a name of its own belongs to the one whose name it bears.
    let others: BTreeSet<String> = executors.iter().map(|tid| thread_name(*tid)).collect();
    let is_own =
        |tid: i32, name: &String| name == own || noted.get(&tid) == Some(name) && !others.contains(name);
    threads()
        .into_iter()
        .filter(|tid| !executors.contains(tid))
        .map(|tid| (tid, thread_name(tid)))
        .filter(|(tid, name)| !name.is_empty() && is_own(*tid, name))
        .map(|(_, name)| name)
        .collect()
}

/// Threads of this process, by kernel id.
fn threads() -> BTreeSet<i32> {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    tasks.filter_map(|t| t.file_name().to_str()?.parse().ok()).collect()
}

/// Name of a thread of this process; empty when it is gone.
fn thread_name(tid: i32) -> String {
    let text = std::fs::read_to_string(format!("/proc/self/task/{tid}/comm")).unwrap_or_default();
    text.trim_end().to_owned()
}
