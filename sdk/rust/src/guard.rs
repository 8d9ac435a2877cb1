//! The wall around every entry: panics stop here, errors become one sentence in the caller's buffer.
//!
//! Invariant: nothing unwinds out of this crate's `extern "C"` functions; the happy path allocates nothing.

use crate::error::{Error, Result};
use crate::outcome::NoFrame;
use core::fmt::{self, Display, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use trocar_plugin_api::abi::{ErrBuf, STATUS_FAILED, STATUS_OK, STATUS_PANICKED, Status};

/// Runs one entry.
#[inline]
pub(crate) fn guard(err: *mut ErrBuf, f: impl FnOnce() -> Status) -> Status {
    // Why unwind-safe: after STATUS_PANICKED the host does not trust the instance again.
    match catch_unwind(AssertUnwindSafe(f)) {
        Ok(status) => status,
        Err(payload) => panicked(err, payload),
    }
}

/// The status of a component method's result.
#[inline]
pub(crate) fn settle(err: *mut ErrBuf, result: Result) -> Status {
    match result {
        Ok(()) => STATUS_OK,
        Err(e) => failed(err, &e),
    }
}

#[cold]
fn failed(err: *mut ErrBuf, e: &Error) -> Status {
    if e.is::<NoFrame>() {
        return STATUS_OK;
    }
    refuse(err, STATUS_FAILED, &Chain(&**e))
}

/// Puts `why` into the buffer and returns `status`.
#[cold]
pub(crate) fn refuse(err: *mut ErrBuf, status: Status, why: &dyn Display) -> Status {
    // SAFETY: entries get an error buffer that is null or valid for the call.
    if let Some(buf) = unsafe { err.as_mut() } {
        buf.len = 0;
        // A buffer that is too short cuts the sentence; that is no failure of its own.
        let _ = write!(Writer(buf), "{why}");
    }
    status
}

#[cold]
fn panicked(err: *mut ErrBuf, payload: Box<dyn std::any::Any + Send>) -> Status {
    let text = crate::forward::last_panic()
        .unwrap_or_else(|| format!("panicked: {}", crate::forward::payload_text(&*payload)));
    // A payload whose Drop panics must not escape either.
    let _ = catch_unwind(AssertUnwindSafe(|| drop(payload)));
    refuse(err, STATUS_PANICKED, &text)
}

/// An error with its causes.
pub(crate) struct Chain<'a>(pub(crate) &'a (dyn std::error::Error + 'static));

impl Display for Chain<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)?;
        let mut cause = self.0.source();
        while let Some(e) = cause {
            write!(f, ": {e}")?;
            cause = e.source();
        }
        Ok(())
    }
}

/// Writes into an `ErrBuf`, cut between characters.
struct Writer<'a>(&'a mut ErrBuf);

impl Write for Writer<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.0.cap.saturating_sub(self.0.len);
        if self.0.ptr.is_null() || room == 0 {
            return Err(fmt::Error);
        }
        let mut end = text.len().min(room);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        // SAFETY: the buffer has `cap` bytes at `ptr`, of which `len` are used; `end` fits into the rest.
        unsafe { core::ptr::copy_nonoverlapping(text.as_ptr(), self.0.ptr.add(self.0.len), end) };
        self.0.len += end;
        if end == text.len() { Ok(()) } else { Err(fmt::Error) }
    }
}
