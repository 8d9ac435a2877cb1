//! Inputs and outputs, and how they carry plain samples.
//!
//! Invariant: a port always points to a slot, the unbound stub until `bind`, so that using it needs no check.

use crate::flow::{Flow, PortKind};
use crate::host::Host;
use crate::lease::{Lease, Tie};
use crate::outcome::Outcome;
use crate::payload::Payload;
use crate::stubs;
use crate::values::Stamp;
use core::marker::PhantomData;
use trocar_plugin_api::abi::{IN_SAMPLE, InSlot, OutSlot, SAMPLE_FRESH, SAMPLE_STALE, SampleView};

/// An input: of plain samples (`In<Force>`) or of frames (`In<Frame<ImageHeader>>`).
///
/// Units and coordinate frames are those of the payload's fields; at the port they are refused:
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// struct Tip { #[input] #[frame("retina")] tip: In<f64> }
/// impl Component for Tip { fn step(&mut self, _: &Tick) -> Result { self.tip.latest(); Ok(()) } }
/// ```
pub struct In<T> {
    pub(crate) slot: *const InSlot,
    lease: Option<Lease>,
    kind: PhantomData<fn() -> T>,
}

// SAFETY: the slot may be used from whichever thread enters the instance.
unsafe impl<T> Send for In<T> {}

impl<T> Default for In<T> {
    fn default() -> Self {
        In { slot: stubs::input(), lease: None, kind: PhantomData }
    }
}

/// One plain sample with what the host knows about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// The value, as the output wrote it.
    pub value: T,
    /// When the value was measured or written.
    pub stamp: Stamp,
    /// Counts the writes of the output, from 1; a gap is exactly what was dropped on the way.
    pub seq: u64,
    /// Not seen by this input before.
    pub fresh: bool,
    /// Older than the connection's `max_age`.
    pub stale: bool,
}

impl<T> In<T> {
    pub(crate) fn tie(&mut self, slot: *const InSlot, tie: &Tie) {
        self.slot = slot;
        self.lease = Some(tie.lease.clone());
    }

    /// The newest sample again and again (`next` false), or each once, in order.
    #[inline]
    pub(crate) fn view(&mut self, next: bool) -> Option<SampleView> {
        // SAFETY: attach demands a valid slot, and the stub is static.
        let slot = unsafe { &*self.slot };
        let mut view = SampleView::EMPTY;
        let ask = if next { slot.next } else { slot.latest };
        // SAFETY: the context is the slot's own; the view is writable and says its size.
        let there = unsafe { ask(slot.ctx, &mut view) };
        (there == IN_SAMPLE && !view.header.is_null()).then_some(view)
    }

    /// Hands the held sample back early; the next `latest` or `next` does so anyway.
    pub fn release(&mut self) {
        // SAFETY: as in `view`; views borrow the input mutably, so none is alive.
        unsafe { ((*self.slot).release)((*self.slot).ctx) }
    }
}

impl<T: Payload> In<T> {
    /// Returns the newest sample, whether seen before or not; none while nothing was ever written or nobody
    /// is connected.
    #[inline]
    pub fn latest(&mut self) -> Option<T> {
        self.view(false).map(|v| value(&v))
    }

    /// Returns the newest sample, or `safe` when there is none, nobody is connected, or it is older than the
    /// connection's `max_age`: the value for an actuator to follow, whose health then says STALE_INPUT.
    #[inline]
    pub fn latest_or(&mut self, safe: T) -> T {
        self.view(false).filter(|v| v.flags & SAMPLE_STALE == 0).map_or(safe, |v| value(&v))
    }

    /// The newest sample when it was not seen before.
    #[inline]
    pub fn fresh(&mut self) -> Option<T> {
        self.view(false).filter(|v| v.flags & SAMPLE_FRESH != 0).map(|v| value(&v))
    }

    /// Each sample once, in order (an input with `fifo`); `latest` shows only the newest.
    #[allow(clippy::should_implement_trait)] // An input is no iterator: it may have more later.
    #[inline]
    pub fn next(&mut self) -> Option<T> {
        self.view(true).map(|v| value(&v))
    }

    /// The newest sample with stamp, sequence number, freshness and staleness.
    pub fn sample(&mut self) -> Option<Sample<T>> {
        self.view(false).map(|v| sample(&v))
    }

    /// Like `next`, with stamp, sequence number and staleness.
    pub fn next_sample(&mut self) -> Option<Sample<T>> {
        self.view(true).map(|v| sample(&v))
    }
}

// SAFETY: reads values of `T` from the view's header, which the description names.
unsafe impl<T: Payload> Flow for In<T> {
    type Slot = InSlot;
    const KIND: PortKind = PortKind::Plain(T::DESC);
    unsafe fn attach(&mut self, slot: *const InSlot, tie: &Tie) {
        self.tie(slot, tie);
    }
}

#[inline]
fn value<T: Payload>(view: &SampleView) -> T {
    // SAFETY: `view` is fresh from the slot, which gives a value of the described type until it is asked
    // again.
    unsafe { view.header.cast::<T>().read_unaligned() }
}

fn sample<T: Payload>(view: &SampleView) -> Sample<T> {
    Sample {
        value: value(view),
        stamp: Stamp::from_ns(view.stamp_ns),
        seq: view.seq,
        fresh: view.flags & SAMPLE_FRESH != 0,
        stale: view.flags & SAMPLE_STALE != 0,
    }
}

/// An output: of plain samples (`Out<Force>`) or of frames (`Out<Frame<ImageHeader>>`).
pub struct Out<T> {
    pub(crate) slot: *const OutSlot,
    lease: Option<Lease>,
    pub(crate) host: Option<Host>,
    /// The pool asked for so far: bytes of the largest frame, slots. Repeated at each `bind`.
    pub(crate) pool: Option<(u64, u32)>,
    kind: PhantomData<fn(T)>,
}

// SAFETY: the slot may be used from whichever thread enters the instance.
unsafe impl<T> Send for Out<T> {}

impl<T> Default for Out<T> {
    fn default() -> Self {
        Out { slot: stubs::output(), lease: None, host: None, pool: None, kind: PhantomData }
    }
}

impl<T> Out<T> {
    pub(crate) fn tie(&mut self, slot: *const OutSlot, tie: &Tie) {
        self.slot = slot;
        self.lease = Some(tie.lease.clone());
        self.host = Some(tie.host.clone());
    }

    /// `own`, or the begin of the running step, or now; ns.
    #[inline]
    pub(crate) fn stamp_or(&self, own: u64) -> u64 {
        match (&self.host, own) {
            (Some(host), 0) => host.stamp(),
            _ => own,
        }
    }
}

impl<T: Payload> Out<T> {
    /// Publishes a copy. The sample's stamp is the payload's own `stamp` field when set, else the begin of
    /// this step. Never waits for a reader; a missing connection is no error.
    #[inline]
    pub fn write(&self, value: &T) {
        self.write_at(value, Stamp::from_ns(value.stamp_ns()));
    }

    /// Writes as `write` does, with the stamp given apart, and returns the outcome.
    #[inline]
    pub fn write_at(&self, value: &T, stamp: Stamp) -> Outcome {
        // SAFETY: attach demands a valid slot for `T`, and the stub is static; the value lives through the
        // call.
        unsafe {
            let slot = &*self.slot;
            Outcome::from((slot.write)(slot.ctx, (value as *const T).cast(), self.stamp_or(stamp.ns())))
        }
    }
}

// SAFETY: writes values of `T`, which the description names.
unsafe impl<T: Payload> Flow for Out<T> {
    type Slot = OutSlot;
    const KIND: PortKind = PortKind::Plain(T::DESC);
    unsafe fn attach(&mut self, slot: *const OutSlot, tie: &Tie) {
        self.tie(slot, tie);
    }
}
