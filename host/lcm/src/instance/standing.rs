//! The standing of a component beside its state and health: why it is in FAULT, the warnings shown with its
//! state, and the rows in which all that is published.
//!
//! Invariant: state and fault text change together, under the lock of the text.

use parking_lot::{Mutex, MutexGuard};
use trocar_rt::state::StateWriter;

/// Most warnings kept of one component; the oldest gives way.
const WARNINGS: usize = 16;

/// The standing of one component.
pub(super) struct Standing {
    fault: Mutex<String>,
    /// Sentences shown with its state beside those of its thread.
    warnings: Mutex<Vec<String>>,
    /// Rows behind GetState, each a `ComponentStatus`.
    status: Mutex<StateWriter>,
}

impl Standing {
    pub(super) fn new(status: StateWriter) -> Standing {
        Standing {
            fault: Mutex::new(String::new()),
            warnings: Mutex::new(Vec::new()),
            status: Mutex::new(status),
        }
    }

    /// The fault text, to be changed together with the state.
    pub(super) fn fault(&self) -> MutexGuard<'_, String> {
        self.fault.lock()
    }

    /// The rows behind GetState.
    pub(super) fn status(&self) -> MutexGuard<'_, StateWriter> {
        self.status.lock()
    }

    fn all(&self) -> MutexGuard<'_, Vec<String>> {
        self.warnings.lock()
    }

    pub(super) fn warnings(&self) -> Vec<String> {
        self.all().clone()
    }

    /// Keeps a sentence that is shown with the state from now on; true when it is new.
    pub(super) fn keep(&self, text: &str) -> bool {
        let mut warnings = self.all();
        if warnings.iter().any(|w| w == text) {
            return false;
        }
        if warnings.len() == WARNINGS {
            warnings.remove(0);
        }
        warnings.push(text.to_owned());
        true
    }

    /// Forgets the sentences that begin so; with an empty beginning, all.
    pub(super) fn forget(&self, about: &str) {
        self.all().retain(|w| !w.starts_with(about));
    }
}
