//! Punctuality of this machine's thread wake-ups: a bare loop of absolute deadlines, nothing of trocar in it.
//!
//! Invariant: the loop makes the same call that the executors sleep with, so the figures are the floor of
//! every component's lateness.

use std::thread;

use trocar_rt::os;

/// Lateness of wakes, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Lateness {
    pub(super) p50_ns: u64,
    pub(super) p99_ns: u64,
    pub(super) max_ns: u64,
}

/// Sleeps `cycles` times until the next of the deadlines `period_ns` apart, at `priority` where
/// it is granted.
pub(super) fn lateness(cycles: usize, period_ns: u64, priority: Option<u8>) -> Option<Lateness> {
    let thread = thread::Builder::new().name("doctor".into()).spawn(move || {
        // Refused settings are other findings; here only the times count.
        let _ = os::set_timer_slack_ns(1);
        if let Some(priority) = priority {
            let _ = os::set_fifo(priority);
        }
        let begin = os::now_ns() + period_ns;
        let mut late: Vec<u64> = (0..cycles as u64)
            .map(|n| begin + n * period_ns)
            .map(|deadline| {
                os::sleep_until(deadline);
                os::now_ns().saturating_sub(deadline)
            })
            .collect();
        late.sort_unstable();
        late
    });
    let late = thread.ok()?.join().ok()?;
    let at = |share: usize| late.get((late.len() * share / 100).min(late.len().saturating_sub(1))).copied();
    Some(Lateness { p50_ns: at(50)?, p99_ns: at(99)?, max_ns: at(100)? })
}

/// Cost of one reading of the clock, ns.
pub(super) fn clock_ns() -> f64 {
    const READS: u64 = 20_000;
    let begin = os::now_ns();
    let mut last = begin;
    for _ in 0..READS {
        last = os::now_ns();
    }
    last.saturating_sub(begin) as f64 / READS as f64
}
