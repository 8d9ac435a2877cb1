//! One component of this process: its core, its ports, its device, and what is reported of it.
//!
//! Invariant: nothing that stands behind a slot holds it: bindings hold its core.

mod standing;
mod status;
mod threads;

use std::ops::Deref;
use std::sync::{Arc, Weak};

use trocar_loader::system;
use trocar_model::{ClassInfo, ComponentId, Execution, Ports, State, StopReason};
use trocar_plugin_api::abi::HostTable;
use trocar_rt::state::state_table;

use self::standing::Standing;
use self::threads::Threads;
use super::boundary::{AllRemains, EntryError, HostContext, LoadedClass, NoRoom, SharedTable};
use super::context;
use super::core::{Beginning, Component, Core};
use super::described::Described;
use super::hub::Hub;
use super::reading::Reading;
use super::request_queue::{Account, Asker};
use super::thread::Thread;
use super::watch::Entry;

pub(super) use super::core::Entered;

/// Rows of the table behind GetState.
const STATUS_ROWS: usize = 8;

/// Reason to keep a component whose handles outlive it.
pub(super) const HELD: &str =
    "its code still holds ports or host handles of it, in a static or in a thread that did not end";

/// A component, which is its core and what only managers need of it.
pub(super) struct Instance {
    pub(super) core: Arc<Core>,
    pub(super) info: Arc<ClassInfo>,
    /// The ports by the present description.
    pub(super) described: Described,
    /// Reads from outside.
    pub(super) reading: Reading,
    standing: Standing,
    pub(super) threads: Threads,
    host: Arc<HostContext>,
    host_table: Arc<SharedTable>,
    pub(super) hub: Arc<Hub>,
    /// Takes what is left of it when it is dropped.
    remains: Arc<AllRemains>,
    me: Weak<Instance>,
}

impl Deref for Instance {
    type Target = Core;

    #[inline]
    fn deref(&self) -> &Core {
        &self.core
    }
}

impl Instance {
    /// # Errors
    /// There is no memory for the frames of its outputs.
    pub(super) fn new(
        (number, id): (u32, ComponentId),
        (info, class): (Arc<ClassInfo>, LoadedClass),
        (hub, remains): (Arc<Hub>, Arc<AllRemains>),
        execution: &Execution,
        thread: Thread,
    ) -> Result<Arc<Self>, NoRoom> {
        let (status, status_rows) = state_table(system::MAX_BYTES, STATUS_ROWS);
        let described = Described::new(info.ports.clone())?;
        let now = described.now();
        let begin = Beginning {
            external: now.external.clone(),
            row_tap: now.row_tap(),
            command_tap: now.command_tap.clone(),
            goals: now.goals.clone(),
            ret_words: now.ret_words(),
        };
        let core = Core::new((number, id), (&info, class), (&hub, status_rows), (execution, thread), begin);
        let host = HostContext::new(&core, &hub.logs, &hub.request_queue);
        let instance = Arc::new_cyclic(|me| Instance {
            core,
            info,
            described,
            reading: Reading::default(),
            standing: Standing::new(status),
            threads: Threads::default(),
            host_table: host.shared_table(),
            host,
            hub,
            remains,
            me: me.clone(),
        });
        let me = Arc::downgrade(&instance);
        instance.core.belong(me.clone());
        instance.hub.request_queue.enter(number, me);
        instance.publish_status();
        Ok(instance)
    }

    /// Services it has asked for that are not answered yet.
    pub(super) fn account(&self) -> &Account {
        &self.host.account
    }

    pub(super) fn host_table(&self) -> *const HostTable {
        self.host_table.pointer()
    }

    /// The ports by the present description.
    pub(super) fn ports(&self) -> Arc<Ports> {
        self.described.now.enter().ports.clone()
    }

    /// Requests a look at the ports: after a wish, and after its outcome. Any thread; never waits.
    pub(super) fn look_at_ports(&self) {
        context::wake(&self.hub.ports);
    }

    /// Handles a failure that ends trust in the instance: safe state, FAULT, reported everywhere.
    pub(super) fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError) {
        let text = format!("{entry}: {}", error.text);
        // No more of its code runs, then the device is made safe, and only then the failure is reported.
        let before = self.shut(State::Fault, &text);
        // A failure is reported in there, and there is nothing safer to do.
        let _ = self.make_safe(entered);
        let on_failure = self.on_failure();
        on_failure.map(|said| self.keep_warning(said));
        self.tell_change(before);
        self.refuse_queued(self.turned_away());
        self.publish_state(entered);
        self.say(log::Level::Error, &format!("it is in FAULT: {text}"));
        self.message(system::ERROR, &text);
        if let Some(said) = on_failure {
            self.say(log::Level::Warn, said);
            self.message(system::WARNING, said);
        }
    }

    /// Brings the device to its safe condition.
    ///
    /// # Errors
    /// The device did not get there: this was reported everywhere, and a component that moves something, or
    /// panicked, is in FAULT.
    pub(super) fn make_safe(&self, entered: &mut Entered<'_>) -> Result<(), EntryError> {
        let done = self.as_running(Entry::MakeSafe, || entered.make_safe());
        done.inspect_err(|e| self.not_made_safe("make_safe", e))
    }

    /// Makes it safe if that is owed, without a report, which no one could receive any more; on its own
    /// thread.
    pub(super) fn make_safe_silently(&self) {
        if self.watch.owes_safe()
            && let Some(mut entered) = self.object.try_enter()
        {
            let _ = self.as_running(Entry::MakeSafe, || entered.make_safe());
            self.watch.takes_owed_safe();
        }
    }

    /// Drops what cycles that have ended looked at; returns how much is left.
    pub(super) fn reclaim(&self) -> usize {
        self.described.reclaim() + self.core.reclaim()
    }

    /// Ends the plugin's instance. False when it is left with everything it was given: when another thread
    /// still makes it safe, or when handles outlive it; those then report that nobody is connected.
    pub(super) fn destroy(&self, entered: &mut Entered<'_>) -> bool {
        let destroyed = self.as_running(Entry::Destroy, || entered.destroy());
        let why = match destroyed {
            false => "another thread is still making it safe",
            true if self.host.is_held() => HELD,
            true => return true,
        };
        if let Some(me) = self.me.upgrade() {
            self.hub.retire(self.number, &self.id, me, why);
        }
        false
    }

    /// Tells whether its code holds ports or host handles that were to go with one of its instances.
    pub(super) fn holds_on(&self) -> bool {
        self.host.is_held()
    }

    /// Sets the state of a restarted or failed component after `stop`.
    pub(super) fn stopped(&self, reason: StopReason) {
        self.set_state(State::Stopped(reason), "");
    }
}

impl Component for Instance {
    fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError) {
        Instance::fail(self, entered, entry, error);
    }

    fn make_safe(&self, entered: &mut Entered<'_>) {
        // A failure is reported in there, and there is nothing safer to do.
        let _ = Instance::make_safe(self, entered);
    }

    fn warn(&self, text: &str) {
        Instance::warn(self, text);
    }

    fn command_name(&self, command: u32) -> Option<String> {
        let ports = self.ports();
        let mut all = ports.provided.iter().flat_map(|i| i.commands.iter().map(move |c| (i, c)));
        let (interface, command) = all.nth(command as usize)?;
        Some(format!("{}/{}", interface.name, command.name))
    }

    fn wish_ports(&self) {
        self.described.wish();
        self.look_at_ports();
    }
}

impl Asker for Instance {
    fn id(&self) -> &ComponentId {
        &self.id
    }

    fn account(&self) -> &Account {
        Instance::account(self)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // Not destroyed, so that its code may still use what it was given. The hub is kept with that, which
        // keeps it: so they stay, whoever drops the LCM.
        if self.object.is_made() {
            let (hub, core) = (self.hub.clone(), self.core.clone());
            let used = Arc::new((hub, core, self.host_table.clone(), self.described.all_slots()));
            self.host.leave();
            return self.hub.retire(self.number, &self.id, used, "its instance was never destroyed");
        }
        // While a cycle may look there, the follower of ports is woken.
        if self.remains.take(&self.host, self.host_table.clone(), self.described.all_slots()) {
            self.hub.ports.notify();
        }
    }
}
