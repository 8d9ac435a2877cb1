//! Counts the allocations of a component while it is inside its own code.
//!
//! Invariant: a count belongs to the thread that is armed; work of the bench behind its slots is never
//! counted.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator with a count. Install it with [`count_allocations!`](crate::count_allocations).
pub struct CountingAllocator;

thread_local! {
    static ARMED: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<Count> = const { Cell::new(Count { times: 0, first_bytes: 0 }) };
}

/// Allocations of one thread.
#[derive(Clone, Copy, Default, Debug, PartialEq, Eq)]
pub(crate) struct Count {
    pub(crate) times: u64,
    /// Size of the first one, B.
    pub(crate) first_bytes: usize,
}

fn note(bytes: usize) {
    // A thread that ends has no locals any more, and nothing to count.
    if ARMED.try_with(Cell::get).unwrap_or(false) {
        let _ = COUNT.try_with(|count| {
            let Count { times, first_bytes } = count.get();
            let first_bytes = if times == 0 { bytes } else { first_bytes };
            count.set(Count { times: times + 1, first_bytes });
        });
    }
}

// SAFETY: hands everything to the system's allocator unchanged; counting allocates nothing.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        note(new_size);
        // SAFETY: as above.
        unsafe { System.realloc(ptr, layout, new_size) }
    }
    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(ptr, layout) }
    }
}

/// Installs the allocator that [`Bench::assert_no_alloc`](crate::testing::Bench::assert_no_alloc) counts
/// with: once per test program, outside of functions, under `#[cfg(test)]`.
#[macro_export]
macro_rules! count_allocations {
    () => {
        #[global_allocator]
        static TROCAR_COUNTING: $crate::testing::CountingAllocator = $crate::testing::CountingAllocator;
    };
}

/// Ends with the former state of the thread.
pub(crate) struct Restore(bool);

impl Drop for Restore {
    fn drop(&mut self) {
        ARMED.set(self.0);
    }
}

/// The thread counts until the guard is dropped.
pub(crate) fn arm(on: bool) -> Restore {
    Restore(ARMED.replace(on))
}

/// The thread does not count until the guard is dropped.
pub(crate) fn pause() -> Restore {
    arm(false)
}

pub(crate) fn armed() -> bool {
    ARMED.get()
}

/// Returns this thread's count since the last taking.
pub(crate) fn take() -> Count {
    COUNT.take()
}

/// Adds the count of another thread that worked for this one.
pub(crate) fn add(other: Count) {
    let Count { times, first_bytes } = COUNT.get();
    let first_bytes = if times == 0 { other.first_bytes } else { first_bytes };
    COUNT.set(Count { times: times + other.times, first_bytes });
}

/// True when this program counts at all.
pub(crate) fn installed() -> bool {
    let before = COUNT.get();
    let armed = arm(true);
    drop(std::hint::black_box(Box::new(1u8)));
    drop(armed);
    let counts = COUNT.get().times > before.times;
    COUNT.set(before);
    counts
}
