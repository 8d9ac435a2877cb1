//! Replacement of a component's ports by those of another description of itself.
//!
//! Invariant: ports change only inside the component, between two steps, and only after `describe` made sense
//! and `bind` took them: any failure leaves the old ports, their connections and their queues as they were.

use std::sync::Arc;

use trocar_loader::convert;
use trocar_model::Ports;
use trocar_plugin_api::abi::{DISABLED, STATUS_FAILED};

use super::boundary::{EntryError, EntryResult};
use super::described::PortSet;
use super::inbox::Inbox;
use super::instance::{Entered, Instance};
use super::watch::Entry as Inside;

impl Instance {
    /// Drops what was cut; asks for another look where a cycle under way may still look at that.
    pub(super) fn settle(&self) {
        if self.reclaim() > 0 {
            self.look_at_ports();
        }
    }

    /// Passes on the samples that a failed filter would have worked on: from its first input to its first
    /// output of that type. Leftovers are taken up without a new sample. Component's thread only; real-time.
    pub(super) fn bypass(&self, _inside: &mut Entered<'_>) {
        let set = self.described.now.enter();
        if let Some((input, output)) = set.bypass {
            let output = set.slots.output(output);
            if set.slots.input(input).bypass(|shown, stamp_ns| output.forward(shown, stamp_ns)) {
                self.signal();
            }
        }
    }

    /// Names of the inputs whose connection has a `max_age` and brought nothing younger. Managers only.
    pub(super) fn stale_inputs(&self, now_ns: u64) -> Vec<String> {
        let set = self.described.now();
        let inputs = set.ports.inputs.iter().enumerate();
        inputs.filter(|(i, _)| set.slots.input(*i).is_stale(now_ns)).map(|(_, p)| p.name.clone()).collect()
    }

    /// Locks the frame pools of its outputs into memory, each once; warns of those the machine refused.
    /// Managers only.
    pub(super) fn lock_pools(&self) {
        let set = self.described.now();
        for (output, why) in set.slots.lock_pools() {
            let name = &set.ports.outputs[output].name;
            self.warn(&format!(
                "the frames of {name} are not locked into memory, page faults may delay it: {why}"
            ));
        }
    }

    /// Queues that were full and are not reported yet; see `Inbox::untold_losses`.
    pub(super) fn full_queues(&self, now_ns: u64) -> Vec<Arc<Inbox>> {
        self.queues().into_iter().filter(|i| i.untold_losses(now_ns) > 0).collect()
    }
}

/// Asks the class for its ports and takes them over when they differ. Inside the component, between two
/// steps.
///
/// # Errors
/// `describe` or `bind` failed, or the description contradicts itself; the ports are as before.
pub(super) fn describe(instance: &Instance, entered: &mut Entered<'_>) -> EntryResult {
    let described = instance.as_running(Inside::Describe, || entered.describe(convert::MAX_DESCRIPTION));
    let described = described.map_err(|e| failed("describe", e))?;
    let lies = |text| ("describe", EntryError::new(STATUS_FAILED, text));
    let ports = match described {
        Some(text) => convert::description(&text, &instance.info).map_err(lies)?,
        None => instance.info.ports.clone(),
    };
    if let Some((entry, what)) = entered.lacks(&ports) {
        return Err(lies(format!("it has {what}, but the entry `{entry}` of its class is null")));
    }
    take_over(instance, entered, ports)
}

/// Binds a fresh instance to the ports every instance of its class begins with. Its ports from before a Reset
/// stay for the description that follows: their connections survive it.
pub(super) fn bind_fresh(instance: &Instance, entered: &mut Entered<'_>) -> EntryResult {
    let now = instance.described.now();
    let own = if *now.ports == instance.info.ports && !instance.holds_on() {
        now
    } else {
        let ports = instance.info.ports.clone();
        Arc::new(PortSet::new(ports, still(instance, &now)).map_err(|e| ("bind", EntryError::no_room(e)))?)
    };
    let mut life = instance.described.life();
    life.fresh = !Arc::ptr_eq(&own, &instance.described.now());
    life.kept.push(own.clone());
    drop(life);
    instance.as_running(Inside::Bind, || entered.bind(own.slots.table())).map_err(|e| ("bind", e))
}

/// The set whose ports a new one may take over: none where handles to it are still held, as two threads would
/// otherwise share one port.
fn still<'a>(instance: &Instance, before: &'a PortSet) -> Option<&'a PortSet> {
    (!instance.holds_on()).then_some(before)
}

/// Makes a refusal a failure here: configuration and ports do not go together any more.
fn failed(entry: &'static str, e: EntryError) -> (&'static str, EntryError) {
    let status = if e.panicked() { e.status } else { STATUS_FAILED };
    (entry, EntryError { status, ..e })
}

/// Takes the class's own ports again, after a Reset without a configuration.
pub(super) fn as_fresh(instance: &Instance, entered: &mut Entered<'_>) -> EntryResult {
    take_over(instance, entered, instance.info.ports.clone())
}

fn made(ports: Ports, before: Option<&PortSet>) -> Result<Arc<PortSet>, (&'static str, EntryError)> {
    Ok(Arc::new(PortSet::new(ports, before).map_err(|e| ("describe", EntryError::no_room(e)))?))
}

fn bind_to(instance: &Instance, entered: &mut Entered<'_>, set: &Arc<PortSet>) -> EntryResult {
    instance.described.life().kept.push(set.clone());
    instance.as_running(Inside::Bind, || entered.bind(set.slots.table())).map_err(|e| failed("bind", e))
}

fn take_over(instance: &Instance, entered: &mut Entered<'_>, ports: Ports) -> EntryResult {
    let described = &instance.described;
    let before = described.now();
    let same = *before.ports == ports;
    if same && !described.life().fresh {
        return Ok(());
    }
    let mut shares = !instance.holds_on();
    let mut new = if same && shares { before.clone() } else { made(ports, still(instance, &before))? };
    bind_to(instance, entered, &new)?;
    if shares && instance.holds_on() {
        // The component has just left handles of the previous bind: those handles keep their targets, and the
        // component gets another set.
        shares = false;
        new = made((*new.ports).clone(), None)?;
        bind_to(instance, entered, &new)?;
    }
    let mut life = described.life();
    life.kept.retain(|set| instance.holds_on() || Arc::ptr_eq(set, &before));
    life.fresh = false;
    if Arc::ptr_eq(&new, &before) {
        return Ok(());
    }
    life.changed = true;
    life.lost.extend(if shares { new.lost(&before) } else { before.names() });
    life.kept.push(before.clone());
    drop(life);
    new.renumber(&before);
    new.tap_events();
    instance.show_positions();
    let inner = entered.inner();
    inner.ret.resize(new.ret_words().max(inner.ret.len()), 0);
    inner.row_tap = new.row_tap();
    inner.goals = new.goals.clone();
    instance.set_command_tap(entered, new.command_tap.as_ref());
    described.now.swap(Box::new(new.clone()));
    instance.edit_inboxes(|all| {
        all.retain(|i| !Arc::ptr_eq(i, &before.external));
        all.push(new.external.clone());
    });
    // Calls queued from outside are not executed under another description. Calls queued by others for an
    // interface that is gone are answered before their connections are cut.
    before.external.close(DISABLED);
    instance
        .queues()
        .iter()
        .filter(|inbox| inbox.is_withdrawn())
        .for_each(|inbox| inbox.refuse_all(DISABLED));
    Ok(())
}
