//! Ports of the component on the bench: asked for, tied to cells, and tied anew when they change.
//!
//! Invariant: a port that keeps name and type keeps its cell, and with it the queued values.

use super::super::input_cells::InCell;
use super::super::member_cells::{EventCell, FnCell};
use super::super::output_cells::OutCell;
use super::super::shape::{self, Member, Of, Shape};
use super::super::wired::Wired;
use super::{Bench, collect};
use crate::class::Class;
use core::fmt;
use std::sync::atomic::Ordering;
use trocar_plugin_api::abi::{self, EventSlot, FnSlot, InSlot, OutSlot, Ports, Sink};
use trocar_plugin_api::manifest::PortType;

impl<C: Class> Bench<C> {
    /// Asks a class with changing ports for its present ones.
    #[track_caller]
    pub(super) fn describe(&mut self) {
        let Some(describe) = self.table.describe else { return };
        let mut json: Vec<u8> = Vec::new();
        let sink = Sink { ctx: (&raw mut json).cast(), write: collect };
        // SAFETY: a live instance; the sink lives through the call.
        let status = unsafe { describe(self.this, &sink) };
        assert!(status == abi::STATUS_OK, "describe failed with status {status}");
        self.shape = Shape::read(&json).unwrap_or_else(|why| panic!("{why}"));
    }

    /// Ties every port; a port that keeps its name keeps its cell, and with it the queued values.
    #[track_caller]
    pub(super) fn bind(&mut self) {
        fn slots<Cell, Slot>(wired: &[Wired<Cell, Slot>]) -> Vec<*const Slot> {
            wired.iter().map(Wired::slot).collect()
        }
        let _left_over = self.wire();
        let (inputs, outputs) = (slots(&self.inputs), slots(&self.outputs));
        let (functions, events) = (slots(&self.functions), slots(&self.events));
        let ports = Ports {
            struct_size: size_of::<Ports>() as u32,
            output_count: outputs.len() as u32,
            input_count: inputs.len() as u32,
            function_count: functions.len() as u32,
            event_count: events.len() as u32,
            reserved: 0,
            outputs: outputs.as_ptr(),
            inputs: inputs.as_ptr(),
            functions: functions.as_ptr(),
            events: events.as_ptr(),
        };
        if let Some(bind) = self.table.bind {
            // SAFETY: the slots live until the next bind; the SDK copies the pointers during the call.
            if let Err(e) = self.entry(|this, err| unsafe { bind(this, &ports, err) }) {
                panic!("bind failed: {e}");
            }
        }
    }

    #[allow(clippy::type_complexity)] // Only held until the component is bound.
    fn wire(
        &mut self,
    ) -> (
        Vec<Wired<InCell, InSlot>>,
        Vec<Wired<OutCell, OutSlot>>,
        Vec<Wired<FnCell, FnSlot>>,
        Vec<Wired<EventCell, EventSlot>>,
    ) {
        let class = self.shape.class();
        let max_bytes =
            |ty: &PortType| if let PortType::Frame { max_bytes, .. } = ty { *max_bytes } else { 0 };
        let inputs = class.inputs.iter().map(|i| (key(&i.name, &i.ty), InCell::new(i.fifo)));
        let outputs = class.outputs.iter().map(|o| {
            let size = self.shape.size(shape::header(&o.ty));
            (key(&o.name, &o.ty), OutCell::new(size, max_bytes(&o.ty), matches!(o.ty, PortType::Any(_))))
        });
        let sizes = |m: &Member| (self.shape.size(m.arg.as_ref()), self.shape.size(m.ret.as_ref()));
        let functions = self.shape.members(Of::Functions).iter().map(|m| {
            let (arg, ret) = sizes(m);
            (key(&m.path, &(&m.arg, &m.ret)), FnCell::new(arg, ret, m.any))
        });
        let events = self.shape.members(Of::Events).iter().map(|m| {
            let size = self.shape.size(m.arg.as_ref());
            (key(&m.path, &m.arg), EventCell::new(size))
        });
        (
            Wired::rewire(&mut self.inputs, inputs, InCell::slot),
            Wired::rewire(&mut self.outputs, outputs, OutCell::slot),
            Wired::rewire(&mut self.functions, functions, FnCell::slot),
            Wired::rewire(&mut self.events, events, EventCell::slot),
        )
    }

    /// After an entry: a component that asked for other ports gets them between two steps, as from a host.
    pub(super) fn change_ports(&mut self) {
        if self.host.ports_changed.swap(false, Ordering::Relaxed) {
            self.describe();
            self.bind();
        }
    }
}

/// Returns the identity of a port: its name and type.
fn key(name: &str, ty: &impl fmt::Debug) -> String {
    format!("{name} {ty:?}")
}
