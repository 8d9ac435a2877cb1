//! One instance of a puppet, and what it does with the slots and the table the host gave it.
//!
//! Invariant: a stage is never freed, as code in C may keep in a static what it was given.

use std::collections::HashMap;
use std::ffi::c_void;
use std::ptr::{from_ref, null_mut};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::Value;
use trocar_plugin_api::abi::*;

use super::{Behaviour, lent};

/// The newest stage of each name.
static STAGES: Mutex<Option<HashMap<String, &'static Stage>>> = Mutex::new(None);

/// One instance: the host's tables for it, and a state of one u64.
pub(crate) struct Stage {
    pub(super) behaviour: Arc<dyn Behaviour>,
    host: *const HostTable,
    pub(super) ports: AtomicPtr<Ports>,
    pub(super) destroyed: AtomicBool,
    pub(crate) state: AtomicU64,
    /// Values that its entries noted.
    seen: Mutex<Vec<u64>>,
}

// SAFETY: the host's table and the tables of ports may be used from any thread, also after the instance is
// gone; which table of ports is the present one is an atomic.
unsafe impl Sync for Stage {}

/// Result of a call.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Called {
    pub(crate) outcome: Outcome,
    pub(crate) ret: u64,
    pub(crate) text: String,
    pub(crate) may_still_run: bool,
}

/// A sample as an input showed it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shown {
    pub(crate) header: Vec<u8>,
    pub(crate) bytes: Vec<u8>,
    pub(crate) address: usize,
    pub(crate) seq: u64,
    pub(crate) writable: bool,
}

unsafe extern "C" fn collect(ctx: *mut c_void, bytes: Bytes) {
    // SAFETY: the String of `described`.
    let text = unsafe { &mut *ctx.cast::<String>() };
    // SAFETY: lent for the call.
    text.push_str(unsafe { lent(bytes) });
}

impl Stage {
    pub(super) fn made(name: &str, behaviour: Arc<dyn Behaviour>, host: *const HostTable) -> &'static Stage {
        let stage: &Stage = Box::leak(Box::new(Stage {
            behaviour,
            host,
            ports: AtomicPtr::new(null_mut()),
            destroyed: AtomicBool::new(false),
            state: AtomicU64::new(0),
            seen: Mutex::default(),
        }));
        STAGES.lock().get_or_insert_default().insert(name.to_owned(), stage);
        stage
    }

    /// The newest instance of this name.
    pub(crate) fn of(name: &str) -> &'static Stage {
        STAGES.lock().as_ref().unwrap()[name]
    }

    fn ports(&self) -> &Ports {
        // SAFETY: the table that `bind` gave, valid until the next `bind`.
        unsafe { &*self.ports.load(Ordering::Acquire) }
    }

    pub(crate) fn host(&self) -> &HostTable {
        // SAFETY: the host keeps its table for handles that outlive the instance (`boundary/remains.rs`).
        unsafe { &*self.host }
    }

    pub(crate) fn function(&self, function: usize) -> &FnSlot {
        // SAFETY: a slot of this instance, valid until the next `bind`; so are those below.
        unsafe { &**self.ports().functions.add(function) }
    }

    pub(crate) fn output(&self, output: usize) -> &OutSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().outputs.add(output) }
    }

    pub(crate) fn input(&self, input: usize) -> &InSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().inputs.add(input) }
    }

    pub(crate) fn event(&self, event: usize) -> &EventSlot {
        // SAFETY: as for functions.
        unsafe { &**self.ports().events.add(event) }
    }

    pub(crate) fn counts(&self) -> [u32; 4] {
        let p = self.ports();
        [p.output_count, p.input_count, p.function_count, p.event_count]
    }

    pub(crate) fn call(&self, function: usize, arg: u64, mode: u32, deadline: Duration) -> Called {
        let mut room = [0u8; 128];
        let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
        let mut opts = CallOpts {
            struct_size: size_of::<CallOpts>() as u32,
            mode,
            deadline_ns: deadline.as_nanos() as u64,
            err: &raw mut err,
            stamp_ns: 0,
            may_still_run: 0,
            reserved: 0,
        };
        let (slot, mut ret) = (self.function(function), 0u64);
        // SAFETY: a slot of this instance; argument and result are u64 as the test's descriptions say.
        let outcome =
            unsafe { (slot.call)(slot.ctx, (&raw const arg).cast(), (&raw mut ret).cast(), &raw mut opts) };
        let text = String::from_utf8_lossy(&room[..err.len]).into_owned();
        Called { outcome, ret, text, may_still_run: opts.may_still_run != 0 }
    }

    pub(crate) fn send(&self, function: usize, arg: u64) -> Outcome {
        self.call(function, arg, MODE_SEND, Duration::ZERO).outcome
    }

    pub(crate) fn ask(&self, function: usize, arg: u64) -> Called {
        self.call(function, arg, MODE_CALL, Duration::from_secs(30))
    }

    pub(crate) fn emit(&self, event: usize, payload: u64) -> Outcome {
        let slot = self.event(event);
        // SAFETY: a slot of this instance; events of the tests carry one u64.
        unsafe { (slot.emit)(slot.ctx, (&raw const payload).cast()) }
    }

    /// `value` must have the output's size.
    pub(crate) fn write(&self, output: usize, value: &[u8]) -> Outcome {
        let slot = self.output(output);
        // SAFETY: a slot of this instance, a value of its size.
        unsafe { (slot.write)(slot.ctx, value.as_ptr().cast(), 0) }
    }

    /// Loans, fills and commits a frame with a header of one u64; EXHAUSTED where its pool has no slot.
    pub(crate) fn frame(&self, output: usize, header: u64, bytes: &[u8]) -> Outcome {
        let (slot, mut loan) = (self.output(output), Loan::EMPTY);
        // SAFETY: a slot of this instance; the loan has room for `bytes`.
        unsafe {
            let loan = &mut loan;
            let outcome = (slot.loan)(slot.ctx, loan);
            if outcome != EXECUTED {
                return outcome;
            }
            loan.header.cast::<u64>().write(header);
            loan.bytes.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len());
            (slot.commit)(slot.ctx, loan, bytes.len() as u64, 0)
        }
    }

    /// The next sample, whose header or value has `size` bytes, and the result of `f` for its view.
    pub(crate) fn next_with<R>(
        &self,
        input: usize,
        size: usize,
        f: impl FnOnce(&SampleView) -> R,
    ) -> Option<(Shown, R)> {
        let (slot, mut view) = (self.input(input), SampleView::EMPTY);
        // SAFETY: a slot of this instance; the view is read only when it was written.
        unsafe {
            let view = &mut view;
            if (slot.next)(slot.ctx, view) != IN_SAMPLE {
                return None;
            }
            let result = f(view);
            let bytes = if view.len == 0 {
                &[][..]
            } else {
                std::slice::from_raw_parts(view.bytes, view.len as usize)
            };
            let shown = Shown {
                header: std::slice::from_raw_parts(view.header.cast::<u8>(), size).to_vec(),
                bytes: bytes.to_vec(),
                address: bytes.as_ptr() as usize,
                seq: view.seq,
                writable: !(slot.writable)(slot.ctx, view).is_null(),
            };
            (slot.release)(slot.ctx);
            Some((shown, result))
        }
    }

    pub(crate) fn next(&self, input: usize, size: usize) -> Option<Shown> {
        self.next_with(input, size, |_| ()).map(|(shown, ())| shown)
    }

    pub(crate) fn forward(&self, output: usize, view: &SampleView) -> Outcome {
        let slot = self.output(output);
        // SAFETY: a slot of this instance and a view that is held.
        unsafe { (slot.forward)(slot.ctx, view, 0) }
    }

    /// `type_of` of an output (0), input (1) or function (2).
    pub(crate) fn described(&self, kind: usize, index: usize) -> Value {
        let mut text = String::new();
        let sink = Sink { ctx: (&raw mut text).cast(), write: collect };
        let (f, ctx) = match kind {
            0 => (self.output(index).type_of, self.output(index).ctx),
            1 => (self.input(index).type_of, self.input(index).ctx),
            _ => (self.function(index).type_of, self.function(index).ctx),
        };
        // SAFETY: slots of this instance; the sink lives for the call.
        let status = unsafe { f(ctx, from_ref(&sink)) };
        if status == STATUS_OK { serde_json::from_str(&text).unwrap() } else { Value::Null }
    }

    pub(crate) fn ports_changed(&self) -> Outcome {
        // SAFETY: the host's own function and context.
        unsafe { (self.host().ports_changed)(self.host().ctx) }
    }

    pub(crate) fn note(&self, value: u64) {
        self.seen.lock().push(value);
    }

    pub(crate) fn forget(&self) {
        self.seen.lock().clear();
    }

    pub(crate) fn seen(&self) -> Vec<u64> {
        self.seen.lock().clone()
    }
}
