//! Slots of a port that was never bound: every call answers UNBOUND.
//!
//! Invariant: static and stateless; no stub ever lends memory.

use core::ffi::c_void;
use core::ptr::null_mut;
use trocar_plugin_api::abi::*;

/// A table that is shared between threads.
#[repr(transparent)]
pub struct Shared<T>(pub T);

// SAFETY: used for immutable tables of function pointers and pointers to statics only.
unsafe impl<T> Sync for Shared<T> {}

pub(crate) fn input() -> *const InSlot {
    unsafe extern "C" fn view(_: *mut c_void, _: *mut SampleView) -> i32 {
        IN_UNBOUND
    }
    unsafe extern "C" fn release(_: *mut c_void) {}
    unsafe extern "C" fn writable(_: *mut c_void, _: *mut SampleView) -> *mut u8 {
        null_mut()
    }
    unsafe extern "C" fn header_len(_: *mut c_void) -> u64 {
        0
    }
    unsafe extern "C" fn hold(_: *mut c_void, _: *mut Held) -> i32 {
        IN_UNBOUND
    }
    static SLOT: Shared<InSlot> = Shared(InSlot {
        struct_size: size_of::<InSlot>() as u32,
        flags: 0,
        ctx: null_mut(),
        latest: view,
        next: view,
        release,
        writable,
        type_of,
        header_len,
        hold,
    });
    &SLOT.0
}

pub(crate) fn output() -> *const OutSlot {
    unsafe extern "C" fn write(_: *mut c_void, _: *const c_void, _: u64) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn loan(_: *mut c_void, _: *mut Loan) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn commit(_: *mut c_void, _: *mut Loan, _: u64, _: u64) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn cancel(_: *mut c_void, _: *mut Loan) {}
    unsafe extern "C" fn forward(_: *mut c_void, _: *const SampleView, _: u64) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn reserve(_: *mut c_void, _: u64, _: u32) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn write_bytes(_: *mut c_void, _: Bytes, _: u64) -> Outcome {
        UNBOUND
    }
    static SLOT: Shared<OutSlot> = Shared(OutSlot {
        struct_size: size_of::<OutSlot>() as u32,
        flags: 0,
        ctx: null_mut(),
        write,
        loan,
        commit,
        cancel,
        forward,
        reserve,
        type_of,
        write_bytes,
    });
    &SLOT.0
}

pub(crate) fn function() -> *const FnSlot {
    unsafe extern "C" fn call(_: *mut c_void, _: *const c_void, _: *mut c_void, _: *mut CallOpts) -> Outcome {
        UNBOUND
    }
    unsafe extern "C" fn call_bytes(
        _: *mut c_void,
        _: Bytes,
        _: *mut c_void,
        _: u64,
        _: *mut CallOpts,
    ) -> Outcome {
        UNBOUND
    }
    static SLOT: Shared<FnSlot> = Shared(FnSlot {
        struct_size: size_of::<FnSlot>() as u32,
        flags: 0,
        ctx: null_mut(),
        call,
        type_of,
        call_bytes,
    });
    &SLOT.0
}

pub(crate) fn event() -> *const EventSlot {
    unsafe extern "C" fn emit(_: *mut c_void, _: *const c_void) -> Outcome {
        UNBOUND
    }
    static SLOT: Shared<EventSlot> =
        Shared(EventSlot { struct_size: size_of::<EventSlot>() as u32, flags: 0, ctx: null_mut(), emit });
    &SLOT.0
}

pub(crate) unsafe extern "C" fn type_of(_: *mut c_void, _: *const Sink) -> Status {
    STATUS_UNSUPPORTED
}
