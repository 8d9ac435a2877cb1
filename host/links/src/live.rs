//! Tells whether the process at the other end still runs, judged from its heartbeat.
//!
//! Invariant: a process that is stopped is given up after [`STOPPED_NS`], one that merely gets no processor
//! after [`SILENT_NS`]; a process that got no processor itself judges no other.

use crate::session::Lost;

/// Distance of two heartbeats, ns.
pub(crate) const BEAT_NS: u64 = 10_000_000;
/// Silence after which a process that stands still is lost, ns: three beats.
pub(crate) const STOPPED_NS: u64 = 3 * BEAT_NS;
/// Silence after which any process is lost, ns. A busy machine keeps threads waiting for a tenth of that. The
/// kernel's mark and the socket tell that a process ended, not this silence.
pub(crate) const SILENT_NS: u64 = 300_000_000;

/// Heartbeat of one process, as far as this process knows it.
#[derive(Debug)]
pub(crate) struct Heart {
    /// The last beat that was seen.
    beat: u64,
    /// Time this process saw it first, ns.
    seen_ns: u64,
}

impl Heart {
    pub(crate) fn new(now_ns: u64) -> Heart {
        Heart { beat: 0, seen_ns: now_ns }
    }

    /// Looks at the heartbeat, every [`BEAT_NS`] or so; `late_ns` is how much later than that this look is.
    /// The kernel is asked about the process only when there was silence.
    pub(crate) fn look(
        &mut self,
        beat: u64,
        now_ns: u64,
        late_ns: u64,
        kernel_says: impl FnOnce() -> Option<Lost>,
    ) -> Option<Lost> {
        if beat != self.beat {
            self.beat = beat;
            self.seen_ns = now_ns;
            return None;
        }
        // Time this process slept through does not count as silence.
        self.seen_ns = (self.seen_ns + late_ns).min(now_ns);
        let silent_ns = now_ns - self.seen_ns;
        if silent_ns > SILENT_NS {
            return Some(Lost::Silent { ms: silent_ns / 1_000_000 });
        }
        if silent_ns >= STOPPED_NS { kernel_says() } else { None }
    }
}

/// Whether the kernel says that the process was stopped, or has ended and is no more than an entry.
pub(crate) fn kernel_says(pid: i32) -> Option<Lost> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The name stands in brackets and may hold anything.
    let state = stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().next());
    match state {
        Some("T" | "t") => Some(Lost::Stopped),
        Some("Z" | "X") => Some(Lost::Closed),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_stopped_process_is_lost_after_three_beats_and_a_slow_one_is_not() {
        let mut heart = Heart::new(0);
        assert_eq!(heart.look(1, 10 * MS, 0, || Some(Lost::Stopped)), None);
        assert_eq!(heart.look(1, 30 * MS, 0, || Some(Lost::Stopped)), None);
        assert_eq!(heart.look(1, 40 * MS, 0, || None), None);
        assert_eq!(heart.look(1, 40 * MS, 0, || Some(Lost::Stopped)), Some(Lost::Stopped));
    }

    #[test]
    fn silence_ends_it_after_a_while_whatever_the_kernel_says() {
        let mut heart = Heart::new(0);
        assert_eq!(heart.look(0, 300 * MS, 0, || None), None);
        assert_eq!(heart.look(0, 301 * MS, 0, || None), Some(Lost::Silent { ms: 301 }));
        assert_eq!(heart.look(9, 900 * MS, 0, || Some(Lost::Stopped)), None, "a beat is a beat");
    }

    #[test]
    fn who_slept_too_long_judges_nobody() {
        let mut heart = Heart::new(0);
        assert_eq!(heart.look(1, 10 * MS, 0, || Some(Lost::Stopped)), None);
        assert_eq!(heart.look(1, 2010 * MS, 1990 * MS, || Some(Lost::Stopped)), None);
        assert_eq!(heart.look(1, 2040 * MS, 0, || Some(Lost::Stopped)), Some(Lost::Stopped));
    }

    #[test]
    fn this_process_runs_and_one_that_does_not_exist_is_left_to_its_socket() {
        assert_eq!(kernel_says(std::process::id() as i32), None);
        assert_eq!(kernel_says(i32::MAX), None);
    }
}
