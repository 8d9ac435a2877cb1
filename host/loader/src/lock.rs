//! Locks a mutex whose data no panic can leave half changed.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// A panic of one caller leaves the data whole: every update is a single assignment.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
