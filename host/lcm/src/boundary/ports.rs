//! The slot tables of one instance: cells, the immutable slot structs that point to them, and the arrays of
//! pointers the plugin gets at `bind`.
//!
//! Invariant: cells and slots never move and live as long as a table that holds them; positions are the
//! description's. A port that stays from one description to the next keeps its cell and its slot, and with
//! them all its connections.

use std::sync::Arc;

use trocar_model::{Output, PortType, Ports as Described, Type};
use trocar_plugin_api::abi::{EventSlot, FnSlot, InSlot, OutSlot, Ports};
use trocar_rt::os::OsError;
use trocar_rt::pool::{self, FramePool};

use super::call::{self, FnCell};
use super::event::{self, EventCell};
use super::host_table::HostContext;
use super::input::{self, InCell};
use super::no_room::NoRoom;
use super::output::{self, OutCell};
use super::same::{self, same_input, same_output};

/// Frames in the pool of an output whose manifest names a size but no count.
const DEFAULT_POOL: u32 = 8;

/// A cell and the slot that points to it.
struct Port<C, S> {
    cell: Arc<C>,
    slot: Arc<S>,
}

impl<C, S> Clone for Port<C, S> {
    fn clone(&self) -> Self {
        Port { cell: self.cell.clone(), slot: self.slot.clone() }
    }
}

impl<C, S> Port<C, S> {
    fn new(cell: C, slot: impl FnOnce(*mut std::ffi::c_void) -> S) -> Self {
        let cell = Arc::new(cell);
        let slot = Arc::new(slot(Arc::as_ptr(&cell).cast_mut().cast()));
        Port { cell, slot }
    }
}

/// The ports of one description.
pub(crate) struct Slots {
    /// The class's own outputs, then the taps.
    outputs: Vec<Port<OutCell, OutSlot>>,
    inputs: Vec<Port<InCell, InSlot>>,
    functions: Vec<Port<FnCell, FnSlot>>,
    /// The class's own events, then those of the system interface.
    events: Vec<Port<EventCell, EventSlot>>,
    table: Box<Ports>,
    _pointers: Pointers,
}

struct Pointers {
    outputs: Vec<*const OutSlot>,
    inputs: Vec<*const InSlot>,
    functions: Vec<*const FnSlot>,
    events: Vec<*const EventSlot>,
}

// SAFETY: the raw pointers point into the Arcs of the same struct, which are Sync (cells) or immutable
// (slots).
unsafe impl Send for Slots {}
// SAFETY: as above.
unsafe impl Sync for Slots {}

fn size_of_slot<T>() -> u32 {
    size_of::<T>() as u32
}

/// Bytes of the pool that is made together with an output; 0 without one.
fn pool_bytes(ty: &PortType) -> usize {
    match ty {
        PortType::Frame { header, max_bytes, .. } if *max_bytes > 0 => {
            FramePool::bytes(DEFAULT_POOL, header.size(), *max_bytes).unwrap_or(usize::MAX)
        }
        _ => 0,
    }
}

/// Checks room for all pools together, before the first page is taken: all are made or none.
fn room_for<'a>(outputs: impl Iterator<Item = &'a Output>) -> Result<(), NoRoom> {
    let pools: Vec<(&Output, usize)> =
        outputs.map(|o| (o, pool_bytes(&o.ty))).filter(|(_, n)| *n > 0).collect();
    let bytes = pools.iter().fold(0usize, |sum, (_, n)| sum.saturating_add(*n));
    if bytes == 0 {
        return Ok(());
    }
    pool::room_for(bytes).map_err(|e| NoRoom {
        outputs: pools.iter().map(|(o, _)| o.name.clone()).collect(),
        bytes: bytes as u64,
        why: e.to_string(),
    })
}

fn new_output(output: &Output) -> Result<Port<OutCell, OutSlot>, NoRoom> {
    let cell = OutCell::new(&output.name, &output.ty);
    if let PortType::Frame { max_bytes, .. } = output.ty
        && max_bytes > 0
    {
        cell.make_pool(max_bytes, DEFAULT_POOL).map_err(|e| NoRoom {
            outputs: vec![output.name.clone()],
            bytes: pool_bytes(&output.ty) as u64,
            why: e.to_string(),
        })?;
    }
    Ok(Port::new(cell, |ctx| OutSlot {
        struct_size: size_of_slot::<OutSlot>(),
        flags: 0,
        ctx,
        write: output::write,
        loan: output::loan,
        commit: output::commit,
        cancel: output::cancel,
        forward: output::forward,
        reserve: output::reserve,
        type_of: output::type_of,
        write_bytes: output::write_bytes,
    }))
}

fn new_input() -> Port<InCell, InSlot> {
    Port::new(InCell::new(), |ctx| InSlot {
        struct_size: size_of_slot::<InSlot>(),
        flags: 0,
        ctx,
        latest: input::latest,
        next: input::next,
        release: input::release,
        writable: input::writable,
        type_of: input::type_of,
        header_len: input::header_len,
        hold: input::hold,
    })
}

fn new_function() -> Port<FnCell, FnSlot> {
    Port::new(FnCell::unbound(), |ctx| FnSlot {
        struct_size: size_of_slot::<FnSlot>(),
        flags: 0,
        ctx,
        call: call::call,
        type_of: call::type_of,
        call_bytes: call::call_bytes,
    })
}

fn new_event(payload: Option<&Type>) -> Port<EventCell, EventSlot> {
    Port::new(EventCell::new(payload.map_or(0, Type::size)), |ctx| EventSlot {
        struct_size: size_of_slot::<EventSlot>(),
        flags: 0,
        ctx,
        emit: event::emit,
    })
}

impl Slots {
    /// Makes slots for `ports`; slots of an earlier description that stay are taken over from it.
    ///
    /// # Errors
    /// There is no memory for the frames of an output.
    pub(crate) fn new(ports: &Described, before: Option<(&Described, &Slots)>) -> Result<Self, NoRoom> {
        let stays = |new: &Output| {
            let (old, slots) = before?;
            let i = old.outputs.iter().position(|o| same_output(o, new))?;
            slots.outputs.get(i).cloned()
        };
        room_for(ports.outputs.iter().filter(|new| stays(new).is_none()))?;
        let outputs = ports
            .outputs
            .iter()
            .map(|new| stays(new).map_or_else(|| new_output(new), Ok))
            .collect::<Result<Vec<_>, _>>()?;
        let inputs: Vec<Port<InCell, InSlot>> = ports
            .inputs
            .iter()
            .map(|new| {
                let kept = before.and_then(|(old, slots)| {
                    let i = old.inputs.iter().position(|o| same_input(o, new))?;
                    slots.inputs.get(i).cloned()
                });
                kept.unwrap_or_else(new_input)
            })
            .collect();
        let mut functions = Vec::new();
        for interface in &ports.required {
            functions.extend(interface.functions.iter().map(|new| {
                let kept = before.and_then(|(old, slots)| {
                    slots.functions.get(same::function(old, &interface.name, new)?).cloned()
                });
                kept.unwrap_or_else(new_function)
            }));
        }
        let mut events = Vec::new();
        for interface in &ports.provided {
            events.extend(interface.events.iter().map(|new| {
                let kept = before
                    .and_then(|(old, slots)| slots.events.get(same::event(old, interface, new)?).cloned());
                kept.unwrap_or_else(|| new_event(new.payload.as_ref()))
            }));
        }
        // Inputs of the earlier description may still show a sample when it is replaced.
        let known: Vec<_> = inputs.iter().chain(before.iter().flat_map(|(_, slots)| &slots.inputs)).collect();
        for output in &outputs {
            output.cell.know(known.iter().map(|p| p.cell.clone()).collect());
        }
        // The plugin knows only its own events; the system interface's, which come last, are the host's to
        // emit.
        let own_events = events.len() - ports.provided.last().map_or(0, |p| p.events.len());
        // The plugin does not know the taps either; they stand last, too.
        let own_outputs = ports.own_outputs().count();
        Ok(Self::with_ports((outputs, own_outputs), inputs, functions, (events, own_events)))
    }

    fn with_ports(
        (outputs, own_outputs): (Vec<Port<OutCell, OutSlot>>, usize),
        inputs: Vec<Port<InCell, InSlot>>,
        functions: Vec<Port<FnCell, FnSlot>>,
        (events, own_events): (Vec<Port<EventCell, EventSlot>>, usize),
    ) -> Self {
        let pointers = Pointers {
            outputs: outputs[..own_outputs].iter().map(|p| Arc::as_ptr(&p.slot)).collect(),
            inputs: inputs.iter().map(|p| Arc::as_ptr(&p.slot)).collect(),
            functions: functions.iter().map(|p| Arc::as_ptr(&p.slot)).collect(),
            events: events[..own_events].iter().map(|p| Arc::as_ptr(&p.slot)).collect(),
        };
        let table = Box::new(Ports {
            struct_size: size_of_slot::<Ports>(),
            output_count: pointers.outputs.len() as u32,
            input_count: pointers.inputs.len() as u32,
            function_count: pointers.functions.len() as u32,
            event_count: pointers.events.len() as u32,
            reserved: 0,
            outputs: pointers.outputs.as_ptr(),
            inputs: pointers.inputs.as_ptr(),
            functions: pointers.functions.as_ptr(),
            events: pointers.events.as_ptr(),
        });
        Slots { outputs, inputs, functions, events, table, _pointers: pointers }
    }

    /// Gives back the samples and frames at the inputs, whichever cycle of others still looks there.
    /// Component's thread only, as its last use of them: there is no instance any more.
    pub(crate) fn let_go_of_inputs(&self) {
        self.inputs.iter().for_each(|p| p.cell.let_go());
    }

    /// Number of ports.
    pub(super) fn count(&self) -> usize {
        self.outputs.len() + self.inputs.len() + self.functions.len() + self.events.len()
    }

    /// Empties all cells: their component, whose host context is `gone`, is gone.
    pub(super) fn retire(&self, gone: &Arc<HostContext>) {
        self.outputs.iter().for_each(|p| p.cell.retire(gone));
        self.inputs.iter().for_each(|p| p.cell.retire(gone));
        self.functions.iter().for_each(|p| p.cell.retire(gone));
        self.events.iter().for_each(|p| p.cell.retire(gone));
    }

    pub(crate) fn table(&self) -> *const Ports {
        &raw const *self.table
    }

    pub(crate) fn output(&self, i: usize) -> &Arc<OutCell> {
        &self.outputs[i].cell
    }

    pub(crate) fn input(&self, i: usize) -> &Arc<InCell> {
        &self.inputs[i].cell
    }

    pub(crate) fn function(&self, i: usize) -> &Arc<FnCell> {
        &self.functions[i].cell
    }

    pub(crate) fn event(&self, i: usize) -> &Arc<EventCell> {
        &self.events[i].cell
    }

    /// Locks the pools of the outputs into memory, each once; returns those that failed, and why.
    pub(crate) fn lock_pools(&self) -> Vec<(usize, OsError)> {
        let outputs = self.outputs.iter().enumerate();
        outputs.filter_map(|(i, output)| Some((i, output.cell.lock_pool()?))).collect()
    }

    /// Drops the leftovers of earlier swaps, kept for callers that were inside; returns how many still are.
    pub(crate) fn reclaim(&self) -> usize {
        let functions = self.functions.iter().map(|p| p.cell.reclaim());
        let outputs = self.outputs.iter().map(|p| p.cell.reclaim());
        let inputs = self.inputs.iter().map(|p| p.cell.reclaim());
        let events = self.events.iter().map(|p| p.cell.reclaim());
        functions.chain(outputs).chain(inputs).chain(events).sum()
    }
}
