//! Locks the tables of this folder.
//!
//! Invariant: nothing here leaves a lock's content half changed, so a panic elsewhere is no reason to end.

use std::sync::{Mutex, MutexGuard, PoisonError};

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
