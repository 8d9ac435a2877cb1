//! A value entered by one thread at a time; a second thread is turned away instead of waiting.
//!
//! `entered` is set exactly while a guard lives; only the guard touches the value.

use std::ops::{Deref, DerefMut};

use crate::sync::{AtomicBool, Ordering, Shared};

/// A value with an entry that never waits: the second caller gets `None`, also when it is the same thread.
pub struct TryCell<T> {
    entered: AtomicBool,
    value: Shared<T>,
}

impl<T> TryCell<T> {
    pub fn new(value: T) -> Self {
        Self { entered: AtomicBool::new(false), value: Shared::new(value) }
    }

    /// Enters, or returns `None` while another guard lives. Any thread; one atomic operation.
    #[inline]
    pub fn try_enter(&self) -> Option<TryGuard<'_, T>> {
        if self.entered.swap(true, Ordering::Acquire) {
            return None;
        }
        Some(TryGuard { value: self.value.exclusive(), cell: self })
    }
}

/// The right to the value, given back when dropped.
pub struct TryGuard<'a, T> {
    value: *mut T,
    cell: &'a TryCell<T>,
}

impl<T> Deref for TryGuard<'_, T> {
    type Target = T;
    fn deref(&self) -> &T {
        // SAFETY: this guard is the only one alive (`entered`), and the cell outlives it.
        unsafe { &*self.value }
    }
}

impl<T> DerefMut for TryGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        // SAFETY: this guard is the only one alive (`entered`), and `&mut self` makes the access exclusive.
        unsafe { &mut *self.value }
    }
}

impl<T> Drop for TryGuard<'_, T> {
    #[inline]
    fn drop(&mut self) {
        self.cell.entered.store(false, Ordering::Release);
    }
}

// SAFETY: the cell moves with its value.
unsafe impl<T: Send> Send for TryCell<T> {}
// SAFETY: `entered` lets one thread at a time reach the value, which may therefore be handed between threads.
unsafe impl<T: Send> Sync for TryCell<T> {}
// SAFETY: a shared guard gives `&T` only.
unsafe impl<T: Sync> Sync for TryGuard<'_, T> {}
