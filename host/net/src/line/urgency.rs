//! The real-time priority of the threads of the prompt lane: callers wait for them, and a lane that is
//! silent for long is lost.
//!
//! Invariant: whatever the other end sends, a thread that used more than half of a processor goes on as
//! others do for a while, so that nothing else here stands still for it.

use std::sync::Once;

use trocar_rt::os::{now_ns, set_fifo, set_normal, thread_id, thread_ran_ns};

use super::Lane;

/// Components have a higher one where they have deadlines.
const PRIORITY: u8 = 30;
/// Time between two looks at what the thread used, ns.
const LOOK_NS: u64 = 100_000_000;
/// Time without priority for a thread that used too much, ns.
const REST_NS: u64 = 1_000_000_000;

/// The priority of the calling thread, by what it uses of its processor.
pub(super) struct Urgency {
    /// Kernel id; `None`: it has no priority, and gets none.
    thread: Option<i32>,
    is_urgent: bool,
    /// Begin of this stretch of time, and what the thread had used by then.
    since_ns: u64,
    ran_ns: u64,
}

impl Urgency {
    /// Makes the calling thread a real-time one, where its lane needs that and the machine allows it. Threads
    /// it starts later would be, too.
    pub(super) fn take(lane: Lane) -> Urgency {
        let is_urgent = lane == Lane::Prompt && is_granted();
        let thread = is_urgent.then(thread_id);
        let mut urgency = Urgency { thread, is_urgent, since_ns: now_ns(), ran_ns: 0 };
        urgency.ran_ns = urgency.used_ns();
        urgency
    }

    fn used_ns(&self) -> u64 {
        self.thread.and_then(thread_ran_ns).unwrap_or(0)
    }

    /// Looks at what the thread used, again and again.
    pub(super) fn look(&mut self, now_ns: u64) {
        let due_ns = if self.is_urgent { LOOK_NS } else { REST_NS };
        let passed_ns = now_ns.saturating_sub(self.since_ns);
        if self.thread.is_none() || passed_ns < due_ns {
            return;
        }
        let used_ns = self.used_ns();
        let before = std::mem::replace(&mut self.ran_ns, used_ns);
        self.since_ns = now_ns;
        let too_much = self.is_urgent && used_ns.saturating_sub(before) > passed_ns / 2;
        if too_much == self.is_urgent {
            let changed = if too_much { set_normal() } else { set_fifo(PRIORITY) };
            // Refused: it stays as it is, and is looked at again.
            self.is_urgent = changed.is_ok() != self.is_urgent;
        }
    }
}

/// Tells whether the calling thread has the priority now; a refusal is told once.
fn is_granted() -> bool {
    static TOLD: Once = Once::new();
    let granted = set_fifo(PRIORITY);
    if let Err(e) = &granted {
        TOLD.call_once(|| log::info!("lines to other machines have no real-time priority: {e}"));
    }
    granted.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Time of a watchdog, not a claim.
    const PATIENCE_NS: u64 = 30_000_000_000;

    #[test]
    fn a_thread_that_uses_all_of_its_processor_rests_and_comes_again() {
        let all = std::thread::spawn(|| {
            let mut urgency = Urgency::take(Lane::Prompt);
            if urgency.thread.is_none() {
                return;
            }
            let until_ns = now_ns() + PATIENCE_NS;
            let mut seen = vec![true];
            while seen.len() < 3 {
                // Computing time passes.
                urgency.look(now_ns());
                if seen.last() != Some(&urgency.is_urgent) {
                    seen.push(urgency.is_urgent);
                }
                assert!(now_ns() < until_ns, "{seen:?}");
            }
            assert_eq!(seen, [true, false, true]);
        });
        assert!(all.join().is_ok());
    }

    #[test]
    fn a_thread_that_mostly_waits_keeps_its_priority_and_one_of_the_bulk_lane_has_none() {
        let all = std::thread::spawn(|| {
            assert!(Urgency::take(Lane::Bulk).thread.is_none());
            let mut urgency = Urgency::take(Lane::Prompt);
            let was = urgency.is_urgent;
            // As if seconds had passed.
            for n in 1..50 {
                urgency.look(urgency.since_ns + n * LOOK_NS);
            }
            assert_eq!(urgency.is_urgent, was);
        });
        assert!(all.join().is_ok());
    }
}
