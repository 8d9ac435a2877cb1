//! Checks whether component code left its thread and its process as it found them: signal mask, rounding
//! mode, working directory, locale, umask, signal actions, standard streams, threads.
//!
//! Invariant: state that can be restored is restored before code of anybody else runs on that thread; the
//! component that changed it is named. While an entry checks its own manners (`Watch::mind`), a change that
//! is found belongs to that entry and not to the watchdog.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use trocar_rt::os::{self, Household, Hygiene};

use trocar_loader::{self as loader, Moment};

use super::super::instance::Instance;
use super::super::watch::{Entry, Misdeed};
use super::descriptors;
use super::home::{go_home, whereabouts};
use super::household::household;
use super::last::cannot_go_on;
use super::minding::{Minding, minded, minding};
use super::moment;
use super::roster::Guarded;
use super::strangers::Strangers;

/// Time between two looks at the signal mask of a thread, and at the state of the process, ns.
const ROUND_NS: u64 = 1_000_000_000;

/// Time for which suspected components are looked at one by one, ns.
const SUSPECTED_NS: u64 = 10_000_000_000;

/// Counts entries of components, so that one that was alone can be told from those beside others.
struct Visits {
    inside: AtomicUsize,
    begun: AtomicU64,
}

static VISITS: Visits = Visits::new();

impl Visits {
    const fn new() -> Visits {
        Visits { inside: AtomicUsize::new(0), begun: AtomicU64::new(0) }
    }

    /// Counts an entry that begins; returns its number if it is alone.
    fn begin(&self) -> Option<u64> {
        let alone = self.inside.fetch_add(1, Ordering::AcqRel) == 0;
        let number = self.begun.fetch_add(1, Ordering::AcqRel) + 1;
        alone.then_some(number)
    }

    /// Counts an entry that ends; true when no other entry was under way since its begin.
    fn end(&self, alone: Option<u64>) -> bool {
        self.inside.fetch_sub(1, Ordering::AcqRel);
        alone == Some(self.begun.load(Ordering::Acquire))
    }
}

/// State of a thread and its process before an entry.
pub(crate) struct Manners {
    thread: Hygiene,
    /// Working directory at that time; if it was not home, another component had changed it.
    directory: Option<PathBuf>,
    /// Number of the entry while it is alone, and the state of the process then, if that is looked after.
    alone: Option<u64>,
    household: Option<Household>,
    /// True when the entry is alone, and no descriptor of the host had been closed.
    has_all: bool,
    loads: Moment,
    /// `None` while the component runs: its threads must not wait for this look.
    threads: Option<moment::Moment>,
}

impl Manners {
    /// Looks before an entry of the component; not from a step. The watchdog leaves the component alone until
    /// [`Manners::after`].
    pub(crate) fn before(instance: &Instance) -> Manners {
        instance.watch.mind();
        let alone = VISITS.begin();
        let looked_after = alone.is_some() && household().is_some();
        Manners {
            alone,
            has_all: looked_after && descriptors::are_all_there(),
            household: looked_after.then(Household::look),
            thread: os::thread_hygiene(),
            loads: loader::moment(),
            directory: whereabouts().map(|(now, _)| now),
            threads: (!instance.is_active()).then(moment::Moment::now),
        }
    }

    /// Looks after the entry: restores what was changed, and reports it.
    pub(crate) fn after(self, instance: &Instance, entry: Entry) {
        let now = os::thread_hygiene();
        let lasts = matches!(entry, Entry::Create | Entry::Configure);
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
        // Beside other entries the origin of a change is unknown, and another entry may have restored it
        // meanwhile: the watchdog looks then.
        let was_alone = VISITS.end(self.alone) && !loader::has_loaded_since(self.loads);
        if was_alone && self.has_all {
            let why = descriptors::settle(&instance.hub, &format!("{}: {entry}", instance.id));
            why.into_iter().for_each(|why| cannot_go_on(&instance.hub, why));
        }
        if was_alone && let Some(before) = &self.household {
            let now = Household::look();
            let changes = before.put_back(&now);
            if let Some(known) = household().as_mut().filter(|_| !changes.is_empty()) {
                known.take_over(&now);
            }
            for said in changes {
                instance.warn(&format!("{entry}: it changed {said}"));
            }
        }
        if let Some(before) = self.threads {
            instance.threads.set_made(before);
            if !before.is_still_so() {
                let seen = Strangers::look();
                instance.threads.note(seen.since(before).map(|t| (t.tid, t.name.clone())), lasts);
            }
        }
        if let Some((now, home)) = whereabouts()
            && now != home
            && self.directory.is_some_and(|before| before != now)
            && !loader::has_loaded_since(self.loads)
        {
            let put_back = go_home(now, &home);
            instance.warn(&format!("{entry}: it changed the working directory of the process, {put_back}"));
        }
        instance.watch.mind();
    }
}

/// Knowledge of the watchdog about the process and its threads from earlier looks.
#[derive(Default)]
pub(super) struct Premises {
    household_ns: u64,
    /// Moment of that look, counted in loads.
    loads: Option<Moment>,
    masks: Round,
    /// End of the suspicion, ns; 0 = no component is suspected.
    suspected_ns: u64,
}

impl Premises {
    /// Looks once. `are_all` is asked after the look: no component was added since `all_guarded` were taken.
    /// `busy` is asked last: the components that were inside since the last look that returned true; those
    /// with commands first. False: a component inside looks for itself, or is not known yet, so nothing is
    /// reported yet.
    pub(super) fn look<'a>(
        &mut self,
        now_ns: u64,
        all_guarded: &[&'a Guarded],
        are_all: impl FnOnce() -> bool,
        busy: impl FnOnce() -> Vec<&'a Guarded>,
    ) -> bool {
        let directory = look_at_directory(all_guarded, are_all, busy);
        let mut suspects = directory == Found::Several;
        for members in self.masks.due(now_ns, all_guarded) {
            suspects |= mask(&members);
        }
        if now_ns.saturating_sub(self.household_ns) >= ROUND_NS {
            self.household_ns = now_ns;
            let loads = self.loads.replace(loader::moment());
            look_at_household(all_guarded, loads);
        }
        if suspects {
            self.suspected_ns = now_ns + SUSPECTED_NS;
        } else if self.suspected_ns != 0 && now_ns > self.suspected_ns {
            self.suspected_ns = 0;
            all_guarded.iter().for_each(|guarded| guarded.instance.watch.suspect(false));
        }
        directory != Found::TooEarly
    }
}

/// Takes threads in turn, so that each is looked at once in [`ROUND_NS`] and no look takes long.
#[derive(Default)]
struct Round {
    last_ns: u64,
    /// The thread looked at last.
    last: u64,
}

impl Round {
    /// Returns the members of each thread whose turn it is.
    fn due<'a>(&mut self, now_ns: u64, all_guarded: &[&'a Guarded]) -> Vec<Vec<&'a Guarded>> {
        let mut threads: BTreeMap<u64, Vec<&Guarded>> = BTreeMap::new();
        all_guarded.iter().for_each(|guarded| threads.entry(guarded.executor.id).or_default().push(guarded));
        let all = threads.len() as u64;
        let share = all * now_ns.saturating_sub(self.last_ns).min(ROUND_NS) / ROUND_NS;
        if share == 0 {
            return Vec::new();
        }
        self.last_ns = now_ns.min(self.last_ns.max(now_ns.saturating_sub(ROUND_NS)) + share * ROUND_NS / all);
        let (first, then) = (threads.range(self.last + 1..), threads.range(..=self.last));
        let due: Vec<_> = first.chain(then).take(share as usize).collect();
        self.last = due.last().map_or(0, |(id, _)| **id);
        due.into_iter().map(|(_, members)| members.clone()).collect()
    }
}

/// Finds changes of the whole process made by steps, commands and threads of components. Changes by an entry
/// that looks for itself are left to that entry; the loader has reported state that a load left behind.
fn look_at_household(all_guarded: &[&Guarded], loads: Option<Moment>) {
    if household().is_none() {
        return;
    }
    let before = minded(all_guarded);
    let now = Household::look();
    if matches!(minding(all_guarded, &before), Minding::Looks) {
        return;
    }
    let mut known = household();
    if let Some(known) = known.as_mut().filter(|_| loads.is_none_or(loader::has_loaded_since)) {
        known.take_over(&now);
    }
    let changes =
        known.as_ref().filter(|_| !all_guarded.is_empty()).map_or_else(Vec::new, |last| last.put_back(&now));
    *known = Some(if changes.is_empty() { now } else { Household::look() });
    drop(known);
    for said in changes {
        match all_guarded {
            [guarded] => guarded.instance.warn(&format!("it changed {said}")),
            _ => log::warn!(
                "code in this process, of one of {} components or beside them, changed {said}",
                all_guarded.len()
            ),
        }
    }
}

/// Result of a look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// Nothing has changed, or there was no doubt which component did it.
    Settled,
    /// Several components may have done it, and were warned.
    Several,
    /// A component looks for itself, or was added since; the look is repeated later.
    TooEarly,
}

fn look_at_directory<'a>(
    all_guarded: &[&'a Guarded],
    are_all: impl FnOnce() -> bool,
    busy: impl FnOnce() -> Vec<&'a Guarded>,
) -> Found {
    let before = minded(all_guarded);
    let moment = loader::moment();
    let Some((now, home)) = whereabouts().filter(|(now, home)| now != home) else { return Found::Settled };
    if loader::has_loaded_since(moment) || !are_all() {
        return Found::TooEarly;
    }
    let hang = match minding(all_guarded, &before) {
        Minding::Nobody => None,
        Minding::Looks => return Found::TooEarly,
        Minding::Hang(stuck) => Some(stuck),
    };
    let put_back = go_home(now, &home);
    let what = format!("the working directory of the process was changed, {put_back}");
    if accuse(&hang.unwrap_or_else(busy), &what, Misdeed::Directory) {
        Found::Several
    } else {
        Found::Settled
    }
}

/// Warns the suspects of the change; a single suspect did it. True when there are several: if it happens
/// again, they are looked at one by one. A suspect already under such a look would have been found out, so
/// another one did it.
fn accuse(suspects: &[&Guarded], what: &str, misdeed: Misdeed) -> bool {
    if suspects.is_empty() {
        log::warn!("{what}, by no component that was seen running");
        return false;
    }
    // All are asked, so that a change found now is not taken for one found later.
    let (found, free): (Vec<&Guarded>, Vec<&Guarded>) =
        suspects.iter().partition(|g| g.instance.watch.takes_found_out(misdeed));
    let (known, others): (Vec<&Guarded>, Vec<&Guarded>) =
        free.iter().partition(|g| g.instance.watch.is_suspected());
    match others.as_slice() {
        [] => return true,
        [guarded] if found.is_empty() => guarded.instance.warn(what),
        // A change found at one may have been made beside it by another one that is not looked at yet.
        _ => {
            let names: Vec<String> = found.iter().chain(&others).map(|g| g.instance.id.to_string()).collect();
            others.iter().for_each(|g| g.instance.warn(&format!("{what}, by one of {}", names.join(", "))));
            others.iter().for_each(|g| g.instance.watch.suspect(true));
            return true;
        }
    }
    !known.is_empty()
}

/// Looks at the signal mask of these members' thread, as the kernel shows it; true when several are
/// suspected.
fn mask(members: &[&Guarded]) -> bool {
    let Some(executor) = members.first().map(|guarded| &guarded.executor) else { return false };
    let before = minded(members);
    let (Some(now), Some(own)) = (blocked(executor.tid()), executor.settings.hygiene()) else { return false };
    if now == own.sigmask {
        return false;
    }
    let suspects = match minding(members, &before) {
        Minding::Nobody => members.to_vec(),
        Minding::Looks => return false,
        Minding::Hang(stuck) => stuck,
    };
    if executor.settings.mask_due.swap(true, Ordering::AcqRel) {
        // Asked for already: the thread hangs, and more requests would only pile up until it returns.
        return false;
    }
    let settings = executor.clone();
    executor.submit(move |_| {
        os::set_sigmask(own.sigmask);
        settings.settings.mask_due.store(false, Ordering::Release);
    });
    accuse(&suspects, "the signal mask of its thread was changed, which was put back", Misdeed::Signals)
}

/// Signals that a thread of this process blocks, bit 0 = signal 1.
fn blocked(tid: i32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/self/task/{tid}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("SigBlk:"))?;
    u64::from_str_radix(line.trim(), 16).ok()
}
