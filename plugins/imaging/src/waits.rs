//! Waits of threads beside the step: for files that have something, for the word to stop, and before a failed
//! device is opened again.
//!
//! Invariant: whatever a thread waits for here, the word to stop ends the wait.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec};
use trocar_sdk::Result;

/// When a device that failed is opened again: each time after twice as long, up to a limit; from the
/// beginning when it ran for longer than it last waited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Again {
    pub first: Duration,
    pub longest: Duration,
}

impl Again {
    /// From the settings `restart_delay_s` and `restart_delay_max_s`.
    ///
    /// # Errors
    /// The limit is below the first delay.
    pub fn of(restart: bool, first_s: f64, longest_s: f64) -> Result<Option<Again>> {
        if longest_s < first_s {
            return Err(format!(
                "restart_delay_max_s: {longest_s} s is below restart_delay_s, {first_s} s: raise it, or lower that"
            )
            .into());
        }
        let [first, longest] = [first_s, longest_s].map(Duration::from_secs_f64);
        Ok(restart.then_some(Again { first, longest }))
    }

    /// The wait that follows one of `last`, when the device then ran for so long.
    #[must_use]
    pub fn next(&self, last: Option<Duration>, ran: Duration) -> Duration {
        match last {
            Some(last) if ran <= last => (2 * last).min(self.longest),
            _ => self.first,
        }
    }
}

/// The word to stop, for a thread that sleeps in `poll`.
pub struct Stop {
    set: AtomicBool,
    wake: OwnedFd,
}

impl Stop {
    /// # Errors
    /// The process has no descriptor left for it.
    pub fn new() -> Result<Stop> {
        let wake = rustix::event::eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Stop { set: AtomicBool::new(false), wake })
    }

    /// Wakes the thread, for good.
    pub fn set(&self) {
        self.set.store(true, Ordering::Release);
        // A counter that is full wakes, too.
        let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
    }

    #[must_use]
    pub fn is_set(&self) -> bool {
        self.set.load(Ordering::Acquire)
    }

    /// Sleeps for a time, or until it is set; tells whether it is.
    pub fn wait(&self, time: Duration) -> bool {
        let begun = Instant::now();
        while !self.is_set() && begun.elapsed() < time {
            let _ = self.poll(&[], time.saturating_sub(begun.elapsed()));
        }
        self.is_set()
    }

    /// Sleeps until one of two files at most has something to read or has ended, the time is over, or it is
    /// set. Tells which files have.
    #[must_use]
    pub fn poll(&self, files: &[BorrowedFd<'_>], time: Duration) -> [bool; 2] {
        self.sleep(files, PollFlags::IN, time)
    }

    /// Sleeps until there is room to write into a file or it has ended, the time is over, or the word is set.
    /// Tells whether the file has.
    #[must_use]
    pub fn poll_room(&self, file: BorrowedFd<'_>, time: Duration) -> bool {
        self.sleep(&[file], PollFlags::OUT, time)[0]
    }

    fn sleep(&self, files: &[BorrowedFd<'_>], wanted: PollFlags, time: Duration) -> [bool; 2] {
        let time = Timespec::try_from(time).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
        let none = self.wake.as_fd();
        let file = |at: usize| match files.get(at) {
            Some(file) => PollFd::from_borrowed_fd(*file, wanted),
            None => PollFd::from_borrowed_fd(none, PollFlags::IN),
        };
        let mut all = [PollFd::from_borrowed_fd(none, PollFlags::IN), file(0), file(1)];
        // An interrupted poll comes back as one without news.
        let _ = rustix::event::poll(&mut all, Some(&time));
        [1, 2].map(|at| files.len() >= at && !all[at].revents().is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_limit_and_begin_anew_after_a_run_that_was_longer() {
        let again = Again { first: Duration::from_secs(1), longest: Duration::from_secs(5) };
        let mut waits = Vec::new();
        let mut last = None;
        for ran_s in [100, 0, 0, 0, 0, 4, 6, 0] {
            last = Some(again.next(last, Duration::from_secs(ran_s)));
            waits.push(last.map_or(0, |wait| wait.as_secs()));
        }
        assert_eq!(waits, [1, 2, 4, 5, 5, 5, 1, 2]);
        assert!(
            Again::of(true, 2.0, 1.0).is_err_and(|why| why.to_string().contains("below restart_delay_s"))
        );
        assert_eq!(Again::of(false, 1.0, 5.0).ok(), Some(None));
    }
}
