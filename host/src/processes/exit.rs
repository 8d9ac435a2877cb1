//! The end of a process, in words.

use std::fmt;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// End of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Exit {
    Code(i32),
    /// The process served, and said why it had to end.
    Because {
        code: i32,
        why: String,
    },
    Signal {
        number: i32,
        core: bool,
    },
    /// The process never ran: the reason.
    NotStarted(String),
    /// The process was killed by its keeper: the reason.
    Killed(String),
    /// The process was killed and is still there: the reason for the kill.
    Stuck(String),
    /// The process was to end, and its machine does not answer: the reason.
    Away(String),
}

/// Signals by number, as Linux numbers them on x86-64 and aarch64.
const SIGNALS: [&str; 31] = [
    "SIGHUP",
    "SIGINT",
    "SIGQUIT",
    "SIGILL",
    "SIGTRAP",
    "SIGABRT",
    "SIGBUS",
    "SIGFPE",
    "SIGKILL",
    "SIGUSR1",
    "SIGSEGV",
    "SIGUSR2",
    "SIGPIPE",
    "SIGALRM",
    "SIGTERM",
    "SIGSTKFLT",
    "SIGCHLD",
    "SIGCONT",
    "SIGSTOP",
    "SIGTSTP",
    "SIGTTIN",
    "SIGTTOU",
    "SIGURG",
    "SIGXCPU",
    "SIGXFSZ",
    "SIGVTALRM",
    "SIGPROF",
    "SIGWINCH",
    "SIGIO",
    "SIGPWR",
    "SIGSYS",
];

impl Exit {
    /// Tells whether the process ended as one that was asked to, if it was: 130 says that it did not serve
    /// yet.
    pub fn is_orderly(&self) -> bool {
        matches!(self, Exit::Code(0 | 130))
    }
}

impl From<ExitStatus> for Exit {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Exit::Code(code),
            (None, Some(number)) => Exit::Signal { number, core: status.core_dumped() },
            (None, None) => Exit::NotStarted(status.to_string()),
        }
    }
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Exit::Code(code) => write!(f, "ended with code {code}"),
            Exit::Because { code, why } => write!(f, "ended with code {code}: {why}"),
            Exit::Signal { number, core } => {
                match usize::try_from(number - 1).ok().and_then(|at| SIGNALS.get(at)) {
                    Some(name) => write!(f, "was killed by {name}")?,
                    None => write!(f, "was killed by signal {number}")?,
                }
                if *core { f.write_str(" (core dumped)") } else { Ok(()) }
            }
            Exit::NotStarted(why) => write!(f, "could not be started: {why}"),
            Exit::Killed(why) => write!(f, "{why} and was killed"),
            Exit::Stuck(why) => write!(f, "{why}, was killed and is still not gone"),
            Exit::Away(why) => write!(f, "may still run: {why}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_reads_as_a_person_would_say_it() {
        let exits = [
            Exit::Code(3),
            Exit::Because { code: 1, why: "the process cannot go on".into() },
            Exit::from(ExitStatus::from_raw(11)),
            Exit::from(ExitStatus::from_raw(0x86)),
            Exit::from(ExitStatus::from_raw(9)),
            Exit::from(ExitStatus::from_raw(35)),
            Exit::NotStarted("no such file".into()),
            Exit::Killed("did not serve within 30 s".into()),
            Exit::Stuck("did not end within 12 s".into()),
        ];
        let said: Vec<String> = exits.iter().map(ToString::to_string).collect();
        let wanted = [
            "ended with code 3",
            "ended with code 1: the process cannot go on",
            "was killed by SIGSEGV",
            "was killed by SIGABRT (core dumped)",
            "was killed by SIGKILL",
            "was killed by signal 35",
            "could not be started: no such file",
            "did not serve within 30 s and was killed",
            "did not end within 12 s, was killed and is still not gone",
        ];
        assert_eq!(said, wanted);
        assert!(Exit::from(ExitStatus::from_raw(0)).is_orderly() && !Exit::Code(1).is_orderly());
        assert!(!Exit::Killed(String::new()).is_orderly());
    }
}
