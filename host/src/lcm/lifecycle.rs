//! What Create, Start, Resume, Stop and Reset do inside a component, on its own thread.
//!
//! Invariant: an entry that fails leaves the component in FAULT, safe; one that refuses leaves it as it was.

use trocar_model::{ComponentId, Refusal, State, StopReason};
use trocar_plugin_api::abi::NOT_ACTIVE;

use super::boundary::EntryError;
use super::instance::{Entered, Instance};

/// What an entry came to: the name of the one that failed, and why.
pub(super) type Entry = Result<(), (&'static str, EntryError)>;

pub(super) fn component_error(id: &ComponentId, entry: &'static str, e: EntryError) -> Refusal {
    if e.refused() {
        Refusal::ComponentRefused { id: id.clone(), entry, text: e.text }
    } else {
        Refusal::ComponentFault { id: id.clone(), text: format!("{entry}: {}", e.text) }
    }
}

pub(super) fn make(instance: &Instance, entered: &mut Entered<'_>) -> Entry {
    entered.create(instance.host_table(), &instance.id.to_string()).map_err(|e| ("create", e))?;
    let bound = entered.bind(instance.slots.table()).map_err(|e| ("bind", e));
    if bound.is_err() {
        entered.destroy();
        return bound;
    }
    instance.publish_state(entered);
    Ok(())
}

pub(super) fn start(instance: &Instance, entered: &mut Entered<'_>) -> Entry {
    instance.refuse_queued(NOT_ACTIVE);
    instance.stats.pause();
    entered.inner().cycle = 0;
    run(instance, entered, "start", |e| e.start())
}

pub(super) fn resume(instance: &Instance, entered: &mut Entered<'_>) -> Entry {
    run(instance, entered, "resume", |e| e.resume())
}

fn run(
    instance: &Instance,
    entered: &mut Entered<'_>,
    entry: &'static str,
    f: fn(&mut Entered<'_>) -> Result<(), EntryError>,
) -> Entry {
    entered.inner().last_begin_ns = 0;
    if let Err(e) = f(entered) {
        instance.fail(entered, entry, &e);
        return Err((entry, e));
    }
    instance.publish_state(entered);
    instance.set_state(State::Active, "");
    Ok(())
}

pub(super) fn stop(instance: &Instance, entered: &mut Entered<'_>) -> Entry {
    instance.refuse_queued(NOT_ACTIVE);
    let done = entered.stop();
    if let Err(e) = done {
        instance.fail(entered, "stop", &e);
        return Err(("stop", e));
    }
    instance.make_safe(entered);
    instance.publish_state(entered);
    if instance.is_active() {
        instance.stopped(StopReason::Requested);
    }
    Ok(())
}

/// Destroy, create, configure: an instance that failed is not trusted.
pub(super) fn reset(instance: &Instance, entered: &mut Entered<'_>, config: Option<&str>) -> Entry {
    if instance.is_active() {
        stop(instance, entered)?;
    }
    entered.destroy();
    let again = make(instance, entered).and_then(|()| match config {
        Some(json) => entered.configure(json).map_err(|e| ("configure", e)),
        None => Ok(()),
    });
    match again {
        Ok(()) => {
            instance.publish_state(entered);
            instance.set_state(if config.is_some() { State::Ready } else { State::Created }, "");
            Ok(())
        }
        Err((entry, e)) => {
            instance.fail(entered, entry, &e);
            Err((entry, e))
        }
    }
}
