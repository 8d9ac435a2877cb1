//! Making a component safe whose own thread is not to be had: it hangs, or somebody else hangs on it.
//!
//! Invariant: from another thread only classes that declare `make_safe` callable from any: that entry then touches nothing
//! but what is made for several threads (a Rust class cannot do otherwise: it runs a handle apart from the component). On a
//! thread of its own, since it may hang too. The component's own thread does it once more when it is back.

use std::sync::Arc;
use std::thread;

use trocar_plugin_api::abi::NOT_ACTIVE;

use super::super::instance::Instance;
use super::super::system;
use super::roster::Ward;

/// What moves something and does not come on is made safe as soon as anybody can; its state was set before.
pub(in crate::lcm) fn give_up(ward: &Ward) {
    let instance = &ward.instance;
    if !instance.watch.owe_safe() {
        return;
    }
    // Nobody waits for what will not be run.
    instance.refuse_queued(NOT_ACTIVE);
    if instance.info.safe_from_any_thread {
        make_safe_outside(instance);
    }
    let stuck = instance.clone();
    ward.executor.submit(move |_| {
        match stuck.object.try_enter() {
            Some(mut entered) => stuck.pay_safe(&mut entered),
            // Inside it in a thread of its own, somebody's: that one pays when it looks at the mark on leaving.
            None => stuck.signal(),
        }
    });
}

/// Calls `make_safe` from a new thread.
fn make_safe_outside(instance: &Arc<Instance>) {
    let (stuck, name) = (instance.clone(), "trocar-safe".to_owned());
    let spawned =
        thread::Builder::new().name(name).spawn(move || match stuck.object.make_safe_from_outside() {
            Ok(()) => {
                let told = "it was made safe from another thread";
                log::error!("{}: {told}", stuck.id);
                stuck.message(system::ERROR, told);
            }
            Err(e) => stuck.not_made_safe("make_safe from another thread", &e),
        });
    if let Err(e) = spawned {
        log::error!("{}: it is stuck and there is no thread to make it safe from: {e}", instance.id);
    }
}
