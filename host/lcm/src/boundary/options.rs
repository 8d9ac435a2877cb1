//! Options of a call beside its argument, read and written only as far as their `struct_size` reaches.
//!
//! Invariant: a field behind the caller's size counts as absent and is never touched.

use std::mem::offset_of;

use trocar_plugin_api::abi::{CallOpts, MODE_SEND, Outcome};
use trocar_plugin_api::has_entry;

/// The options, if they have all fields of this host.
///
/// # Safety
/// Not null; lent by the caller for `'a` and as long as its `struct_size` says.
#[inline]
pub(super) unsafe fn whole<'a>(opts: *mut CallOpts) -> Option<&'a mut CallOpts> {
    // SAFETY: every such struct begins with its size.
    let size = unsafe { (&raw const (*opts).struct_size).read() };
    if (size as usize) < size_of::<CallOpts>() {
        return None;
    }
    // SAFETY: the caller's promise; all fields of this host lie inside.
    let opts = unsafe { &mut *opts };
    // A buffer at a null address is no buffer, also for the server it is handed on to.
    // SAFETY: null or a buffer the caller lends for the call.
    if unsafe { opts.err.as_ref() }.is_some_and(|err| err.ptr.is_null()) {
        opts.err = std::ptr::null_mut();
    }
    Some(opts)
}

/// Runs `f` with the options, if there are any. Real-time.
///
/// # Safety
/// Null, or lent by the caller and as long as its `struct_size` says.
#[inline]
pub(super) unsafe fn with(opts: *mut CallOpts, f: impl FnOnce(Option<&mut CallOpts>) -> Outcome) -> Outcome {
    if opts.is_null() {
        return f(None);
    }
    // SAFETY: the caller's promise.
    match unsafe { whole(opts) } {
        Some(opts) => f(Some(opts)),
        // SAFETY: as above; every such struct begins with its size.
        None => unsafe { with_short(opts, (&raw const (*opts).struct_size).read(), f) },
    }
}

/// The same, through a copy of the fields that are there.
#[cold]
unsafe fn with_short(
    opts: *mut CallOpts,
    size: u32,
    f: impl FnOnce(Option<&mut CallOpts>) -> Outcome,
) -> Outcome {
    let mut whole = CallOpts {
        struct_size: size_of::<CallOpts>() as u32,
        mode: MODE_SEND,
        deadline_ns: 0,
        err: std::ptr::null_mut(),
        stamp_ns: 0,
        may_still_run: 0,
        reserved: 0,
    };
    macro_rules! field {
        ($name:ident, |$place:ident| $then:expr) => {
            if has_entry(size, offset_of!(CallOpts, $name), size_of_val(&whole.$name)) {
                let $place = &raw mut (*opts).$name;
                $then;
            }
        };
    }
    // SAFETY: each place that is looked at lies inside the memory the caller lends.
    unsafe {
        field!(mode, |place| whole.mode = place.read());
        field!(deadline_ns, |place| whole.deadline_ns = place.read());
        field!(err, |place| whole.err = place.read());
    }
    // SAFETY: null or a buffer the caller lends for the call.
    if unsafe { whole.err.as_ref() }.is_some_and(|err| err.ptr.is_null()) {
        whole.err = std::ptr::null_mut();
    }
    let outcome = f(Some(&mut whole));
    // SAFETY: as above.
    unsafe {
        field!(stamp_ns, |place| place.write(whole.stamp_ns));
        field!(may_still_run, |place| place.write(whole.may_still_run));
    }
    outcome
}
