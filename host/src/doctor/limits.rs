//! The process's resource limits, read from `/proc/self/limits`.
//!
//! Invariant: a row that is missing or cannot be read is unknown, never a guess.

use std::fs;

/// One resource's soft and hard limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limit {
    /// Limit that holds now; `None` = unlimited.
    pub soft: Option<u64>,
    /// Limit up to which the process may raise it by itself; `None` = unlimited.
    pub hard: Option<u64>,
}

/// The limits that matter to a host; `None` = the kernel does not tell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// SCHED_FIFO priority.
    pub rt_priority: Option<Limit>,
    /// Locked memory, bytes.
    pub locked: Option<Limit>,
    /// Open files.
    pub files: Option<Limit>,
    /// Processes and threads of the user.
    pub threads: Option<Limit>,
}

impl Limits {
    /// The limits of this process.
    pub fn read() -> Self {
        Self::parse(&fs::read_to_string("/proc/self/limits").unwrap_or_default())
    }

    fn parse(text: &str) -> Self {
        let row = |name: &str| {
            let rest = text.lines().find_map(|line| line.strip_prefix(name))?;
            let mut words = rest.split_whitespace();
            Some(Limit { soft: value(words.next()?)?, hard: value(words.next()?)? })
        };
        Limits {
            rt_priority: row("Max realtime priority"),
            locked: row("Max locked memory"),
            files: row("Max open files"),
            threads: row("Max processes"),
        }
    }
}

/// `Some(None)` = unlimited.
fn value(word: &str) -> Option<Option<u64>> {
    if word == "unlimited" { Some(None) } else { word.parse().ok().map(Some) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_read_by_name_and_unknown_ones_stay_unknown() {
        let text = "Limit                     Soft Limit           Hard Limit           Units     \n\
                    Max processes             unlimited            unlimited            processes \n\
                    Max open files            1024                 524288               files     \n\
                    Max locked memory         8388608              8388608              bytes     \n";
        let limits = Limits::parse(text);
        assert_eq!(limits.files, Some(Limit { soft: Some(1024), hard: Some(524_288) }));
        assert_eq!(limits.locked, Some(Limit { soft: Some(8 << 20), hard: Some(8 << 20) }));
        assert_eq!(limits.threads, Some(Limit { soft: None, hard: None }));
        assert_eq!(limits.rt_priority, None);
        assert_eq!(Limits::parse("Max open files  many  1 files\n").files, None);
    }
}
