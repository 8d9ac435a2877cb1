//! Descriptors of the host that code in its process has closed: who did it is named, the process is told to
//! be unfit, and ends where it would hear of nothing any more.
//!
//! Invariant: what was closed is told once; what the host closes itself, at its end, is nobody's doing.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use trocar_rt::os::{Descriptor, Lasting};

use trocar_loader::{self as loader, Moment};

use super::super::concern::Concern;
use super::super::hub::Hub;
use super::hygiene::{self, Minding, is_own_process};
use super::last;
use super::roster::Ward;

/// Names of components that are told.
const TOLD: usize = 8;

/// A runtime of this process has lost what it waits at.
static DEAF: AtomicBool = AtomicBool::new(false);

fn lasting() -> MutexGuard<'static, Option<Lasting>> {
    static LASTING: Mutex<Option<Lasting>> = Mutex::new(None);
    LASTING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// When the watchdog began with the first descriptor, counted in loads: the time before, and this time.
#[derive(Default)]
pub(super) struct Turns([Option<Moment>; 2]);

impl Turns {
    fn begin(&mut self) {
        self.0 = [self.0[1], Some(loader::moment())];
    }

    /// A plugin was being loaded since the look at which the descriptor was there.
    fn had_a_load(&self) -> bool {
        self.0[0].or(self.0[1]).is_some_and(loader::has_loaded_since)
    }
}

/// The host has all it needs and runs no component yet: from now on this is looked after. A program that
/// embeds a host does what it likes with its own.
pub fn keep() {
    if is_own_process() {
        *lasting() = Some(Lasting::list());
    }
}

/// The host begins to end.
pub fn let_go() {
    *lasting() = None;
}

pub(super) fn are_all_there() -> bool {
    lasting().as_ref().is_none_or(Lasting::are_all_there)
}

/// Everything that no runtime can do without has been there all the time.
pub(super) fn are_vital_there() -> bool {
    let lasting = lasting();
    !DEAF.load(Ordering::Acquire) && lasting.as_ref().is_none_or(Lasting::are_vital_there)
}

/// Says what is gone, if anything is, and what becomes of the process.
pub(super) fn settle(hub: &Hub, who: &str) {
    let Some((what, is_vital)) = gone(who) else { return };
    if is_vital {
        return last::cannot_go_on(hub, what);
    }
    let why = format!(
        "{what}: it is not reached there any more, and a restart opens them again; close only what the component itself \
         opened, and that once"
    );
    log::error!("{why}");
    hub.warn(Concern::Descriptors, Some(why));
}

/// A sentence on what is gone, once, as the doing of one of these.
pub(super) fn what_is_gone(wards: &[&Ward]) -> Option<String> {
    gone(&suspects(wards)).map(|(what, _)| what)
}

/// A sentence on what is gone, once; true where the process cannot do without it.
fn gone(who: &str) -> Option<(String, bool)> {
    let mut lasting = lasting();
    let gone = lasting.as_mut().map(Lasting::take_gone).filter(|gone| !gone.is_empty())?;
    if gone.iter().any(Descriptor::is_vital) {
        // Under the lock: from now on they are on no list.
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

/// A look of the watchdog, at one descriptor in turn: all within a tenth of a second or so.
pub(super) fn look(hub: &Hub, wards: &[&Ward], turns: &mut Turns) {
    let before = hygiene::minded(wards);
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
    if !is_there && !matches!(hygiene::minding(wards, &before), Minding::Looks) {
        let who = suspects(wards);
        settle(
            hub,
            &if turns.had_a_load() { format!("a plugin that was being loaded, or {who},") } else { who },
        );
    }
}

/// A thread of a component may have done it outside of its entries, so all are named.
fn suspects(wards: &[&Ward]) -> String {
    let names: Vec<String> = wards.iter().take(TOLD).map(|w| w.instance.id.to_string()).collect();
    match (names.as_slice(), wards.len().saturating_sub(TOLD)) {
        ([], _) => "code in this process".to_owned(),
        ([one], _) => one.clone(),
        (_, 0) => format!("one of {}", names.join(", ")),
        (_, more) => format!("one of {} and {more} more", names.join(", ")),
    }
}
