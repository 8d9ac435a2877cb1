//! An allocator for tests that counts the allocations of watched threads.
//!
//! Invariant: it behaves as the system's allocator; counting allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Allocations and releases of this thread since it is watched; -1 = not watched.
    static COUNT: Cell<i64> = const { Cell::new(-1) };
}

fn count() {
    // A thread that is about to end has no counter any more.
    let _ = COUNT.try_with(|count| {
        if count.get() >= 0 {
            count.set(count.get() + 1);
        }
    });
}

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Begins to count the calling thread's allocations.
pub(crate) fn watch() {
    COUNT.set(0);
}

/// Ends the count; returns the number of allocations and releases.
pub(crate) fn watched() -> u64 {
    COUNT.replace(-1).max(0) as u64
}
