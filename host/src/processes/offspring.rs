//! Programs that a child started and left behind, in any session: found by a mark in their environment.
//!
//! Invariant: only programs with this child's mark are killed, through a handle that was opened before the
//! mark was read, so never a program that got the number of an ended one.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use rustix::process::{Pid, PidfdFlags, Signal, getpid, pidfd_open, pidfd_send_signal};

/// The variable in the environment of a child and of its programs.
const VARIABLE: &str = "TROCAR_KEPT";
/// Looks for programs that were started while others were being killed.
const LOOKS: usize = 16;

/// Tells whether a process has a keeper, which starts it again.
pub(crate) fn is_kept(pid: u32) -> bool {
    let environment = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
    let names = |one: &[u8]| one.strip_prefix(VARIABLE.as_bytes()).is_some_and(|rest| rest.starts_with(b"="));
    environment.split(|byte| *byte == 0).any(names)
}

/// A mark that no other child of this keeper or another has.
#[derive(Clone, Debug)]
pub(super) struct Mark(String);

impl Mark {
    pub(super) fn new() -> Mark {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        let (keeper, number) = (getpid().as_raw_nonzero(), NEXT.fetch_add(1, Ordering::Relaxed));
        Mark(format!("{keeper}-{number}-{since:x}"))
    }

    /// Returns the mark as it stands in the environment.
    pub(super) fn variable(&self) -> (&'static str, &str) {
        (VARIABLE, &self.0)
    }

    /// Kills all programs with this mark, and those they start meanwhile. Reads files: not for a thread that
    /// others wait for.
    pub(super) fn kill_all(&self) {
        for _ in 0..LOOKS {
            let killed = pids().filter(|pid| self.kills(*pid)).count();
            if killed == 0 {
                return;
            }
            log::warn!("{killed} programs that a process left behind are killed");
        }
    }

    fn kills(&self, pid: Pid) -> bool {
        // A process that is gone, or is another user's, cannot be opened or read.
        let Ok(handle) = pidfd_open(pid, PidfdFlags::empty()) else { return false };
        let environment = fs::read(format!("/proc/{}/environ", pid.as_raw_nonzero())).unwrap_or_default();
        self.is_in(&environment) && pidfd_send_signal(&handle, Signal::KILL).is_ok()
    }

    fn is_in(&self, environment: &[u8]) -> bool {
        let wanted: OsString = [OsStr::new(VARIABLE), OsStr::new(&self.0)].join(OsStr::new("="));
        environment.split(|byte| *byte == 0).any(|one| one == wanted.as_bytes())
    }
}

fn pids() -> impl Iterator<Item = Pid> {
    let there = fs::read_dir("/proc").into_iter().flatten().flatten();
    there.filter_map(|entry| entry.file_name().to_str()?.parse().ok().and_then(Pid::from_raw))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn what_has_the_mark_is_killed_whatever_session_it_is_in_and_nobody_else() {
        let (mark, other) = (Mark::new(), Mark::new());
        let begin = |mark: &Mark, script: &str| {
            let (name, value) = mark.variable();
            let mut program = Command::new("sh");
            let mut child =
                program.args(["-c", script]).env(name, value).stdout(Stdio::piped()).spawn().unwrap();
            let mut out = BufReader::new(child.stdout.take().unwrap());
            let mut line = String::new();
            out.read_line(&mut line).unwrap();
            (child, out)
        };
        // The program ends and leaves one in a session of its own, which holds the output open.
        let (mut left, mut out) = begin(&mark, "setsid sh -c 'echo here; exec sleep 60' & wait");
        let (mut neighbour, _out) = begin(&other, "echo here; exec sleep 60");
        mark.kill_all();
        assert_eq!(left.wait().unwrap().signal(), Some(9));
        let mut rest = String::new();
        std::io::Read::read_to_string(&mut out, &mut rest).unwrap();
        assert!(neighbour.try_wait().unwrap().is_none(), "another child's");
        other.kill_all();
        assert_eq!(neighbour.wait().unwrap().signal(), Some(9));
    }

    #[test]
    fn a_mark_is_no_part_of_another_one() {
        let mark = Mark("12-3-4".to_owned());
        assert!(mark.is_in(b"A=1\0TROCAR_KEPT=12-3-4\0"));
        for other in [&b"TROCAR_KEPT=12-3-45\0"[..], b"XTROCAR_KEPT=12-3-4\0", b"TROCAR_KEPT=2-3-4\0", b""] {
            assert!(!mark.is_in(other), "{}", String::from_utf8_lossy(other));
        }
    }
}
