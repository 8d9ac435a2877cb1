//! Inputs and outputs: pushed values, written values, and the faults of a connection.
//!
//! Invariant: a sequence number is used up by every sample that was written, whether or not it arrives.

use super::bench::Bench;
use super::carried::Carried;
use super::history::Kind;
use super::shape;
use crate::class::Class;
use crate::payload::{Payload, as_bytes, from_bytes};
use crate::values::Stamp;
use trocar_plugin_api::manifest::PortType;

impl<C: Class> Bench<C> {
    /// Writes a plain sample to an input, stamped now unless it has its own stamp.
    #[track_caller]
    pub fn push<T: Payload>(&mut self, input: &str, value: T) {
        self.push_bytes::<T>(input, &value, &[], false);
    }

    /// Like `push`, with a stamp of its own: of the past, of the future, or invalid.
    #[track_caller]
    pub fn push_at<T: Payload>(&mut self, input: &str, value: T, stamp: Stamp) {
        self.push::<T>(input, value);
        self.inputs[self.shape.input(input)].get().stamp_last(stamp.ns());
    }

    /// Writes a frame to an input.
    #[track_caller]
    pub fn push_frame<H: Payload>(&mut self, input: &str, header: H, bytes: &[u8]) {
        self.push_bytes::<H>(input, &header, bytes, true);
    }

    #[track_caller]
    fn push_bytes<T: Payload>(&mut self, input: &str, header: &T, bytes: &[u8], frame: bool) {
        let at = self.shape.input(input);
        let ty = &self.shape.class().inputs[at].ty;
        let fits = match ty {
            PortType::Plain { .. } => !frame,
            PortType::Frame { .. } => frame,
            PortType::Any(_) => true,
        };
        assert!(fits, "input `{input}`: plain samples go in with `push`, frames with `push_frame`");
        match shape::header(ty) {
            Some(have) => self.shape.expect_type("input", input, Some(have), Some(T::DESC)),
            None if frame => self.inputs[at].get().carry(Carried::frames::<T>()),
            None => self.inputs[at].get().carry(Carried::plain::<T>()),
        }
        let own = header.stamp_ns();
        let stamp = if own != 0 { own } else { self.now().ns() };
        self.history.value(self.now().ns(), Kind::Input, at, as_bytes(header));
        self.inputs[at].get().push(as_bytes(header), bytes, stamp);
    }

    /// Loses `samples` on the way to an input: the next one pushed comes after a gap in the sequence.
    #[track_caller]
    pub fn lose(&mut self, input: &str, samples: u64) {
        self.inputs[self.shape.input(input)].get().pushed += samples;
    }

    /// Makes an input's newest sample older than its connection's `max_age`, until the next push.
    #[track_caller]
    pub fn make_stale(&mut self, input: &str) {
        self.inputs[self.shape.input(input)].get().stale = true;
    }

    /// Lets another reader have the frames of an input, too, or no longer: then none may be changed in place.
    #[track_caller]
    pub fn share(&mut self, input: &str, shared: bool) {
        self.inputs[self.shape.input(input)].get().shared = shared;
    }

    /// Cuts or restores the connection of an input.
    #[track_caller]
    pub fn connect_input(&mut self, input: &str, connected: bool) {
        self.inputs[self.shape.input(input)].get().connected = connected;
    }

    /// Cuts or restores the connections of an output.
    #[track_caller]
    pub fn connect_output(&mut self, output: &str, connected: bool) {
        self.outputs[self.shape.output(output)].get().connected = connected;
    }

    /// Lets an output have no free frame (or has it again).
    #[track_caller]
    pub fn exhaust(&mut self, output: &str, exhausted: bool) {
        self.outputs[self.shape.output(output)].get().exhausted = exhausted;
    }

    /// Everything an output wrote since the last asking.
    #[track_caller]
    pub fn outputs<T: Payload>(&mut self, output: &str) -> Vec<T> {
        self.samples(output).into_iter().map(|(value, _)| value).collect()
    }

    /// Like `outputs`, with stamps.
    #[track_caller]
    pub fn samples<T: Payload>(&mut self, output: &str) -> Vec<(T, Stamp)> {
        self.frames::<T>(output).into_iter().map(|(value, _, stamp)| (value, stamp)).collect()
    }

    /// Everything an output committed since the last asking: header, bytes, stamp.
    #[track_caller]
    pub fn frames<H: Payload>(&mut self, output: &str) -> Vec<(H, Vec<u8>, Stamp)> {
        let at = self.shape.output(output);
        let ty = shape::header(&self.shape.class().outputs[at].ty);
        if ty.is_some() {
            self.shape.expect_type("output", output, ty, Some(H::DESC));
        }
        let cell = self.outputs[at].get();
        if let (None, Some(carried)) = (ty, cell.carried()) {
            carried.expect(output, H::DESC);
        }
        cell.told = 0;
        let written = std::mem::take(&mut cell.written);
        let typed = written.into_iter().map(|w| {
            let header = from_bytes(&w.header).unwrap_or_else(H::zeroed);
            (header, w.bytes, Stamp::from_ns(w.stamp_ns))
        });
        typed.collect()
    }
}
