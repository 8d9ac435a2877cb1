//! Inputs and outputs of frames: a plain header and bytes in the host's pooled memory, never copied on the
//! way.
//!
//! Invariant: a view borrows its input and a loan its output, so neither outlives the next request to the
//! host.

use crate::flow::{Flow, PortKind};
use crate::lease::Tie;
use crate::outcome::{NoFrame, Outcome};
use crate::payload::Payload;
use crate::ports::{In, Out};
use crate::values::Stamp;
use core::marker::PhantomData;
use trocar_plugin_api::abi::{InSlot, Loan, OutSlot, SAMPLE_FRESH, SAMPLE_STALE, SampleView};

/// Marks a port of frames with header `H`: `In<Frame<ImageHeader>>`.
pub struct Frame<H>(PhantomData<H>);

/// A received frame.
pub struct FrameView<'a, H> {
    view: SampleView,
    slot: &'a InSlot,
    header: PhantomData<&'a H>,
}

impl<H: Payload> FrameView<'_, H> {
    /// The header, in place.
    pub fn header(&self) -> &H {
        // SAFETY: `In::frame` checked null and alignment; the slot gives a value of `H` while the view
        // borrows the input.
        unsafe { &*self.view.header.cast::<H>() }
    }

    /// The bytes of the frame, in place.
    pub fn bytes(&self) -> &[u8] {
        if self.view.bytes.is_null() {
            return &[];
        }
        // SAFETY: the slot gives `len` readable bytes that nobody writes while the view borrows the input.
        unsafe { core::slice::from_raw_parts(self.view.bytes, self.view.len as usize) }
    }

    /// Returns the same bytes for changing in place, when this input is the frame's only owner; else none,
    /// and a loan with a copy is the way.
    pub fn bytes_mut(&mut self) -> Option<&mut [u8]> {
        // SAFETY: the view is the one the slot filled.
        let ptr = unsafe { (self.slot.writable)(self.slot.ctx, &mut self.view) };
        if ptr.is_null() {
            return None;
        }
        // SAFETY: a non-null answer means `len` bytes that only this input holds; `&mut self` excludes other
        // views.
        Some(unsafe { core::slice::from_raw_parts_mut(ptr, self.view.len as usize) })
    }

    /// When the frame was taken or made.
    pub fn stamp(&self) -> Stamp {
        Stamp::from_ns(self.view.stamp_ns)
    }

    /// Counts the writes of the output, from 1; a gap is exactly what was dropped on the way.
    pub fn seq(&self) -> u64 {
        self.view.seq
    }

    /// Not seen by this input before.
    pub fn is_fresh(&self) -> bool {
        self.view.flags & SAMPLE_FRESH != 0
    }

    /// Older than the connection's `max_age`.
    pub fn is_stale(&self) -> bool {
        self.view.flags & SAMPLE_STALE != 0
    }
}

impl<H: Payload> In<Frame<H>> {
    /// The newest frame, whether seen before or not.
    pub fn latest(&mut self) -> Option<FrameView<'_, H>> {
        self.frame(false)
    }

    /// The newest frame when it was not seen before.
    pub fn fresh(&mut self) -> Option<FrameView<'_, H>> {
        self.frame(false).filter(FrameView::is_fresh)
    }

    /// Each frame once, in order (an input with `fifo`, or a filter of a stream).
    #[allow(clippy::should_implement_trait)] // An input is no iterator: it may have more later.
    pub fn next(&mut self) -> Option<FrameView<'_, H>> {
        self.frame(true)
    }

    fn frame(&mut self, next: bool) -> Option<FrameView<'_, H>> {
        let view = self.view(next)?;
        let aligned = view.header.cast::<H>().is_aligned();
        // SAFETY: attach demands a valid slot, and the stub is static.
        aligned.then(|| FrameView { view, slot: unsafe { &*self.slot }, header: PhantomData })
    }
}

// SAFETY: reads headers of `H`, which the description names.
unsafe impl<H: Payload> Flow for In<Frame<H>> {
    type Slot = InSlot;
    const KIND: PortKind = PortKind::Frame { header: H::DESC, format: H::FORMAT };
    unsafe fn attach(&mut self, slot: *const InSlot, tie: &Tie) {
        self.tie(slot, tie);
    }
}

/// A frame to be filled. Dropped without `commit`, it goes back unpublished.
pub struct FrameLoan<'a, H> {
    loan: Loan,
    out: &'a Out<Frame<H>>,
}

impl<H: Payload> FrameLoan<'_, H> {
    /// The header as it is filled so far: at first zeros, or that of an older frame.
    pub fn header(&self) -> &H {
        // SAFETY: `loan` checked null and alignment; the memory is lent until commit or cancel.
        unsafe { &*self.loan.header.cast::<H>() }
    }

    /// The header to be filled.
    pub fn header_mut(&mut self) -> &mut H {
        // SAFETY: as in `header`; `&mut self` makes it the only reference.
        unsafe { &mut *self.loan.header.cast::<H>() }
    }

    /// All bytes of the loan, up to the reserved size; they may hold an older frame.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        if self.loan.bytes.is_null() {
            return &mut [];
        }
        // SAFETY: the host lends `capacity` initialised bytes until commit or cancel, to this loan alone.
        unsafe { core::slice::from_raw_parts_mut(self.loan.bytes, self.loan.capacity as usize) }
    }

    /// Publishes the first `len` bytes; an invalid stamp becomes the header's own, else the begin of this
    /// step.
    pub fn commit(mut self, len: usize, stamp: Stamp) -> Outcome {
        let own = if stamp.is_valid() { stamp.ns() } else { self.header().stamp_ns() };
        let stamp = self.out.stamp_or(own);
        let len = (len as u64).min(self.loan.capacity);
        let slot = self.out.slot;
        // SAFETY: the slot is valid while the output is borrowed; the loan is its own.
        let outcome = unsafe { ((*slot).commit)((*slot).ctx, &mut self.loan, len, stamp) };
        self.loan.header = core::ptr::null_mut();
        Outcome::from(outcome)
    }
}

impl<H> Drop for FrameLoan<'_, H> {
    fn drop(&mut self) {
        if !self.loan.header.is_null() {
            // SAFETY: not committed (that clears the header), so the loan is still ours to give back.
            unsafe { ((*self.out.slot).cancel)((*self.out.slot).ctx, &mut self.loan) }
        }
    }
}

impl<H: Payload> Out<Frame<H>> {
    /// Room for one frame. With `?` in `step`, a cycle without a free frame ends quietly (see [`NoFrame`]).
    ///
    /// # Errors
    /// `Unbound` when the output was never bound, `Exhausted` when all slots of the pool are in use
    /// (counted).
    pub fn loan(&mut self) -> Result<FrameLoan<'_, H>, NoFrame> {
        let mut loan = Loan::EMPTY;
        // SAFETY: attach demands a valid slot, and the stub is static; the loan is writable and says its
        // size.
        let outcome = Outcome::from(unsafe { ((*self.slot).loan)((*self.slot).ctx, &mut loan) });
        if !outcome.is_ok() || loan.header.is_null() {
            return Err(NoFrame(if outcome.is_ok() { Outcome::Exhausted } else { outcome }));
        }
        let loan = FrameLoan { loan, out: self };
        if loan.loan.header.cast::<H>().is_aligned() { Ok(loan) } else { Err(NoFrame(Outcome::Exhausted)) }
    }

    /// Makes the pool: `slots` frames of up to `max_bytes`. In `configure` or `start`.
    ///
    /// A queue of frames never takes the last ones of their pool: a fifo of depth `d` is used to its full
    /// depth from a pool of about `1.5 d + 1` frames where the oldest give way, of `2 d + 1` where the newest
    /// are refused.
    ///
    /// # Errors
    /// When the host has not the memory for it.
    pub fn reserve(&mut self, max_bytes: usize, slots: u32) -> crate::Result {
        self.pool = Some((max_bytes as u64, slots));
        match self.ask_pool() {
            // Before `bind` the request is remembered.
            Outcome::Unbound => Ok(()),
            outcome if outcome.is_ok() => Ok(()),
            outcome => Err(format!("no pool of {slots} frames of {max_bytes} bytes: {outcome}").into()),
        }
    }

    /// Publishes a received frame as this output, without a copy; its stamp is kept.
    pub fn forward(&mut self, frame: &FrameView<'_, H>) -> Outcome {
        // SAFETY: the view is held by its input through this call.
        let outcome = unsafe { ((*self.slot).forward)((*self.slot).ctx, &frame.view, frame.view.stamp_ns) };
        Outcome::from(outcome)
    }

    fn ask_pool(&self) -> Outcome {
        let Some((max_bytes, slots)) = self.pool else { return Outcome::Executed };
        // SAFETY: attach demands a valid slot, and the stub is static.
        Outcome::from(unsafe { ((*self.slot).reserve)((*self.slot).ctx, max_bytes, slots) })
    }
}

// SAFETY: writes headers of `H`, which the description names.
unsafe impl<H: Payload> Flow for Out<Frame<H>> {
    type Slot = OutSlot;
    const KIND: PortKind = PortKind::Frame { header: H::DESC, format: H::FORMAT };
    unsafe fn attach(&mut self, slot: *const OutSlot, tie: &Tie) {
        self.tie(slot, tie);
        let outcome = self.ask_pool();
        if !outcome.is_ok() && outcome != Outcome::Unbound {
            log::warn!("the pool asked for before the output was bound cannot be made: {outcome}");
        }
    }
}
