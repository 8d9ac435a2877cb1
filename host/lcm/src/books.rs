//! The books of one component: the timing of its steps, and counted misuse and loss, with the last reason of
//! those that come with one.
//!
//! Invariant: counting takes no lock that is waited for, and no memory: a step may do it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use trocar_model::plain::harmless;
use trocar_rt::timing::CycleStats;

/// An action of a component or its callers that was refused or went wrong: counted at once, reported by the
/// watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Misuse {
    /// One of its commands was called from a step that would have had to wait for it.
    AskedToWait,
    /// The component itself made such a call from its step.
    CalledFromStep,
    /// The component asked for a service from its step.
    ServiceFromStep,
    /// A thread of its device came in while another thread was inside.
    Overlap,
    /// One of its reads panicked. A read enters no instance, so none is distrusted: it is no FAULT.
    ReadPanicked,
    /// A read asked for from outside has not returned by its caller's deadline. As little a FAULT as a panic.
    ReadHung,
    /// One of its event handlers returned a failure.
    HandlerFailed,
    /// The component stamped a sample with a time in the future.
    StampedAhead,
}

impl Misuse {
    pub(crate) const ALL: [Misuse; 8] = [
        Misuse::AskedToWait,
        Misuse::CalledFromStep,
        Misuse::ServiceFromStep,
        Misuse::Overlap,
        Misuse::ReadPanicked,
        Misuse::ReadHung,
        Misuse::HandlerFailed,
        Misuse::StampedAhead,
    ];

    /// Index of the last reason, for a misuse that comes with one.
    fn words(self) -> Option<usize> {
        match self {
            Misuse::ReadPanicked => Some(0),
            Misuse::HandlerFailed => Some(1),
            Misuse::ReadHung => Some(2),
            Misuse::StampedAhead => Some(3),
            _ => None,
        }
    }

    /// True when plugin code went wrong and no instance could be blamed for it: an error, and no FAULT.
    pub(crate) fn is_error(self) -> bool {
        matches!(self, Misuse::ReadPanicked | Misuse::ReadHung)
    }

    /// Text of its warning, before the count.
    pub(crate) fn says(self) -> &'static str {
        match self {
            Misuse::AskedToWait => {
                "calls of its commands that would have had to wait inside a step were refused"
            }
            Misuse::CalledFromStep => {
                "its step called commands of another thread and would have had to wait: refused, use send"
            }
            Misuse::ServiceFromStep => "its step asked for services: refused, ask from a command or an event",
            Misuse::Overlap => {
                "threads of its device that came in while another thread was inside were turned away"
            }
            Misuse::ReadPanicked => "its reads panicked and their callers got FAILED",
            Misuse::ReadHung => "its reads did not come back in time and their callers got DEADLINE",
            Misuse::HandlerFailed => "its event handlers failed",
            Misuse::StampedAhead => {
                "samples were stamped with a time to come and count from when they were written: stamp with \
                 the host's clock"
            }
        }
    }
}

/// Bytes of a reason that are kept.
const LAST_WORDS_BYTES: usize = 160;

/// A reason, with its memory reserved from the beginning.
pub(crate) struct LastWords(Mutex<String>);

impl Default for LastWords {
    fn default() -> Self {
        LastWords(Mutex::new(String::with_capacity(LAST_WORDS_BYTES)))
    }
}

impl LastWords {
    /// Real-time.
    pub(crate) fn put(&self, text: &[u8]) {
        // The lock fails while another thread writes or reads a reason: skipped then.
        if let Ok(mut last) = self.0.try_lock() {
            let text = str::from_utf8(text)
                .unwrap_or_else(|e| str::from_utf8(&text[..e.valid_up_to()]).unwrap_or_default());
            last.clear();
            last.push_str(&text[..text.floor_char_boundary(LAST_WORDS_BYTES)]);
        }
    }

    pub(crate) fn get(&self) -> String {
        harmless(&self.0.lock().unwrap_or_else(PoisonError::into_inner)).into_owned()
    }
}

/// Counted misuse and loss, visible in GetState and Describe.
pub(crate) struct Books {
    /// Timing of its steps.
    pub(crate) steps: CycleStats,
    misuses: [AtomicU64; Misuse::ALL.len()],
    commands: AtomicU64,
    /// Commands and events lost in full queues of connections that are gone, and those that never ran before
    /// they were cut.
    lost_before: [AtomicU64; 2],
    /// Last reason of each misuse that comes with one.
    last_words: [LastWords; 4],
}

impl Books {
    /// Books of a component that steps with this period, ns; 0 without one.
    pub(crate) fn new(period_ns: u64) -> Books {
        Books {
            steps: CycleStats::new(period_ns),
            misuses: Default::default(),
            commands: AtomicU64::new(0),
            lost_before: Default::default(),
            last_words: Default::default(),
        }
    }

    /// Real-time.
    pub(crate) fn misuse(&self, what: Misuse) {
        self.misuses[what as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a misuse that comes with a reason. Real-time.
    pub(crate) fn failed(&self, what: Misuse, text: &[u8]) {
        self.failed_times(what, 1, text);
    }

    /// Counts a misuse so many times.
    pub(crate) fn failed_times(&self, what: Misuse, times: u64, text: &[u8]) {
        self.misuses[what as usize].fetch_add(times, Ordering::Relaxed);
        if let Some(last) = what.words().map(|at| &self.last_words[at]) {
            last.put(text);
        }
    }

    /// Last reason of `what`; `None` for a misuse without reasons.
    pub(crate) fn last_words(&self, what: Misuse) -> Option<String> {
        Some(self.last_words[what.words()?].get())
    }

    /// Only the holder of the entry lock counts, so load and store are enough.
    pub(super) fn command(&self) {
        self.commands.store(self.commands.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    }

    /// Counts of [`Misuse::ALL`] so far.
    pub(crate) fn misuses(&self) -> [u64; Misuse::ALL.len()] {
        Misuse::ALL.map(|what| self.misuses[what as usize].load(Ordering::Relaxed))
    }

    /// Counts so many commands, or events, of a queue that goes away: lost in it, or thrown out with it.
    pub(crate) fn lose(&self, events: bool, n: u64) {
        self.lost_before[usize::from(events)].fetch_add(n, Ordering::Relaxed);
    }

    pub(super) fn lost_before(&self) -> [u64; 2] {
        [0, 1].map(|i| self.lost_before[i].load(Ordering::Relaxed))
    }

    pub(crate) fn commands(&self) -> u64 {
        self.commands.load(Ordering::Relaxed)
    }
}
