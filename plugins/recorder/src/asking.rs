//! Asks the GCM for the graph, and as soon as it has answered again: an answer that knows the last one comes
//! with the next change.
//!
//! Invariant: a run of the recorder asks one question at a time, ten in a second at most; one that is lost is
//! asked again.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::json;

/// Least time from one question to the next, and after a refused one.
const SOON: Duration = Duration::from_millis(100);
const REFUSED: Duration = Duration::from_secs(1);
/// An answer that waits for a change comes without one in half of that.
const LOST: Duration = Duration::from_secs(10);

const ASKED: u8 = 0;
const TOLD: u8 = 1;
const NOT_TOLD: u8 = 2;

/// Shared by the writer's thread, which asks, for a step may not, and the component, which is answered.
#[derive(Default)]
pub(crate) struct Asking {
    stands: AtomicU8,
    /// Tag of the last answer.
    etag: Mutex<String>,
    /// The classes there are were told.
    classes: AtomicBool,
}

impl Asking {
    /// There are classes that no answer told of.
    pub(crate) fn want_classes(&self) {
        self.classes.store(false, Ordering::Relaxed);
    }

    /// An answer came; without an etag it was refused, or comes from a GCM that does not wait.
    pub(crate) fn answered(&self, etag: &str) {
        etag.clone_into(&mut self.etag.lock().unwrap_or_else(PoisonError::into_inner));
        self.stands.store(if etag.is_empty() { NOT_TOLD } else { TOLD }, Ordering::Release);
    }

    /// Asks if it is time to; `asked` is when it did last.
    pub(crate) fn look(&self, host: &Host, asked: &mut Option<Instant>) {
        let pause = match self.stands.load(Ordering::Acquire) {
            TOLD => SOON,
            NOT_TOLD => REFUSED,
            _ => LOST,
        };
        if asked.is_some_and(|asked| asked.elapsed() < pause) {
            return;
        }
        *asked = Some(Instant::now());
        // Before the question: its answer may be there before this thread goes on.
        self.stands.store(ASKED, Ordering::Release);
        // The list of classes is long: it is asked for without a tag, so that the answer comes at once.
        let classes = !self.classes.swap(true, Ordering::Relaxed);
        let etag = self.etag.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let etag = if classes { String::new() } else { etag };
        let fields = json!({ "brief": true, "classes": classes, "unless_etag": etag });
        if host.services().ask("List", fields).is_err() {
            self.want_classes();
            self.stands.store(NOT_TOLD, Ordering::Release);
        }
    }
}
