//! What a behaviour does with the slots of its own instance, in values of u64, and as a thread of its device.
//!
//! Invariant: payloads are u64, or so many of them as a call says; the tests' classes have such ports, and
//! are bound before they run.

use std::ffi::c_void;
use std::ops::Deref;
use std::ptr::{from_ref, null, null_mut};

use trocar_plugin_api::abi::{
    IN_SAMPLE, KEEP, Keep, Outcome, PARALLEL, Parallel, STATUS_OK, SampleView, SliceBody, Status,
};

use super::super::{as_bytes, texts};
use super::Stage;

/// Bytes of a row of GetState.
const ROW: usize = trocar_loader::system::MAX_BYTES;

/// The instance of a behaviour; stays usable when it is gone.
#[derive(Clone, Copy)]
pub(crate) struct Own(pub(super) &'static Stage);

impl Deref for Own {
    type Target = Stage;

    fn deref(&self) -> &Stage {
        self.0
    }
}

impl Own {
    /// Writes a plain value to an output.
    pub(crate) fn write(&self, output: usize, value: &u64) -> Outcome {
        self.write_words(output, &[*value])
    }

    /// Writes a plain value of so many words to an output.
    pub(crate) fn write_words<const N: usize>(&self, output: usize, value: &[u64; N]) -> Outcome {
        self.0.write(output, as_bytes(value))
    }

    /// The next sample of an input of u64, or of frames with such a header: its value and its number.
    pub(crate) fn take(&self, input: usize) -> Option<(u64, u64)> {
        self.take_words(input).map(|([value], seq)| (value, seq))
    }

    /// The next sample of an input of so many words, and its number. It is held until the next one is taken.
    pub(crate) fn take_words<const N: usize>(&self, input: usize) -> Option<([u64; N], u64)> {
        let (slot, mut view) = (self.input(input), SampleView::EMPTY);
        // SAFETY: a slot of this instance, and a value or header of that size.
        unsafe {
            let some = (slot.next)(slot.ctx, &raw mut view) == IN_SAMPLE;
            some.then(|| (view.header.cast::<[u64; N]>().read(), view.seq))
        }
    }

    /// Makes a frame with this number; EXHAUSTED where its pool has no slot.
    pub(crate) fn give(&self, output: usize, number: u64) -> Outcome {
        self.frame(output, number, &[])
    }

    /// Passes the next frame of an input on and lets go of it; returns its number.
    pub(crate) fn pass(&self, input: usize, output: usize) -> Option<u64> {
        let (from, to, mut view) = (self.input(input), self.output(output), SampleView::EMPTY);
        // SAFETY: slots of this instance, of frames with a header of u64.
        unsafe {
            if (from.next)(from.ctx, &raw mut view) != IN_SAMPLE {
                return None;
            }
            let number = view.header.cast::<u64>().read();
            (to.forward)(to.ctx, &raw const view, view.stamp_ns);
            (from.release)(from.ctx);
            Some(number)
        }
    }

    /// Says, as the SDK does, that handles of the component are left.
    pub(crate) fn keep(&self) {
        // SAFETY: the host's table lives as long as the instance, and answers with the extension of that
        // name.
        unsafe {
            let found = (self.host().extension)(self.host().ctx, texts::bytes(KEEP.as_bytes()));
            ((*found.cast::<Keep>()).keep)(self.host().ctx);
        }
    }

    pub(crate) fn has_output(&self) -> bool {
        self.counts()[0] > 0
    }

    /// Runs eight slices that do nothing on the threads of its stream; returns the number of threads.
    pub(crate) fn slices(&self) -> u32 {
        unsafe extern "C" fn nothing(_: *mut c_void, _: u32) -> Status {
            STATUS_OK
        }
        let body = SliceBody { data: null_mut(), run: nothing };
        // SAFETY: the host's own table and extension; the body lives through the call.
        unsafe {
            let found = (self.host().extension)(self.host().ctx, texts::bytes(PARALLEL.as_bytes()));
            let parallel = &*found.cast::<Parallel>();
            let status = (parallel.run)(parallel.ctx, 8, from_ref(&body));
            if status == STATUS_OK { (parallel.threads)(parallel.ctx) } else { 0 }
        }
    }

    /// Calls a function without argument and result; does not wait.
    pub(crate) fn send(&self, function: usize) -> Outcome {
        let slot = self.function(function);
        // SAFETY: a slot of this instance.
        unsafe { (slot.call)(slot.ctx, null(), null_mut(), null_mut()) }
    }

    /// Calls a function that is bound to GetState; the row as bytes.
    pub(crate) fn ask(&self, function: usize) -> (Outcome, [u8; ROW]) {
        let (slot, mut row) = (self.function(function), [0u64; ROW / 8]);
        // SAFETY: a slot of this instance; the row has the size of its result.
        let outcome = unsafe { (slot.call)(slot.ctx, null(), row.as_mut_ptr().cast(), null_mut()) };
        let mut bytes = [0; ROW];
        bytes.copy_from_slice(as_bytes(&row));
        (outcome, bytes)
    }

    /// Calls a function that is bound to a qualified read.
    pub(crate) fn read(&self, function: usize, arg: u64) -> (Outcome, u64) {
        let (slot, mut ret) = (self.function(function), 0u64);
        let (arg, to) = ((&raw const arg).cast(), (&raw mut ret).cast());
        // SAFETY: a slot of this instance, from u64 to u64.
        let outcome = unsafe { (slot.call)(slot.ctx, arg, to, null_mut()) };
        (outcome, ret)
    }

    /// Asks for a dynamic component service.
    pub(crate) fn service(&self, token: u64, request: &str) -> Outcome {
        // SAFETY: the table lives as long as the instance, the text through the call.
        unsafe { (self.host().service)(self.host().ctx, token, texts::bytes(request.as_bytes())) }
    }

    /// Begins a callback, on a thread of the device.
    pub(crate) fn enter(&self) -> Outcome {
        // SAFETY: any thread may call it.
        unsafe { (self.host().callback_enter)(self.host().ctx) }
    }

    /// Ends it.
    pub(crate) fn leave(&self) {
        // SAFETY: after `enter`, on the same thread.
        unsafe { (self.host().callback_leave)(self.host().ctx) }
    }
}
