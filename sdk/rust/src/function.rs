//! Functions of required interfaces and events of provided ones.
//!
//! Invariant: nothing here waits without a deadline; `send` and `emit` never wait at all.

use crate::call::Value;
use crate::flow::{Flow, PortKind};
use crate::lease::{Lease, Tie};
use crate::outcome::{CallError, Outcome};
use crate::stubs;
use core::marker::PhantomData;
use core::mem::MaybeUninit;
use core::time::Duration;
use trocar_plugin_api::abi::{CallOpts, ErrBuf, EventSlot, FnSlot, MODE_CALL, MODE_SEND};
use trocar_plugin_api::desc::TypeDesc;

/// Questions of the derive to a function field.
pub trait FunctionPort {
    /// The argument's type; none without one, and for an untyped function.
    const ARG: Option<&'static TypeDesc>;
    /// The result's type; none without one, and for an untyped function.
    const RET: Option<&'static TypeDesc>;
    /// The function takes the types of the command it is connected to.
    const ANY: bool;
}

/// Questions of the derive to an event field.
pub trait EventPort {
    /// The payload's type; none for an event that carries nothing.
    const PAYLOAD: Option<&'static TypeDesc>;
}

/// A function: bound to a command of the connected component. Several threads may call it.
pub struct Function<A = (), R = ()> {
    slot: *const FnSlot,
    lease: Option<Lease>,
    kind: PhantomData<fn(A) -> R>,
}

// SAFETY: the host's slots take calls from several threads of one component.
unsafe impl<A, R> Send for Function<A, R> {}
// SAFETY: as above; the slot itself is immutable.
unsafe impl<A, R> Sync for Function<A, R> {}

impl<A, R> Default for Function<A, R> {
    fn default() -> Self {
        Function { slot: stubs::function(), lease: None, kind: PhantomData }
    }
}

impl<A: Value, R: Value> Function<A, R> {
    /// Without waiting and without a result: the way from `step`.
    #[inline]
    pub fn send(&self, arg: A) -> Outcome {
        // SAFETY: attach demands a valid slot for `A`; the argument lives through the call; no result is
        // asked for.
        unsafe {
            let slot = &*self.slot;
            let (ret, opts) = (core::ptr::null_mut(), core::ptr::null_mut());
            Outcome::from((slot.call)(slot.ctx, arg.ptr(), ret, opts))
        }
    }

    /// Sends as [`Function::send`] does, but the command never runs if it has not begun within `deadline`:
    /// its connection counts it then. Zero: its connection and its server's class say how long its goal is
    /// right.
    #[inline]
    pub fn send_within(&self, arg: A, deadline: Duration) -> Outcome {
        let mut opts = options(MODE_SEND, deadline, core::ptr::null_mut());
        // SAFETY: as in `send`; the options live through the call.
        unsafe {
            let slot = &*self.slot;
            Outcome::from((slot.call)(slot.ctx, arg.ptr(), core::ptr::null_mut(), &mut opts))
        }
    }

    /// Waits for the result, at most until the connection's deadline (1 s unless set).
    ///
    /// # Errors
    /// The outcome and the peer's sentence.
    pub fn call(&self, arg: A) -> Result<R, CallError> {
        self.call_within(arg, Duration::ZERO)
    }

    /// Waits for the result, at most for `deadline`; zero means the connection's own, more than an hour
    /// counts as an hour.
    ///
    /// # Errors
    /// The outcome and the peer's sentence.
    pub fn call_within(&self, arg: A, deadline: Duration) -> Result<R, CallError> {
        let mut ret = R::blank();
        waiting(deadline, |opts| {
            // SAFETY: attach demands a valid slot for `A` and `R`; all pointers live through the call.
            unsafe {
                let slot = &*self.slot;
                Outcome::from((slot.call)(slot.ctx, arg.ptr(), ret.ptr_mut(), opts))
            }
        })?;
        Ok(ret)
    }
}

fn options(mode: u32, deadline: Duration, err: *mut ErrBuf) -> CallOpts {
    CallOpts {
        struct_size: size_of::<CallOpts>() as u32,
        mode,
        deadline_ns: u64::try_from(deadline.as_nanos()).unwrap_or(u64::MAX),
        err,
        stamp_ns: 0,
        may_still_run: 0,
        reserved: 0,
    }
}

/// One call that waits, with room for the peer's sentence.
pub(crate) fn waiting(
    deadline: Duration,
    call: impl FnOnce(*mut CallOpts) -> Outcome,
) -> Result<(), CallError> {
    // Written only by a call that fails: to clear it would cost as much as the call.
    let mut text = [MaybeUninit::<u8>::uninit(); 256];
    let mut err = ErrBuf { ptr: text.as_mut_ptr().cast(), cap: text.len(), len: 0 };
    let mut opts = options(MODE_CALL, deadline, &mut err);
    let outcome = call(&mut opts);
    if outcome == Outcome::Executed {
        return Ok(());
    }
    let may_still_run = opts.may_still_run != 0;
    // SAFETY: whoever sets `len` has written that many bytes, by the contract of an `ErrBuf`.
    let said = unsafe { core::slice::from_raw_parts(text.as_ptr().cast::<u8>(), err.len.min(text.len())) };
    let reason = String::from_utf8_lossy(said).into_owned();
    Err(CallError { outcome, reason, may_still_run })
}

impl<A: Value, R: Value> FunctionPort for Function<A, R> {
    const ARG: Option<&'static TypeDesc> = A::DESC;
    const RET: Option<&'static TypeDesc> = R::DESC;
    const ANY: bool = false;
}

// SAFETY: passes `A` and `R`, which the description names.
unsafe impl<A: Value, R: Value> Flow for Function<A, R> {
    type Slot = FnSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const FnSlot, tie: &Tie) {
        self.slot = slot;
        self.lease = Some(tie.lease.clone());
    }
}

/// An event generator of a provided interface.
pub struct Event<T = ()> {
    slot: *const EventSlot,
    lease: Option<Lease>,
    kind: PhantomData<fn(T)>,
}

// SAFETY: the slot may be used from whichever thread enters the instance.
unsafe impl<T> Send for Event<T> {}

impl<T> Default for Event<T> {
    fn default() -> Self {
        Event { slot: stubs::event(), lease: None, kind: PhantomData }
    }
}

impl<T: Value> Event<T> {
    /// Broadcasts; `QueueFull` when at least one observer missed it (counted there).
    #[inline]
    pub fn emit(&self, payload: T) -> Outcome {
        // SAFETY: attach demands a valid slot for `T`; the payload lives through the call.
        unsafe {
            let slot = &*self.slot;
            Outcome::from((slot.emit)(slot.ctx, payload.ptr()))
        }
    }
}

impl<T: Value> EventPort for Event<T> {
    const PAYLOAD: Option<&'static TypeDesc> = T::DESC;
}

// SAFETY: passes `T`, which the description names.
unsafe impl<T: Value> Flow for Event<T> {
    type Slot = EventSlot;
    const KIND: PortKind = PortKind::Any;
    unsafe fn attach(&mut self, slot: *const EventSlot, tie: &Tie) {
        self.slot = slot;
        self.lease = Some(tie.lease.clone());
    }
}
