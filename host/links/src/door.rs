//! Limits on the cost of strangers: how many there may be, and how often the log speaks of them.
//!
//! Invariant: however many come, the log has at most one line of each kind every [`QUIET_NS`], and that line
//! says how many there were.

/// Greetings of others that may be under way at once; one more takes the place of the oldest.
pub(crate) const MOST_GREETINGS: usize = 64;
/// Sessions that others began.
pub(crate) const MOST_GUESTS: usize = 512;
/// As above, of one process.
pub(crate) const MOST_OF_ONE: usize = 64;
/// Pause between two lines about the same, ns.
const QUIET_NS: u64 = 10_000_000_000;

/// Something that may happen very often and is worth a line now and then.
#[derive(Debug, Default)]
pub struct Seldom {
    /// No line before, ns.
    next_ns: u64,
    untold: u64,
}

impl Seldom {
    /// The line for it, when there is to be one now.
    pub(crate) fn line(&mut self, now_ns: u64, what: &str) -> Option<String> {
        if now_ns < self.next_ns {
            self.untold += 1;
            return None;
        }
        self.next_ns = now_ns + QUIET_NS;
        Some(match std::mem::take(&mut self.untold) {
            0 => what.to_owned(),
            untold => format!("{what} (and {untold} times before, since it was said last)"),
        })
    }

    /// Logs the line for it, when there is to be one now.
    pub fn warn(&mut self, now_ns: u64, what: &str) {
        if let Some(line) = self.line(now_ns, what) {
            log::warn!("{line}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_strangers_are_two_lines_and_both_say_the_truth() {
        let mut strangers = Seldom::default();
        let lines: Vec<String> =
            (0..1000u64).filter_map(|n| strangers.line(1 + n * 15_000_000, &format!("no {n}"))).collect();
        assert_eq!(lines, ["no 0", "no 667 (and 666 times before, since it was said last)"]);
    }
}
