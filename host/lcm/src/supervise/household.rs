//! The settings that a process looks after which is a host and nothing else: locale, umask, signal handlers,
//! standard streams.

use parking_lot::{Mutex, MutexGuard};
use trocar_rt::os::{self, Household};

/// Declares this process a host and nothing else: its locale, umask, signal handlers and standard streams are
/// looked after from now on. A program that embeds a host changes them as it likes.
pub fn own_process() {
    os::keep_streams();
    household().get_or_insert_with(Household::look);
}

pub(super) fn is_own_process() -> bool {
    household().is_some()
}

/// The state of the process at the last look between entries.
pub(super) fn household() -> MutexGuard<'static, Option<Household>> {
    static HOUSEHOLD: Mutex<Option<Household>> = Mutex::new(None);
    HOUSEHOLD.lock()
}
