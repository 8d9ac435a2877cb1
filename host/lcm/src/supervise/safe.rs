//! Makes a component safe whose own thread is blocked: it hangs, or another component hangs on it.
//!
//! Invariant: from another thread this is done only for classes that declare `make_safe` callable from any
//! thread: that entry then touches only data made for several threads (a Rust class cannot do otherwise: it
//! runs a handle apart from the component). It runs on a thread of its own, since it may hang too, which
//! another thread reports. The component's own thread does it once more when it is back.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use trocar_loader::system;
use trocar_plugin_api::abi::{NOT_ACTIVE, STATUS_FAILED};
use trocar_rt::house;

use super::super::boundary::EntryError;
use super::super::instance::Instance;
use super::roster::Guarded;

/// Name of a `make_safe` called from here, for reports.
const OUTSIDE: &str = "make_safe from another thread";
/// Longest time for it before a report that its result is unknown.
const PATIENCE: Duration = Duration::from_secs(1);

/// Makes an actuator that makes no progress safe as soon as any thread can; its state was set before.
pub(crate) fn give_up(guarded: &Guarded) {
    let instance = &guarded.instance;
    if !instance.watch.owe_safe() {
        return;
    }
    // No caller waits for a call that will not be run.
    instance.refuse_queued(NOT_ACTIVE);
    if instance.info.safe_from_any_thread {
        make_safe_outside(instance);
    }
    let stuck = instance.clone();
    guarded.executor.submit(move |_| {
        match stuck.object.try_enter() {
            Some(mut entered) => stuck.pay_safe(&mut entered),
            // A thread of its own or of a caller is inside: that thread makes it safe when it looks at the
            // mark on leaving.
            None => stuck.signal(),
        }
    });
}

/// Calls `make_safe` from a new thread.
fn make_safe_outside(instance: &Arc<Instance>) {
    let (stuck, made) = (instance.clone(), instance.account().made());
    let (comes_back, ends) = channel::<()>();
    let spawned = house::spawn(thread::Builder::new().name("trocar-safe".into()), move || {
        // Dropped when the call ends.
        let _comes_back = comes_back;
        match stuck.object.make_safe_from_outside() {
            Ok(()) => {
                let told = "it was made safe from another thread";
                log::error!("{}: {told}", stuck.id);
                stuck.message(system::ERROR, told);
            }
            Err(e) => not_made_safe(&stuck, made, &e),
        }
    });
    let (stuck, spawned) = (instance.clone(), spawned.map(drop));
    let watched = spawned.and_then(|()| {
        let name = "trocar-safe-look".into();
        house::spawn(thread::Builder::new().name(name), move || tell_hang(&stuck, made, &ends)).map(drop)
    });
    if let Err(e) = watched {
        log::error!(
            "{}: it is stuck, and a thread to make it safe, or to look after that, is not to be had: {e}",
            instance.id
        );
    }
}

/// Reports a hang if the other end of `ends` still exists after a time.
fn tell_hang(stuck: &Instance, made: u32, ends: &Receiver<()>) {
    if ends.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
        let text = format!("it has not come back for {} s", PATIENCE.as_secs());
        not_made_safe(stuck, made, &EntryError::new(STATUS_FAILED, text));
    }
}

/// Reports that instance number `made` did not get to its safe condition; only to the log if another one has
/// its place by now.
fn not_made_safe(stuck: &Instance, made: u32, e: &EntryError) {
    if stuck.is_closed() || stuck.account().made() != made {
        log::error!("{}: {OUTSIDE}, of an instance that is no more: {}", stuck.id, e.text);
    } else {
        stuck.not_made_safe(OUTSIDE, e);
    }
}
