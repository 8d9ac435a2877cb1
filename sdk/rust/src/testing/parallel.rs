//! Slices of a frame on threads of the bench: `trocar.parallel/1` as a host has it.
//!
//! Invariant: all slices are done when `run` returns, and every thread takes part, so that races have a
//! chance to show.

use super::alloc;
use super::fake_host::FakeHost;
use core::ffi::c_void;
use std::sync::atomic::{AtomicI32, AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use trocar_plugin_api::abi::{self, Parallel, SliceBody, Status};

/// The extension's table of a fake host.
pub(crate) fn table(host: *const FakeHost) -> Parallel {
    Parallel {
        struct_size: size_of::<Parallel>() as u32,
        flags: 0,
        ctx: host.cast_mut().cast(),
        threads,
        run,
    }
}

unsafe extern "C" fn threads(ctx: *mut c_void) -> u32 {
    // SAFETY: the table's own context.
    unsafe { &*ctx.cast::<FakeHost>() }.threads.load(Ordering::Relaxed)
}

/// A body that threads share.
struct Shared<'a>(&'a SliceBody);

// SAFETY: the extension's contract: `data` is shared, and `run` may be called from several threads at once.
unsafe impl Sync for Shared<'_> {}

impl Shared<'_> {
    fn slice(&self, slice: u32) -> Status {
        // SAFETY: the body is alive until `run` returns, and each slice number is below the asked-for count.
        unsafe { (self.0.run)(self.0.data, slice) }
    }
}

unsafe extern "C" fn run(ctx: *mut c_void, slices: u32, body: *const SliceBody) -> Status {
    let counting = alloc::armed();
    let quiet = alloc::pause();
    // SAFETY: the table's own context; the body lives through the call.
    let (host, body) = unsafe { (&*ctx.cast::<FakeHost>(), Shared(&*body)) };
    let (next, worst) = (AtomicU32::new(0), AtomicI32::new(abi::STATUS_OK));
    let counts = Mutex::new(Vec::new());
    let work = || {
        let armed = alloc::arm(counting);
        loop {
            let slice = next.fetch_add(1, Ordering::Relaxed);
            if slice >= slices {
                break;
            }
            let status = body.slice(slice);
            worst.fetch_min(status, Ordering::Relaxed);
        }
        drop(armed);
        counts.lock().unwrap_or_else(PoisonError::into_inner).push(alloc::take());
    };
    // The caller's own count so far does not belong to a worker.
    let own = alloc::take();
    std::thread::scope(|scope| {
        for _ in 1..host.threads.load(Ordering::Relaxed).max(1) {
            scope.spawn(work);
        }
        work();
    });
    alloc::add(own);
    counts.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().for_each(alloc::add);
    drop(quiet);
    worst.load(Ordering::Relaxed)
}
