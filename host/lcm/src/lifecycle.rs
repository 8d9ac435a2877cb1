//! Create, Start, Resume, Stop and Reset inside a component, on its own thread.
//!
//! Invariant: an entry that fails leaves the component in FAULT, safe; one that refuses leaves it as it was.

use trocar_lcm_api::Order;
use trocar_model::{ComponentId, Refusal, State, StopReason};
use trocar_plugin_api::abi::{NOT_ACTIVE, STATUS_FAILED, STATUS_INVALID};

use super::boundary::{EntryError, EntryResult};
use super::core::CALLS_ON_TRIAL;
use super::dynamic;
use super::instance::{Entered, Instance};
use super::watch::Entry as Inside;

pub(super) fn component_error(id: &ComponentId, entry: &'static str, e: EntryError) -> Refusal {
    if e.refused()
        && let Some(no_room) = e.no_room
    {
        return no_room.refusal(id);
    }
    // A component that refused to run is in FAULT all the same: see `run`.
    if e.refused() && !matches!(entry, "start" | "resume" | "stop") {
        Refusal::ComponentRefused { id: id.clone(), entry, text: e.text }
    } else {
        Refusal::ComponentFault { id: id.clone(), text: format!("{entry}: {}", e.text) }
    }
}

pub(super) fn make(instance: &Instance, entered: &mut Entered<'_>) -> EntryResult {
    let inner = entered.inner();
    (inner.started, inner.to_stop) = (false, false);
    instance.set_unsettled(false);
    entered.create(instance.host_table(), &instance.id.to_string()).map_err(|e| ("create", e))?;
    // A debt of the former instance is not this one's.
    instance.watch.takes_owed_safe();
    let bound = dynamic::bind_fresh(instance, entered);
    if bound.is_err() {
        instance.destroy(entered);
        return bound;
    }
    instance.account().made_anew();
    instance.publish_state(entered);
    Ok(())
}

/// Applies the configuration, then the ports that go with it. On a refusal the component goes on as before;
/// any other failure ends trust. The caller has checked that the present state allows it and is not FAULT.
/// `before`: the former configuration.
pub(super) fn configure(
    instance: &Instance,
    entered: &mut Entered<'_>,
    json: &str,
    before: Option<&str>,
    to_state: State,
) -> EntryResult {
    let from = instance.state();
    match entered.configure(json) {
        Ok(()) => {}
        Err(e) if e.refused() => return Err(("configure", e)),
        Err(e) => {
            instance.fail(entered, "configure", &e);
            return Err(("configure", e));
        }
    }
    if let Err((entry, e)) = dynamic::describe(instance, entered) {
        if e.no_room.is_some() && goes_back(instance, entered, before) {
            return Err((entry, EntryError { status: STATUS_INVALID, ..e }));
        }
        instance.fail(entered, entry, &e);
        return Err((entry, e));
    }
    instance.publish_state(entered);
    if from == to_state && instance.state() == from || instance.set_state_from(from, to_state, "") {
        return Ok(());
    }
    // The caller that waited has set the state meanwhile: that one holds.
    Err(("configure", too_late(instance.state())))
}

/// Takes the former configuration, and the ports that go with it. A component that never had one is as good
/// as before: it has to be configured before it runs.
fn goes_back(instance: &Instance, entered: &mut Entered<'_>, before: Option<&str>) -> bool {
    match before {
        None => instance.state() == State::Created,
        Some(json) => entered.configure(json).is_ok() && dynamic::describe(instance, entered).is_ok(),
    }
}

fn too_late(stands: State) -> EntryError {
    EntryError::new(STATUS_FAILED, format!("it took so long that it is {stands}"))
}

/// Result of a Start or Resume.
pub(super) enum Ran {
    Runs,
    /// It was taken back, for this reason: a Stop came, or nobody waits for it any more.
    HeldOff(&'static str),
}

pub(super) type RunResult = Result<Ran, (&'static str, EntryError)>;

/// Tells why a component is not to be set in motion any more; `None`: it may be.
fn held_off(instance: &Instance, order: &Order) -> Option<&'static str> {
    if order.lease.has_ended() {
        return Some("the GCM was lost while this was being carried out");
    }
    instance.hub.latches.hold_off(&instance.id, order.decision)
}

pub(super) fn start(instance: &Instance, entered: &mut Entered<'_>, order: &Order) -> RunResult {
    if let Some(why) = held_off(instance, order) {
        return Ok(Ran::HeldOff(why));
    }
    instance.refuse_queued(NOT_ACTIVE);
    instance.books.steps.reset(instance.period_ns());
    let inner = entered.inner();
    inner.cycle_at_start = inner.cycle;
    inner.on_trial = CALLS_ON_TRIAL;
    inner.started = true;
    run(instance, entered, order, "start", |e| e.start())
}

/// A component that was made anew since it ran last has nothing to go on with: it is started.
pub(super) fn resume(instance: &Instance, entered: &mut Entered<'_>, order: &Order) -> RunResult {
    if !entered.inner().started {
        return start(instance, entered, order);
    }
    if let Some(why) = held_off(instance, order) {
        return Ok(Ran::HeldOff(why));
    }
    run(instance, entered, order, "resume", |e| e.resume())
}

fn run(
    instance: &Instance,
    entered: &mut Entered<'_>,
    order: &Order,
    entry: &'static str,
    f: fn(&mut Entered<'_>) -> Result<(), EntryError>,
) -> RunResult {
    let inner = entered.inner();
    (inner.last_begin_ns, inner.to_stop) = (0, true);
    instance.set_unsettled(true);
    instance.set_going(false);
    let from = instance.state();
    if let Err(e) = f(entered) {
        instance.fail(entered, entry, &e);
        return Err((entry, e));
    }
    instance.publish_state(entered);
    if let Some(why) = held_off(instance, order) {
        stop(instance, entered)?;
        return Ok(Ran::HeldOff(why));
    }
    instance.set_started_by(order.decision.0);
    if instance.set_state_from(from, State::Active, "") {
        // A Stop notes itself before it looks: either it sees the component ACTIVE, or it is seen here.
        return match held_off(instance, order) {
            None => Ok(Ran::Runs),
            Some(why) => stop(instance, entered).map(|()| Ran::HeldOff(why)),
        };
    }
    // Another thread has set the state meanwhile, because this took too long: the component does not begin to
    // run after that.
    let stands = instance.state();
    stop(instance, entered)?;
    Err((entry, too_late(stands)))
}

/// Reverts a start or resume that ended after its caller had given up: the component is as it was before, and
/// safe.
pub(super) fn undo_start(instance: &Instance, entered: &mut Entered<'_>, before: State) {
    if !instance.set_state_from(State::Active, before, "") {
        // The component failed, and that was reported.
        return;
    }
    let said = format!("its start took longer than its caller waited: it was stopped again and is {before}");
    if stop(instance, entered).is_ok() {
        instance.warn(&said);
    }
}

/// Reverts a configuration that ended after its caller had given up. A component that refuses to go back is
/// not trusted.
pub(super) fn undo_configure(
    instance: &Instance,
    entered: &mut Entered<'_>,
    before: Option<&str>,
    state: State,
) {
    match before {
        None => _ = instance.set_state_from(State::Ready, state, ""),
        Some(json) if instance.state() != State::Fault => {
            // One that ran may have been stopped meanwhile: a configuration sets nothing in motion.
            let state = if state == State::Active { instance.state() } else { state };
            if let Err((entry, e)) = configure(instance, entered, json, None, state)
                && e.refused()
            {
                instance.fail(entered, entry, &e);
            }
        }
        Some(_) => return,
    }
    instance.warn("its configure took longer than its caller waited: it has its former configuration again");
    tell_ports(instance);
}

/// Has changes of its ports followed up, if no caller waits for them any more.
pub(super) fn tell_ports(instance: &Instance) {
    instance.described.tell_change();
    instance.look_at_ports();
}

pub(super) fn stop(instance: &Instance, entered: &mut Entered<'_>) -> EntryResult {
    instance.refuse_queued(instance.turned_away());
    let done = instance.as_running(Inside::Stop, || entered.stop());
    instance.watch.stopped();
    if let Err(e) = done {
        instance.fail(entered, "stop", &e);
        return Err(("stop", e));
    }
    entered.inner().to_stop = false;
    let safe = instance.make_safe(entered);
    instance.set_unsettled(false);
    instance.publish_state(entered);
    if instance.is_active() {
        instance.stopped(StopReason::Requested);
    }
    match safe {
        Err(e) if instance.state() == State::Fault => Err(("make_safe", e)),
        _ => Ok(()),
    }
}

/// Destroy, create, configure: an instance that failed is not trusted. If `outlasted` says that its own
/// threads still run after the stop, it is left to them instead of destroyed.
pub(super) fn reset(
    instance: &Instance,
    entered: &mut Entered<'_>,
    config: Option<&str>,
    outlasted: impl FnOnce() -> bool,
) -> EntryResult {
    if instance.is_active() {
        stop(instance, entered)?;
    }
    let kept = outlasted();
    if kept {
        entered.abandon();
    } else {
        instance.destroy(entered);
    }
    instance.clear_warnings();
    if kept {
        instance.warn(
            "reset: threads of its own still run, so the instance that was is not destroyed but kept until the process ends",
        );
    }
    let again = make(instance, entered).and_then(|()| match config {
        Some(json) => {
            let done = instance.as_running(Inside::Configure, || entered.configure(json));
            done.map_err(|e| ("configure", e))?;
            dynamic::describe(instance, entered)
        }
        None => dynamic::as_fresh(instance, entered),
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
