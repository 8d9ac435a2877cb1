//! Ports of one instance by its present description, and everything made for them.
//!
//! Invariant: what two descriptions have in common is the same object in both: a connection of a port that
//! stays notices nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::{Mutex, MutexGuard};
use trocar_model::{Ports, TAPS};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::Mailbox;
use trocar_rt::reply::ReplyPool;

use super::boundary::{
    ERR_BYTES, EventCell, EventTap, NoRoom, Reader, Slots, command_tap, row_tap, same, same_input,
    same_output, same_provided, same_required,
};
use super::core::{CommandTap, RowTap};
use super::goal::Goal;
use super::inbox::{From, Inbox, Position};

/// Commands from outside that may wait.
const EXTERNAL_DEPTH: usize = 64;
/// Blocking calls from outside that may be under way at once.
const EXTERNAL_REPLIES: usize = 16;

/// One description of an instance and everything made for it.
pub(super) struct PortSet {
    pub(super) ports: Arc<Ports>,
    pub(super) slots: Arc<Slots>,
    /// ABI ids of the commands, in order; those of the system interface come last.
    pub(super) commands: Vec<Arc<Position>>,
    /// ABI ids of the handlers, in order.
    pub(super) handlers: Vec<Arc<Position>>,
    /// Queue of the control plane; an entry's index is the command's position here.
    pub(super) external: Arc<Inbox>,
    /// Input and output of the same type, for a filter that is bypassed.
    pub(super) bypass: Option<(usize, usize)>,
    /// Is told of the commands, where there are any.
    pub(super) command_tap: Option<CommandTap>,
    /// Kind of goal of each command.
    pub(super) goals: Arc<[Goal]>,
    max_ret: usize,
}

impl PortSet {
    /// Makes everything for `ports`; parts of `before` that stay are taken over.
    ///
    /// # Errors
    /// There is no memory for the frames of an output.
    pub(super) fn new(ports: Ports, before: Option<&PortSet>) -> Result<PortSet, NoRoom> {
        let slots = Arc::new(Slots::new(&ports, before.map(|b| (&*b.ports, &*b.slots)))?);
        let mut commands = Vec::new();
        for interface in &ports.provided {
            for new in &interface.commands {
                let kept =
                    before.and_then(|b| b.commands.get(same::command(&b.ports, interface, new)?).cloned());
                commands.push(kept.unwrap_or_else(|| Position::new(commands.len())));
            }
        }
        let mut handlers = Vec::new();
        for interface in &ports.required {
            for new in &interface.handlers {
                let kept = before
                    .and_then(|b| b.handlers.get(same::handler(&b.ports, &interface.name, new)?).cloned());
                handlers.push(kept.unwrap_or_else(|| Position::new(handlers.len())));
            }
        }
        let all = || ports.provided.iter().flat_map(|p| &p.commands);
        let max_arg = all().filter_map(|c| c.arg.as_ref()).map(|a| a.ty.size()).max().unwrap_or(0);
        let max_ret = all().filter_map(|c| c.ret.as_ref()).map(|t| t.size()).max().unwrap_or(0);
        let external = Inbox::commands(
            Mailbox::new(EXTERNAL_DEPTH, max_arg, commands.len()),
            ReplyPool::new(EXTERNAL_REPLIES, max_ret, ERR_BYTES),
            commands.clone(),
            From::Outside,
            0,
        );
        let bypass = ports.inputs.first().and_then(|input| {
            let fits = |o: &trocar_model::Output| {
                same_input(
                    input,
                    &trocar_model::Input { name: input.name.clone(), ty: o.ty.clone(), ..input.clone() },
                )
            };
            ports.own_outputs().position(fits).map(|output| (0, output))
        });
        let tap = ports.outputs.iter().position(|output| output.name == TAPS[2]);
        let command_tap = tap.map(|at| {
            let arg_bytes = all().map(|c| c.arg.as_ref().map_or(0, |a| a.ty.size()));
            command_tap(slots.output(at), arg_bytes.collect())
        });
        let goals = all().map(Goal::of).collect();
        Ok(PortSet {
            ports: Arc::new(ports),
            slots,
            commands,
            handlers,
            external,
            bypass,
            command_tap,
            goals,
            max_ret,
        })
    }

    /// The tap of the rows, if there is one.
    pub(super) fn row_tap(&self) -> Option<RowTap> {
        let at = self.ports.outputs.iter().position(|output| output.name == TAPS[0])?;
        Some(row_tap(self.slots.output(at)))
    }

    /// Sends the events to this set's own tap from now on, also events taken over from the set before.
    pub(super) fn tap_events(&self) {
        let tap = self.ports.outputs.iter().position(|output| output.name == TAPS[1]);
        let cell = tap.map(|at| self.slots.output(at));
        for id in 0..self.ports.first_event(self.ports.provided.len()) {
            let tap = cell.map(|cell| EventTap::new(cell, id as u32));
            self.slots.event(id).set_tap(tap);
        }
    }

    /// Words that a result of any command needs.
    pub(super) fn ret_words(&self) -> usize {
        self.max_ret.div_ceil(8)
    }

    /// The system interface's event of that number.
    pub(super) fn system_event(&self, event: usize) -> &Arc<EventCell> {
        let system = self.ports.provided.len().saturating_sub(1);
        self.slots.event(self.ports.first_event(system) + event)
    }

    /// The way to the answer of the read at that position among the commands.
    pub(super) fn reader(&self, command: usize) -> Reader {
        match self.system_command(command) {
            Some(which) => Reader::System(which),
            None => Reader::Class(self.commands[command].clone()),
        }
    }

    /// Number of the system interface's read at that position among the commands.
    pub(super) fn system_command(&self, command: usize) -> Option<usize> {
        command.checked_sub(self.ports.first_command(self.ports.provided.len().saturating_sub(1)))
    }

    /// Gives every command and handler its id in this set; withdraws those of `before` that are not here.
    pub(super) fn renumber(&self, before: &PortSet) {
        let gone = |old: &Arc<Position>, now: &[Arc<Position>]| !now.iter().any(|p| Arc::ptr_eq(p, old));
        before.commands.iter().filter(|p| gone(p, &self.commands)).for_each(|p| p.put(None));
        before.handlers.iter().filter(|p| gone(p, &self.handlers)).for_each(|p| p.put(None));
        for list in [&self.commands, &self.handlers] {
            list.iter().enumerate().for_each(|(id, position)| position.put(Some(id)));
        }
    }

    /// Names of all ports.
    pub(super) fn names(&self) -> Vec<String> {
        let ports = &self.ports;
        let moving = ports.inputs.iter().map(|p| &p.name).chain(ports.outputs.iter().map(|p| &p.name));
        let called = ports.required.iter().map(|p| &p.name).chain(ports.provided.iter().map(|p| &p.name));
        moving.chain(called).cloned().collect()
    }

    /// Names of the ports of `before` that are gone from this set or have changed.
    pub(super) fn lost(&self, before: &PortSet) -> Vec<String> {
        let (old, new) = (&before.ports, &self.ports);
        let inputs = old.inputs.iter().filter(|o| !new.inputs.iter().any(|n| same_input(o, n)));
        let outputs = old.outputs.iter().filter(|o| !new.outputs.iter().any(|n| same_output(o, n)));
        let required = old.required.iter().filter(|o| !new.required.iter().any(|n| same_required(o, n)));
        let provided = old.provided.iter().filter(|o| !new.provided.iter().any(|n| same_provided(o, n)));
        inputs
            .map(|p| p.name.clone())
            .chain(outputs.map(|p| p.name.clone()))
            .chain(required.map(|p| p.name.clone()))
            .chain(provided.map(|p| p.name.clone()))
            .collect()
    }
}

/// Store of an instance's ports.
pub(super) struct Described {
    pub(super) now: BindingCell<Arc<PortSet>>,
    wished: AtomicBool,
    life: Mutex<Life>,
}

#[derive(Default)]
pub(super) struct Life {
    /// Sets whose slots the plugin, or a thread of its own that is about to end, may still hold.
    pub(super) kept: Vec<Arc<PortSet>>,
    /// True while the instance is bound to the class's own set instead of the present one.
    pub(super) fresh: bool,
    /// Ports that are gone or have changed, and whose connections are not cut yet.
    pub(super) lost: Vec<String>,
    /// True when another set took over.
    pub(super) changed: bool,
    /// True when that was at the component's own wish, and is not reported yet.
    pub(super) untold: bool,
}

impl Described {
    /// # Errors
    /// As for [`PortSet::new`].
    pub(super) fn new(ports: Ports) -> Result<Described, NoRoom> {
        let set = PortSet::new(ports, None)?;
        set.tap_events();
        Ok(Described {
            now: BindingCell::new(Box::new(Arc::new(set))),
            wished: AtomicBool::new(false),
            life: Mutex::new(Life::default()),
        })
    }

    pub(super) fn now(&self) -> Arc<PortSet> {
        self.now.enter().clone()
    }

    /// Names of the ports lost since the last call.
    pub(super) fn take_lost(&self) -> Vec<String> {
        let mut life = self.life();
        life.changed = false;
        std::mem::take(&mut life.lost)
    }

    /// Notes that the component wants to be asked for its ports. Any thread; never waits.
    pub(super) fn wish(&self) {
        self.wished.store(true, Ordering::Release);
    }

    #[cfg(test)]
    pub(super) fn is_wished(&self) -> bool {
        self.wished.load(Ordering::Acquire)
    }

    /// True once after each wish.
    pub(super) fn takes_wish(&self) -> bool {
        self.wished.swap(false, Ordering::AcqRel)
    }

    /// Notes that a description at the component's own wish came through: its changes have to be reported.
    pub(super) fn tell_change(&self) {
        let mut life = self.life();
        life.untold = std::mem::take(&mut life.changed) || life.untold;
    }

    /// True once after each change at the component's own wish.
    pub(super) fn changed_by_itself(&self) -> bool {
        std::mem::take(&mut self.life().untold)
    }

    /// The slots of all its sets that still exist.
    pub(super) fn all_slots(&self) -> Vec<Arc<Slots>> {
        let kept = self.life().kept.clone();
        kept.iter().chain([&self.now()]).map(|set| set.slots.clone()).collect()
    }

    pub(super) fn reclaim(&self) -> usize {
        self.now.reclaim() + self.now().slots.reclaim()
    }

    pub(super) fn life(&self) -> MutexGuard<'_, Life> {
        self.life.lock()
    }
}
