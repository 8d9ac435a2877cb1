//! The end of a process that cannot go on: what its runtimes wait at was closed, or a thread of the host
//! broke down.
//!
//! Invariant: devices come first, and nothing on the way to them needs a runtime or the log: a runtime whose
//! descriptors are gone panics in whoever wakes it.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use trocar_model::State;

use super::super::api::Concern;
use super::super::hub::Hub;
use super::roster::Ward;
use super::safe;

/// How long devices may take to come to their safe condition.
const PATIENCE: Duration = Duration::from_secs(1);

/// Says why, and ends the process.
pub(crate) type End = fn(&str);

static END: OnceLock<End> = OnceLock::new();

/// This process is a host and nothing else, and ends so when it cannot go on.
pub(super) fn ends_by(end: End) {
    // The first one stays: there is one program in a process.
    let _ = END.set(end);
}

/// Makes everything safe that moves something, and ends the process. A program that embeds a host goes on,
/// unfit.
pub(super) fn end(hub: &Hub, wards: &[Ward], why: String) {
    let Some(end) = END.get() else {
        log::error!("{why}");
        return hub.warn(Concern::Broken, Some(why));
    };
    let until = Instant::now() + PATIENCE;
    let underway: Vec<Receiver<()>> = wards.iter().filter_map(|ward| make_safe(ward, &why)).collect();
    for done in underway {
        // Nothing is sent: it is closed when all is done that can be.
        let _ = done.recv_timeout(until.saturating_duration_since(Instant::now()));
    }
    end(&why);
}

/// Begins to make a component safe that moves something now.
fn make_safe(ward: &Ward, why: &str) -> Option<Receiver<()>> {
    let instance = &ward.instance;
    let moves = instance.is_actuator() && instance.is_active();
    if moves {
        // From here on it takes no goal.
        undaunted(|| _ = instance.set_state_from(State::Active, State::Fault, why));
    }
    moves.then(|| safe::hurry(ward))
}

/// Does what may wake a runtime, which may panic.
pub(in crate::lcm) fn undaunted(what: impl FnOnce()) {
    // Told by whoever found the cause.
    let _ = catch_unwind(AssertUnwindSafe(what));
}

/// Runs a thread of the host; the words of its panic, if it broke down.
pub(in crate::lcm) fn breakdown(thread: impl FnOnce()) -> Option<String> {
    let panic = catch_unwind(AssertUnwindSafe(thread)).err()?;
    Some(said(&*panic).to_owned())
}

fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("a panic without a text")
}
