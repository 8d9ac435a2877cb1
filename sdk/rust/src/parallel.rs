//! Work on slices of a frame, on the threads the deployment gives the stream (`execution.threads`).
//!
//! Invariant: each slice is worked on once, and all are done when the call returns; a panic in one never
//! leaves this file.

use crate::error::Result;
use crate::host::Host;
use core::ffi::c_void;
use core::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};
use trocar_plugin_api::abi::{PARALLEL, Parallel, STATUS_OK, STATUS_PANICKED, SliceBody, Status};

/// Slices per thread, so that a thread with easy ones takes more of them.
const SLICES_PER_THREAD: usize = 4;

/// The work of one call and the first panic in it.
struct Work<'a, F> {
    body: &'a F,
    panic: Mutex<Option<String>>,
}

impl<F: Fn(u32) + Sync> Work<'_, F> {
    fn slice(&self, slice: u32) -> Status {
        let Err(payload) = catch_unwind(AssertUnwindSafe(|| (self.body)(slice))) else { return STATUS_OK };
        let text = crate::forward::last_panic()
            .unwrap_or_else(|| format!("panicked: {}", crate::forward::payload_text(&*payload)));
        self.panic
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert(format!("slice {slice}: {text}"));
        // A payload whose Drop panics must not escape either.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(payload)));
        STATUS_PANICKED
    }
}

impl Host {
    /// Returns the number of threads that work together in [`Host::parallel`], this one included; 1 outside
    /// of a stream with several.
    pub fn threads(&self) -> usize {
        // SAFETY: the table is the host's, checked in `pool`.
        self.pool().map_or(1, |pool| unsafe { (pool.threads)(pool.ctx) }.max(1) as usize)
    }

    /// Runs `body` once for each number below `slices`, on several threads where there are some, and returns
    /// when all are done. From `step`, commands and handlers, not from within a body. Allocates nothing.
    ///
    /// # Errors
    /// The sentence of the first panic in a body; the other slices are worked on or left out.
    pub fn parallel(&self, slices: u32, body: impl Fn(u32) + Sync) -> Result {
        unsafe extern "C" fn run<F: Fn(u32) + Sync>(data: *mut c_void, slice: u32) -> Status {
            // SAFETY: `data` is the work below, shared between threads; the body is Sync.
            unsafe { &*data.cast::<Work<'_, F>>() }.slice(slice)
        }
        fn entry_of<F: Fn(u32) + Sync>(_: &Work<'_, F>) -> unsafe extern "C" fn(*mut c_void, u32) -> Status {
            run::<F>
        }
        let work = Work { body: &body, panic: Mutex::new(None) };
        let status = match self.pool() {
            Some(pool) => {
                let data = (&raw const work).cast_mut().cast();
                let body = SliceBody { data, run: entry_of(&work) };
                // SAFETY: the host's own table; the work lives until all slices are done, which is when this
                // returns.
                unsafe { (pool.run)(pool.ctx, slices, &body) }
            }
            None => (0..slices).map(|slice| work.slice(slice)).find(|s| *s != STATUS_OK).unwrap_or(STATUS_OK),
        };
        match work.panic.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(text) => Err(text.into()),
            None if status >= STATUS_OK => Ok(()),
            None => Err(format!("the host did not run the slices (status {status})").into()),
        }
    }

    /// Cuts `items` into groups of whole rows of `row` items and works on them in parallel: `body` gets the
    /// numbers of its rows and their items. A last row that is shorter belongs to the last group.
    ///
    /// ```
    /// use trocar_sdk::Host;
    /// fn invert(host: &Host, pixels: &mut [u8], stride: usize) -> trocar_sdk::Result {
    ///     host.par_rows(pixels, stride, |_rows, pixels| pixels.iter_mut().for_each(|p| *p = 255 - *p))
    /// }
    /// ```
    ///
    /// # Errors
    /// As [`Host::parallel`]; a row of 0 items.
    pub fn par_rows<T: Send>(
        &self,
        items: &mut [T],
        row: usize,
        body: impl Fn(Range<usize>, &mut [T]) + Sync,
    ) -> Result {
        /// May be shared: each slice takes its own part only.
        struct Start<T>(*mut T);
        // SAFETY: parts of different slices do not overlap, and `T: Send` lets another thread have them.
        unsafe impl<T: Send> Sync for Start<T> {}
        impl<T> Start<T> {
            fn at(&self, items: usize) -> *mut T {
                self.0.wrapping_add(items)
            }
        }

        if row == 0 {
            return Err("a row has at least one item".into());
        }
        let (rows, len) = (items.len().div_ceil(row), items.len());
        let threads = self.threads();
        let most = if threads == 1 { 1 } else { threads * SLICES_PER_THREAD };
        let slices = most.min(rows);
        let start = Start(items.as_mut_ptr());
        let first = |slice: usize| rows * slice / slices.max(1);
        self.parallel(slices as u32, |slice| {
            let rows = first(slice as usize)..first(slice as usize + 1);
            let (from, to) = (rows.start * row, (rows.end * row).min(len));
            // SAFETY: `from..to` lies inside `items`, which stays borrowed until all slices are done; the
            // parts of different slices do not overlap, and each slice number comes once.
            let part = unsafe { core::slice::from_raw_parts_mut(start.at(from), to - from) };
            body(rows, part);
        })
    }

    fn pool(&self) -> Option<&Parallel> {
        let table = self.extension(PARALLEL).cast::<Parallel>();
        // SAFETY: null, or the host's table of this name, which lives as long as the instance and says its
        // size.
        let pool = unsafe { table.as_ref() }?;
        (pool.struct_size as usize >= size_of::<Parallel>()).then_some(pool)
    }
}
