//! The host extension `trocar.parallel/1`: slices of a frame on the threads of the stream a component runs
//! in.
//!
//! Invariant: `run` returns only when no thread is inside a body any more; without a pool everything runs in
//! the caller.

use std::ffi::c_void;

use trocar_plugin_api::abi::{Parallel, STATUS_INVALID, STATUS_OK, SliceBody, Status};

use super::super::context;

/// One table for all components: the team is that of the calling thread.
static TABLE: Table = Table(Parallel {
    struct_size: size_of::<Parallel>() as u32,
    flags: 0,
    ctx: std::ptr::null_mut(),
    threads,
    run,
});

struct Table(Parallel);

// SAFETY: the table is immutable, and its context is never followed.
unsafe impl Sync for Table {}

pub(super) fn table() -> *const Parallel {
    &raw const TABLE.0
}

/// The body as the threads of a team share it.
#[derive(Clone, Copy)]
struct Body {
    data: *mut c_void,
    run: unsafe extern "C" fn(data: *mut c_void, slice: u32) -> Status,
}

// SAFETY: the plugin says that `data` may be used by several threads at once: that is what a slice body is.
unsafe impl Sync for Body {}

impl Body {
    fn slice(&self, slice: u32) -> Status {
        // SAFETY: the plugin lends body and data until `run` returns, which waits for every slice.
        unsafe { (self.run)(self.data, slice) }
    }
}

unsafe extern "C" fn threads(_ctx: *mut c_void) -> u32 {
    context::team().map_or(1, |team| team.threads() as u32)
}

unsafe extern "C" fn run(_ctx: *mut c_void, slices: u32, body: *const SliceBody) -> Status {
    // SAFETY: null or a body the plugin lends for the call.
    let Some(body) = (unsafe { body.as_ref() }) else { return STATUS_INVALID };
    let body = Body { data: body.data, run: body.run };
    match context::team() {
        Some(team) => team.run(slices, &|slice| body.slice(slice)),
        None => alone(slices, body),
    }
}

/// Runs all slices one after the other; the first failure counts, as with a team, and the others run all the
/// same.
fn alone(slices: u32, body: Body) -> Status {
    (0..slices)
        .map(|slice| body.slice(slice))
        .fold(STATUS_OK, |first, status| if first < STATUS_OK { first } else { status.min(STATUS_OK) })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    use trocar_rt::team::Team;

    use super::*;

    unsafe extern "C" fn mark(data: *mut c_void, slice: u32) -> Status {
        // SAFETY: the counters of `ran`.
        let seen = unsafe { &*data.cast::<AtomicU64>() };
        seen.fetch_add(1 << (8 * slice), Ordering::Relaxed);
        if slice == 2 { -7 } else { STATUS_OK }
    }

    /// Run count of each of eight slices, a byte each, and the status.
    fn ran() -> (u64, Status) {
        let seen = AtomicU64::new(0);
        let body = SliceBody { data: (&raw const seen).cast_mut().cast(), run: mark };
        // SAFETY: the body lives through the call.
        let status = unsafe { (TABLE.0.run)(TABLE.0.ctx, 8, &raw const body) };
        (seen.load(Ordering::Relaxed), status)
    }

    #[test]
    fn without_a_pool_every_slice_runs_once_in_the_caller_and_the_first_failure_counts() {
        // SAFETY: the context is not followed.
        assert_eq!(unsafe { (TABLE.0.threads)(TABLE.0.ctx) }, 1);
        assert_eq!(ran(), (0x0101_0101_0101_0101, -7));
        // SAFETY: a null body is refused.
        assert_eq!(unsafe { (TABLE.0.run)(TABLE.0.ctx, 8, std::ptr::null()) }, STATUS_INVALID);
    }

    #[test]
    fn with_a_pool_every_slice_runs_once_on_some_thread_and_the_first_failure_counts() {
        context::set_team(Some(Arc::new(Team::new(3, |_| ()).unwrap())));
        // SAFETY: the context is not followed.
        assert_eq!(unsafe { (TABLE.0.threads)(TABLE.0.ctx) }, 3);
        assert_eq!(ran(), (0x0101_0101_0101_0101, -7));
        context::set_team(None);
    }
}
