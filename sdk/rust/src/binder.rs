//! The slot tables during `bind`, and how the ports of a component are tied to them.
//!
//! Invariant: a slot is handed out only inside its table, at the position that the description counts.

use crate::flow::Flow;
use crate::lease::Tie;
use crate::lists::Layout;
use crate::many::Many;
use trocar_plugin_api::abi::{EventSlot, FnSlot, InSlot, OutSlot, Ports};

/// The slot tables during `bind`. Made by the shims after the counts were compared with the description.
pub struct Binder<'a> {
    ports: &'a Ports,
    tie: &'a Tie,
    lists: &'a Layout,
}

impl<'a> Binder<'a> {
    /// # Safety
    /// The tables hold as many slots as the class describes with `lists`, of the described types, valid while
    /// the lease of `tie` is held.
    pub(crate) unsafe fn new(ports: &'a Ports, tie: &'a Tie, lists: &'a Layout) -> Binder<'a> {
        Binder { ports, tie, lists }
    }

    /// The lists of names that the slots were described with.
    pub fn lists(&self) -> &'a Layout {
        self.lists
    }

    /// Ties an input to the slot at this position.
    pub fn input<P: Flow<Slot = InSlot>>(&self, at: usize, port: &mut P) {
        assert!(at < self.ports.input_count as usize, "input slot {at} does not exist");
        // SAFETY: inside the table; `new` vouches for slot and type.
        unsafe { port.attach(*self.ports.inputs.add(at), self.tie) }
    }

    /// Ties an output to the slot at this position.
    pub fn output<P: Flow<Slot = OutSlot>>(&self, at: usize, port: &mut P) {
        assert!(at < self.ports.output_count as usize, "output slot {at} does not exist");
        // SAFETY: inside the table; `new` vouches for slot and type.
        unsafe { port.attach(*self.ports.outputs.add(at), self.tie) }
    }

    /// Ties a function to the slot at this position.
    pub fn function<P: Flow<Slot = FnSlot>>(&self, at: usize, port: &mut P) {
        assert!(at < self.ports.function_count as usize, "function slot {at} does not exist");
        // SAFETY: inside the table; `new` vouches for slot and type.
        unsafe { port.attach(*self.ports.functions.add(at), self.tie) }
    }

    /// Ties an event to the slot at this position.
    pub fn event<P: Flow<Slot = EventSlot>>(&self, at: usize, port: &mut P) {
        assert!(at < self.ports.event_count as usize, "event slot {at} does not exist");
        // SAFETY: inside the table; `new` vouches for slot and type.
        unsafe { port.attach(*self.ports.events.add(at), self.tie) }
    }
}

/// Ties the ports of a repeated one: its first slot is at `at`, the next ones each `apart` further.
macro_rules! many {
    ($($name:ident, $slot:ty, $table:ident, $count:ident;)*) => {
        impl Binder<'_> {$(
            /// Ties a repeated port, one for each name, from the slot at `at` on, each `apart` further.
            pub fn $name<P: Flow<Slot = $slot> + Default>(
                &self, at: usize, apart: usize, names: &[String], many: &mut Many<P>,
            ) {
                let last = names.len().checked_sub(1).map(|n| at + n * apart);
                let there = self.ports.$count as usize;
                assert!(last.is_none_or(|last| last < there), "slots {at} to {last:?} of {there} do not exist");
                // SAFETY: inside the table, for described positions; `new` vouches for slot and type.
                unsafe { many.tie(self.tie, names, |i| *self.ports.$table.add(at + i * apart)) }
            }
        )*}
    };
}
many! {
    many_inputs, InSlot, inputs, input_count;
    many_outputs, OutSlot, outputs, output_count;
    many_functions, FnSlot, functions, function_count;
    many_events, EventSlot, events, event_count;
}
