//! The end of a process that cannot go on: descriptors that its runtimes wait at were closed, or a thread of
//! the host broke down.
//!
//! Invariant: devices come first, and nothing on the way to them wakes a runtime or logs: a runtime whose
//! descriptors are gone panics in the thread that wakes it. Such a panic goes no further than its beginning
//! ([`caught`]): unwinding would drop values that wake more, and a second panic would end the process with
//! its devices driven.

use std::panic;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use parking_lot::{Mutex, MutexGuard};
use trocar_model::State;
use trocar_rt::house;

use super::super::concern::Concern;
use super::super::context;
use super::super::hub::Hub;
use super::super::instance::Instance;
use super::super::watch::Entry;
use super::descriptors;
use super::roster::{Guarded, Roster};

/// Longest time for devices to come to their safe condition.
const PATIENCE: Duration = Duration::from_secs(1);
/// Pause between two looks at them.
const LOOK: Duration = Duration::from_millis(1);
/// Name of the thread that makes them safe.
const NAME: &str = "trocar-last";

/// Reports why, and ends the process.
pub(crate) type End = fn(&str);

static END: OnceLock<End> = OnceLock::new();
/// The components of this process.
static ROSTER: Mutex<Option<Arc<Roster>>> = Mutex::new(None);
static BEGUN: AtomicBool = AtomicBool::new(false);

/// Declares that this process is a host and nothing else, and how it ends when it cannot go on. A program
/// that embeds a host goes on.
pub fn ends_by(end: End) {
    // A process has one program, which calls this once.
    if END.set(end).is_err() {
        return;
    }
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if !descriptors::are_vital_there() {
            caught();
        }
        usual(panic);
    }));
}

/// Notes the components of the process.
pub(super) fn keep(roster: &Arc<Roster>) {
    *own_roster() = Some(roster.clone());
}

fn own_roster() -> MutexGuard<'static, Option<Arc<Roster>>> {
    ROSTER.lock()
}

fn all_guarded() -> Vec<Guarded> {
    own_roster().as_ref().map(|roster| roster.all()).unwrap_or_default()
}

/// Makes all devices that move something safe, and ends the process. A program that embeds a host goes on,
/// unfit.
pub(crate) fn cannot_go_on(hub: &Hub, why: String) {
    if END.get().is_some() {
        begin(why);
    } else {
        log::error!("{why}");
        hub.warn(Concern::Broken, Some(why));
    }
}

/// Stops a thread that panics when the descriptors of the runtimes are gone. A thread that runs components
/// first makes them safe, except the one that it is inside of.
fn caught() -> ! {
    let here = thread::current();
    if here.name() == Some(NAME) {
        // This thread does nothing that could panic; if it does, only the end is left.
        end("its devices could not be made safe");
    }
    let all_guarded = all_guarded();
    for guarded in all_guarded.iter().filter(|guarded| guarded.executor.id == context::executor()) {
        let instance = &guarded.instance;
        cease(instance, "");
        instance.make_safe_silently();
        if !instance.info.safe_from_any_thread {
            // If this thread is inside the component, no other one comes to it any more.
            instance.watch.takes_owed_safe();
        }
    }
    let all: Vec<&Guarded> = all_guarded.iter().collect();
    begin(descriptors::what_is_gone(&all).unwrap_or_else(|| "a thread of the host broke down".to_owned()));
    loop {
        thread::park();
    }
}

/// Starts the end on a thread that nothing can hold up; once.
fn begin(why: String) {
    if BEGUN.swap(true, Ordering::AcqRel) {
        return;
    }
    let said = why.clone();
    if house::spawn(thread::Builder::new().name(NAME.into()), move || stand(&said)).is_err() {
        stand(&why);
    }
}

fn stand(why: &str) {
    let all_guarded = all_guarded();
    all_guarded.iter().for_each(|guarded| cease(&guarded.instance, why));
    // All components that are owed it, also those another thread has begun with.
    all_guarded.iter().filter(|guarded| guarded.instance.watch.owes_safe()).for_each(have_it_made_safe);
    let until = Instant::now() + PATIENCE;
    while all_guarded.iter().any(|guarded| is_underway(&guarded.instance)) && Instant::now() < until {
        thread::sleep(LOOK);
    }
    end(why);
}

fn end(why: &str) -> ! {
    if let Some(end) = END.get() {
        end(why);
    }
    // The call has not ended the process.
    std::process::abort();
}

/// Takes a component out of service if it moves something now, or is about to.
fn cease(instance: &Instance, why: &str) {
    let begins = || instance.watch.busy().is_some_and(|b| matches!(b.entry, Entry::Start | Entry::Resume));
    if instance.is_actuator() && (instance.is_active() || begins()) {
        // The former state is reported to nobody.
        let _ = instance.shut(State::Fault, why);
        instance.watch.owe_safe();
    }
}

fn have_it_made_safe(guarded: &Guarded) {
    let instance = guarded.instance.clone();
    if instance.info.safe_from_any_thread {
        let instance = instance.clone();
        let outside = move || {
            if instance.object.make_safe_from_outside().is_ok() {
                instance.watch.takes_owed_safe();
            }
        };
        // Without a new thread, the component's own one does it.
        let _ = house::spawn(thread::Builder::new().name("trocar-safe".into()), outside);
    }
    guarded.executor.submit(move |_| instance.make_safe_silently());
}

fn is_underway(instance: &Instance) -> bool {
    let makes_safe = || instance.watch.busy().is_some_and(|busy| busy.entry == Entry::MakeSafe);
    instance.watch.owes_safe() || makes_safe()
}
