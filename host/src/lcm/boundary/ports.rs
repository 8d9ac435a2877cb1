//! The slot tables of one instance: cells, the immutable slot structs that point to them, and the arrays of pointers the
//! plugin gets at `bind`.
//!
//! Invariant: cells and slots are boxed and never move while the instance lives; positions are the manifest's.

use trocar_model::{PortType, Ports as Described, Type};
use trocar_plugin_api::abi::{EventSlot, FnSlot, InSlot, OutSlot, Ports};
use trocar_rt::cell::BindingCell;

use super::call::{self, FnBinding, FnCell};
use super::event::{self, EventCell};
use super::stream::{self, InCell, OutCell};

/// Frames in the pool of an output whose manifest names a size but no count.
const DEFAULT_POOL: usize = 8;

/// Plugins and slots point to cells and slots by address, so each has a box of its own.
#[expect(clippy::vec_box, reason = "the addresses are handed out")]
pub(in crate::lcm) struct Slots {
    outputs: Vec<Box<OutCell>>,
    inputs: Vec<Box<InCell>>,
    functions: Vec<Box<FnCell>>,
    /// The class's own events, then those of the system interface.
    events: Vec<Box<EventCell>>,
    table: Box<Ports>,
    _slots: Boxes,
    _pointers: Pointers,
}

#[expect(clippy::vec_box, reason = "the addresses are handed out")]
struct Boxes {
    _outputs: Vec<Box<OutSlot>>,
    _inputs: Vec<Box<InSlot>>,
    _functions: Vec<Box<FnSlot>>,
    _events: Vec<Box<EventSlot>>,
}

struct Pointers {
    _outputs: Vec<*const OutSlot>,
    _inputs: Vec<*const InSlot>,
    _functions: Vec<*const FnSlot>,
    _events: Vec<*const EventSlot>,
}

// SAFETY: the raw pointers point into the boxes of the same struct, which are Sync (cells) or immutable (slots).
unsafe impl Send for Slots {}
// SAFETY: as above.
unsafe impl Sync for Slots {}

fn size_of_slot<T>() -> u32 {
    size_of::<T>() as u32
}

fn pointer<T>(cell: &T) -> *mut std::ffi::c_void {
    std::ptr::from_ref(cell).cast_mut().cast()
}

impl Slots {
    pub(in crate::lcm) fn new(ports: &Described) -> Self {
        let outputs: Vec<_> = ports
            .outputs
            .iter()
            .map(|o| {
                let (bytes, frame, max) = match &o.ty {
                    PortType::Plain(t) => (t.size(), false, 0),
                    PortType::Frame { header, max_bytes, .. } => (header.size(), true, *max_bytes),
                    PortType::Any => (0, false, 0),
                };
                let cell = Box::new(OutCell::new(bytes, frame));
                if max > 0 {
                    cell.reserve(max, DEFAULT_POOL);
                }
                cell
            })
            .collect();
        let inputs: Vec<_> = ports.inputs.iter().map(|_| Box::new(InCell::new())).collect();
        let functions: Vec<_> = ports
            .required
            .iter()
            .flat_map(|r| &r.functions)
            .map(|_| Box::new(FnCell { binding: BindingCell::new(Box::new(FnBinding::Unbound)) }))
            .collect();
        let events: Vec<_> = ports
            .provided
            .iter()
            .flat_map(|p| &p.events)
            .map(|e| {
                Box::new(EventCell {
                    sinks: BindingCell::new(Box::new(Vec::new())),
                    bytes: e.payload.as_ref().map_or(0, Type::size),
                })
            })
            .collect();
        Self::with_cells(ports, outputs, inputs, functions, events)
    }

    #[expect(clippy::vec_box, reason = "the addresses are handed out")]
    fn with_cells(
        ports: &Described,
        outputs: Vec<Box<OutCell>>,
        inputs: Vec<Box<InCell>>,
        functions: Vec<Box<FnCell>>,
        events: Vec<Box<EventCell>>,
    ) -> Self {
        let out_slots: Vec<_> = outputs
            .iter()
            .map(|cell| {
                Box::new(OutSlot {
                    struct_size: size_of_slot::<OutSlot>(),
                    flags: 0,
                    ctx: pointer(&**cell),
                    write: stream::write,
                    loan: stream::loan,
                    commit: stream::commit,
                    cancel: stream::cancel,
                    forward: stream::forward,
                    reserve: stream::reserve,
                    type_of: stream::type_of,
                })
            })
            .collect();
        let in_slots: Vec<_> = inputs
            .iter()
            .map(|cell| {
                Box::new(InSlot {
                    struct_size: size_of_slot::<InSlot>(),
                    flags: 0,
                    ctx: pointer(&**cell),
                    latest: stream::latest,
                    next: stream::next,
                    release: stream::release,
                    writable: stream::writable,
                    type_of: stream::type_of,
                })
            })
            .collect();
        let fn_slots: Vec<_> = functions
            .iter()
            .map(|cell| {
                Box::new(FnSlot {
                    struct_size: size_of_slot::<FnSlot>(),
                    flags: 0,
                    ctx: pointer(&**cell),
                    call: call::call,
                    type_of: call::type_of,
                })
            })
            .collect();
        // The plugin knows only its own events; the system interface's, which come last, are the host's to emit.
        let own_events = events.len() - ports.provided.last().map_or(0, |p| p.events.len());
        let event_slots: Vec<_> = events[..own_events]
            .iter()
            .map(|cell| {
                Box::new(EventSlot {
                    struct_size: size_of_slot::<EventSlot>(),
                    flags: 0,
                    ctx: pointer(&**cell),
                    emit: event::emit,
                })
            })
            .collect();
        let out_ptrs: Vec<*const OutSlot> = out_slots.iter().map(|s| std::ptr::from_ref(&**s)).collect();
        let in_ptrs: Vec<*const InSlot> = in_slots.iter().map(|s| std::ptr::from_ref(&**s)).collect();
        let fn_ptrs: Vec<*const FnSlot> = fn_slots.iter().map(|s| std::ptr::from_ref(&**s)).collect();
        let event_ptrs: Vec<*const EventSlot> =
            event_slots.iter().map(|s| std::ptr::from_ref(&**s)).collect();
        let table = Box::new(Ports {
            struct_size: size_of_slot::<Ports>(),
            output_count: out_ptrs.len() as u32,
            input_count: in_ptrs.len() as u32,
            function_count: fn_ptrs.len() as u32,
            event_count: event_ptrs.len() as u32,
            reserved: 0,
            outputs: out_ptrs.as_ptr(),
            inputs: in_ptrs.as_ptr(),
            functions: fn_ptrs.as_ptr(),
            events: event_ptrs.as_ptr(),
        });
        Slots {
            outputs,
            inputs,
            functions,
            events,
            table,
            _slots: Boxes {
                _outputs: out_slots,
                _inputs: in_slots,
                _functions: fn_slots,
                _events: event_slots,
            },
            _pointers: Pointers {
                _outputs: out_ptrs,
                _inputs: in_ptrs,
                _functions: fn_ptrs,
                _events: event_ptrs,
            },
        }
    }

    pub(in crate::lcm) fn table(&self) -> *const Ports {
        &raw const *self.table
    }

    pub(in crate::lcm) fn output(&self, i: usize) -> &OutCell {
        &self.outputs[i]
    }

    pub(in crate::lcm) fn input(&self, i: usize) -> &InCell {
        &self.inputs[i]
    }

    pub(in crate::lcm) fn event(&self, i: usize) -> &EventCell {
        &self.events[i]
    }

    /// Swaps what stands behind function `i`; managers only.
    pub(in crate::lcm) fn bind_function(&self, i: usize, binding: FnBinding) {
        self.functions[i].binding.swap(Box::new(binding));
    }

    /// Drops what earlier swaps left for callers that were inside; returns how many still are.
    pub(in crate::lcm) fn reclaim(&self) -> usize {
        let mut left = 0;
        for cell in &self.functions {
            left += cell.binding.reclaim();
        }
        for cell in &self.outputs {
            left += cell.links.reclaim();
        }
        for cell in &self.inputs {
            left += cell.link.reclaim();
        }
        for cell in &self.events {
            left += cell.sinks.reclaim();
        }
        left
    }
}
