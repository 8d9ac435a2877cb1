//! Texts and words that cross the boundary, as bytes.
//!
//! Invariant: no length from the other side is believed beyond the room that was lent.

use trocar_plugin_api::abi::{Bytes, ErrBuf, STATUS_OK, STATUS_UNSUPPORTED, Sink, Status};

/// A text as it is lent for a call.
pub(super) fn bytes(text: &[u8]) -> Bytes {
    Bytes { ptr: text.as_ptr(), len: text.len() }
}

/// Words viewed as their bytes.
pub(crate) fn as_bytes(words: &[u64]) -> &[u8] {
    // SAFETY: any u64 is eight valid bytes; the slice covers the same memory.
    unsafe { std::slice::from_raw_parts(words.as_ptr().cast(), size_of_val(words)) }
}

/// The text in an error buffer; empty for a null one.
pub(crate) fn sentence(err: *mut ErrBuf) -> String {
    // SAFETY: null, or a buffer of this host that a plugin wrote at most `cap` bytes into.
    unsafe { err.as_ref() }.map_or_else(String::new, |err| trocar_model::plain::sentence(text_in(err)))
}

/// The bytes in an error buffer of this host, or of a caller that lent one.
pub(crate) fn text_in(err: &ErrBuf) -> &[u8] {
    if err.ptr.is_null() {
        return &[];
    }
    // SAFETY: `ptr` has room for `cap` bytes, and the code that sets `len` has written that many, by the
    // contract of an `ErrBuf`.
    unsafe { std::slice::from_raw_parts(err.ptr, err.len.min(err.cap)) }
}

/// Gives `text` to a plugin; an empty text is STATUS_UNSUPPORTED.
pub(super) fn tell(sink: *const Sink, text: &str) -> Status {
    // SAFETY: null or a sink the plugin lends for the call.
    let Some(sink) = (unsafe { sink.as_ref() }) else { return STATUS_UNSUPPORTED };
    if text.is_empty() {
        return STATUS_UNSUPPORTED;
    }
    // SAFETY: the sink takes any bytes; they live for the call.
    unsafe { (sink.write)(sink.ctx, bytes(text.as_bytes())) };
    STATUS_OK
}

/// Puts a sentence into a caller's error buffer, cut to its room.
pub(crate) fn write_err(err: *mut ErrBuf, text: &[u8]) {
    // SAFETY: null or a buffer the caller lends for the call.
    if let Some(err) = unsafe { err.as_mut() }
        && !err.ptr.is_null()
    {
        let n = text.len().min(err.cap);
        // SAFETY: `ptr` has room for `cap` bytes.
        unsafe { std::ptr::copy_nonoverlapping(text.as_ptr(), err.ptr, n) };
        err.len = n;
    }
}
