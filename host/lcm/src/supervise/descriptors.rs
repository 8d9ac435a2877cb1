//! Descriptors of the host that code in its process has closed: the suspects are named, the process counts as
//! unfit, and ends if it could receive nothing any more.
//!
//! Invariant: a closed descriptor is reported once; descriptors that the host closes itself, at its end, are
//! not reported.

use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::{Mutex, MutexGuard};
use trocar_rt::os::{Descriptor, Lasting};

use trocar_loader::{self as loader, Moment};

use super::super::concern::Concern;
use super::super::hub::Hub;
use super::household::is_own_process;
use super::minding::{Minding, minded, minding};
use super::roster::Guarded;

/// Most names of components in a report.
const TOLD: usize = 8;

/// True when a runtime of this process has lost a descriptor it waits at.
static DEAF: AtomicBool = AtomicBool::new(false);

fn lasting() -> MutexGuard<'static, Option<Lasting>> {
    static LASTING: Mutex<Option<Lasting>> = Mutex::new(None);
    LASTING.lock()
}

/// Moments at which the watchdog began with the first descriptor, counted in loads: the previous time, and
/// this time.
#[derive(Default)]
pub(super) struct Turns([Option<Moment>; 2]);

impl Turns {
    fn begin(&mut self) {
        self.0 = [self.0[1], Some(loader::moment())];
    }

    /// Tells whether a plugin was being loaded since the look at which the descriptor was there.
    fn had_a_load(&self) -> bool {
        self.0[0].or(self.0[1]).is_some_and(loader::has_loaded_since)
    }
}

/// Starts to look after the descriptors: the host has all it needs and runs no component yet. A program that
/// embeds a host does what it likes with its own.
pub fn keep() {
    if is_own_process() {
        *lasting() = Some(Lasting::list());
    }
}

/// Ends this: the host begins to end.
pub fn let_go() {
    *lasting() = None;
}

pub(super) fn are_all_there() -> bool {
    lasting().as_ref().is_none_or(Lasting::are_all_there)
}

/// Tells whether the descriptors that every runtime needs have been there all the time.
pub(super) fn are_vital_there() -> bool {
    let lasting = lasting();
    !DEAF.load(Ordering::Acquire) && lasting.as_ref().is_none_or(Lasting::are_vital_there)
}

/// Reports the closed descriptors, if there are any. A sentence: the process cannot do without them.
#[must_use = "the process cannot go on then"]
pub(super) fn settle(hub: &Hub, who: &str) -> Option<String> {
    let (what, is_vital) = gone(who)?;
    if is_vital {
        return Some(what);
    }
    let why = format!(
        "{what}: it is not reached there any more, and a restart opens them again; close only what the component itself \
         opened, and that once"
    );
    log::error!("{why}");
    hub.warn(Concern::Descriptors, Some(why));
    None
}

/// A sentence about the closed descriptors, once, with these suspects.
pub(super) fn what_is_gone(all_guarded: &[&Guarded]) -> Option<String> {
    gone(&suspects(all_guarded)).map(|(what, _)| what)
}

/// A sentence about the closed descriptors, once; true if the process cannot do without them.
fn gone(who: &str) -> Option<(String, bool)> {
    let mut lasting = lasting();
    let gone = lasting.as_mut().map(Lasting::take_gone).filter(|gone| !gone.is_empty())?;
    if gone.iter().any(Descriptor::is_vital) {
        // Under the lock: they are on no list from now on.
        DEAF.store(true, Ordering::Release);
    }
    drop(lasting);
    let list: Vec<String> = gone.iter().map(ToString::to_string).collect();
    let what = format!("{who} closed descriptors of the host ({})", list.join(", "));
    Some(match gone.iter().any(Descriptor::is_vital) {
        true => (format!("{what}, without which it hears of nothing"), true),
        false => (what, false),
    })
}

/// Looks at one descriptor in turn, for the watchdog: at all within a tenth of a second or so. The sentence
/// is that of [`settle`].
#[must_use = "the process cannot go on then"]
pub(super) fn look(hub: &Hub, all_guarded: &[&Guarded], turns: &mut Turns) -> Option<String> {
    let before = minded(all_guarded);
    let is_there = match lasting().as_mut() {
        Some(lasting) => {
            if lasting.is_round() {
                turns.begin();
            }
            lasting.is_next_there()
        }
        None => true,
    };
    // An entry that looks after its manners itself comes to it.
    if is_there || matches!(minding(all_guarded, &before), Minding::Looks) {
        return None;
    }
    let who = suspects(all_guarded);
    let who = if turns.had_a_load() { format!("a plugin that was being loaded, or {who},") } else { who };
    settle(hub, &who)
}

/// Names all components: a thread of one may have done it outside of its entries.
fn suspects(all_guarded: &[&Guarded]) -> String {
    let names: Vec<String> = all_guarded.iter().take(TOLD).map(|g| g.instance.id.to_string()).collect();
    match (names.as_slice(), all_guarded.len().saturating_sub(TOLD)) {
        ([], _) => "code in this process".to_owned(),
        ([one], _) => one.clone(),
        (_, 0) => format!("one of {}", names.join(", ")),
        (_, more) => format!("one of {} and {more} more", names.join(", ")),
    }
}
