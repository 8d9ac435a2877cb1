//! A moment, as the kernel counts threads: which threads came before it, and which after.
//!
//! Invariant: it is certain only where the kernel says its last number; elsewhere threads are compared by
//! their times.

use std::fs;

use trocar_rt::os;

/// Numbers of threads that began at about the same time differ by less than this; if they differ by more, the
/// kernel has reached its highest number and begun anew.
const NEAR: i32 = 1 << 14;
/// Times that are so near, ticks, count as equal: a thread has its number a moment before it begins.
const TICKS: u64 = 1;

/// A moment, as the kernel counts threads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Ticks since boot.
    pub(super) ticks: u64,
    /// The last number the kernel gave; `None` where it does not say.
    pub(super) last: Option<i32>,
}

impl Moment {
    pub(super) fn now() -> Moment {
        let last = last_number();
        Moment { ticks: os::boot_ticks(), last }
    }

    /// Tells whether it is certain that no thread was started since.
    pub(super) fn is_still_so(&self) -> bool {
        self.last.is_some() && self.last == last_number()
    }

    /// Tells whether a thread of this number and begin came after this moment.
    pub(super) fn is_before(&self, tid: i32, began: u64) -> bool {
        match self.last {
            Some(last) if began.abs_diff(self.ticks) <= TICKS => match tid - last {
                ahead if ahead > 0 => ahead < NEAR,
                behind => behind < -NEAR,
            },
            _ => began >= self.ticks,
        }
    }
}

/// The number that the kernel last gave to a thread or process; numbers go upwards, and begin anew at the
/// top.
fn last_number() -> Option<i32> {
    let text = fs::read_to_string("/proc/loadavg").ok()?;
    text.split_ascii_whitespace().nth(4)?.parse().ok().filter(|last| *last > 0)
}
