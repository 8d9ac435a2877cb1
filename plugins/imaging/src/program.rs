//! Child programs of a component: started, listened to and ended.
//!
//! Invariant: the thread that started a program is the only one that ends it, before its end is collected, so
//! no other process is ever hit; the whole process group goes, also what the program started itself, and also
//! when this process is killed: a watcher in the group ends it when a pipe from here closes. Nothing here
//! waits for ever, not for a program that cannot be ended either.

use std::fmt::Display;
use std::io::Read;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use trocar_sdk::{environment, log};

use crate::waits::Stop;

/// Time for a program that has closed its output to end.
const TO_END: Duration = Duration::from_millis(500);
/// Time for a killed program to be gone.
const TO_DIE: Duration = Duration::from_secs(2);
/// Runs the program in the shell's own place, with a watcher beside it in the same group: as soon as the pipe
/// that is the shell's input closes, because this process has ended however it did, the watcher ends the
/// group. The program has none of this.
const TIED: &str = "exec 3<&0 </dev/null; (read -r end <&3; kill -KILL 0) >/dev/null 2>&1 & exec \"$@\" 3<&-";
/// As [`TIED`], for a program that is written to: the watcher's pipe is the shell's output, and the program's
/// goes to its errors.
const FED: &str = "exec 3<&1 >&2; (read -r end <&3; kill -KILL 0) >/dev/null 2>&1 & exec \"$@\" 3<&-";
/// Bytes kept of a program's last words.
const LAST_WORDS: usize = 512;
/// Bytes that are taken of its words at once; what a pipe holds.
const AT_ONCE: usize = 65_536;

/// A program that runs; dropped, it is ended.
pub struct Running<Way> {
    child: Child,
    /// Its output, or its input.
    pub way: Way,
    /// Its error output.
    pub err: ChildStderr,
    words: Vec<u8>,
    /// The watcher listens to it, and ends the group when it is closed.
    _tie: OwnedFd,
    collected: bool,
}

/// Runs a program whose output is read; no shell looks at its arguments. `setting` is what a refusal names.
///
/// # Errors
/// The program is not there, or cannot be started: a sentence.
pub fn listened_to(setting: &str, command: &[String]) -> Result<Running<ChildStdout>, String> {
    let mut child = start(setting, command, |path, arguments| {
        tied(TIED, path, arguments, Stdio::piped(), Stdio::piped())
    })?;
    match (child.stdin.take(), child.stdout.take(), child.stderr.take()) {
        (Some(tie), Some(way), Some(err)) => {
            Ok(Running { child, way, err, words: Vec::new(), _tie: tie.into(), collected: false })
        }
        _ => Err(format!("{setting}: the program has no output")),
    }
}

/// Runs a program that is written to; what it prints is among its words.
///
/// # Errors
/// As [`listened_to`].
pub fn written_to(setting: &str, command: &[String]) -> Result<Running<Option<ChildStdin>>, String> {
    let (watched, tie) =
        std::io::pipe().map_err(|why| format!("{setting}: there is no pipe for it: {why}"))?;
    let mut child = start(setting, command, |path, arguments| {
        tied(FED, path, arguments, Stdio::piped(), watched.into())
    })?;
    match (child.stdin.take(), child.stderr.take()) {
        (way @ Some(_), Some(err)) => {
            Ok(Running { child, way, err, words: Vec::new(), _tie: tie.into(), collected: false })
        }
        _ => Err(format!("{setting}: the program has no input")),
    }
}

fn start(
    setting: &str,
    command: &[String],
    made: impl FnOnce(&Path, &[String]) -> Command,
) -> Result<Child, String> {
    let (program, arguments) =
        command.split_first().ok_or_else(|| format!("{setting}: is empty; name a program"))?;
    let refused = |why: &dyn Display| {
        format!("{setting}: {program} cannot be started: {why}; is it installed, is its name right?")
    };
    let path = find(program).map_err(|why| refused(&why))?;
    made(&path, arguments).spawn().map_err(|why| refused(&why))
}

impl Running<Option<ChildStdin>> {
    /// Closes its input, and gives it a moment to end by itself.
    ///
    /// # Errors
    /// As [`Running::end`].
    pub fn finish(&mut self) -> Result<Option<ExitStatus>, String> {
        self.way = None;
        self.ended()
    }
}

impl<Way> Running<Way> {
    /// Takes what the program says besides; false when it will say no more.
    pub fn hear(&mut self) -> bool {
        self.take_words() > 0
    }

    /// Takes what it has said besides, without waiting for more; false when it will say no more. One that
    /// says more and more is left after 64 KiB, and any at the word to stop.
    pub fn hear_out(&mut self, stop: &Stop) -> bool {
        let mut heard = 0;
        while heard < AT_ONCE && !stop.is_set() && stop.poll(&[self.err.as_fd()], Duration::ZERO)[0] {
            match self.take_words() {
                0 => return false,
                more => heard += more,
            }
        }
        true
    }

    fn take_words(&mut self) -> usize {
        let mut said = [0; LAST_WORDS];
        let more = self.err.read(&mut said).unwrap_or(0);
        self.words.extend_from_slice(&said[..more]);
        let too_many = self.words.len().saturating_sub(LAST_WORDS);
        self.words.drain(..too_many);
        more
    }

    /// ": its last words", or nothing.
    #[must_use]
    pub fn last_words(&self) -> String {
        let words = String::from_utf8_lossy(&self.words);
        let line = words.lines().rev().map(str::trim).find(|line| !line.is_empty());
        line.map_or_else(String::new, |line| format!(": {line}"))
    }

    /// Its exit status, when it ends soon; all that it started is ended in any case.
    ///
    /// # Errors
    /// As [`Running::end`].
    pub fn ended(&mut self) -> Result<Option<ExitStatus>, String> {
        let by_itself = self.is_over_within(TO_END);
        self.end().map(|status| status.filter(|_| by_itself))
    }

    /// Ends the whole group and collects the child; nothing the second time.
    ///
    /// # Errors
    /// The program does not die, or may not be ended: a sentence about it. It is left alone then.
    pub fn end(&mut self) -> Result<Option<ExitStatus>, String> {
        let Some(group) = self.pid().filter(|_| !self.collected) else { return Ok(None) };
        self.collected = true;
        let killed = kill_process_group(group, Signal::KILL);
        // One that this user may not end has perhaps ended by itself, of its broken pipe.
        if self.is_over_within(TO_DIE) {
            return Ok(self.child.wait().ok());
        }
        let pid = group.as_raw_nonzero();
        Err(match killed {
            Ok(()) => {
                format!("process {pid} does not die within {} s: it waits in the kernel", TO_DIE.as_secs())
            }
            Err(why) => format!("process {pid} cannot be ended: {why}"),
        })
    }

    /// Whether it ends within a time. Looked at without collecting it: until then its number is nobody
    /// else's.
    fn is_over_within(&self, time: Duration) -> bool {
        let begun = Instant::now();
        let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        loop {
            match self.pid().map(|pid| waitid(WaitId::Pid(pid), look)) {
                Some(Ok(None)) if begun.elapsed() < time => std::thread::sleep(Duration::from_millis(2)),
                Some(Ok(Some(_))) => return true,
                _ => return false,
            }
        }
    }

    fn pid(&self) -> Option<Pid> {
        Pid::from_raw(self.child.id().cast_signed())
    }
}

impl<Way> Drop for Running<Way> {
    fn drop(&mut self) {
        if let Err(why) = self.end() {
            log::warn!("{why}");
        }
    }
}

/// The program as a group of its own that does not outlive this process.
fn tied(script: &str, program: &Path, arguments: &[String], input: Stdio, output: Stdio) -> Command {
    let mut command = Command::new("/bin/sh");
    environment::give_to(&mut command);
    command.args(["-c", script, "sh"]).arg(program).args(arguments);
    command.stdin(input).stdout(output).stderr(Stdio::piped()).process_group(0);
    command
}

/// The path of a program: asked before the shell is, so that a missing one is refused at once.
fn find(program: &str) -> std::io::Result<PathBuf> {
    let is_there = |path: &Path| -> std::io::Result<()> {
        let about = std::fs::metadata(path)?;
        let runs = about.is_file() && about.permissions().mode() & 0o111 != 0;
        if runs { Ok(()) } else { Err(std::io::ErrorKind::PermissionDenied.into()) }
    };
    if program.contains('/') {
        return is_there(Path::new(program)).map(|()| program.into());
    }
    let paths = environment::var_at_start("PATH").unwrap_or_default();
    let mut all = std::env::split_paths(&paths).map(|folder| folder.join(program));
    // The system's own words for it.
    all.find(|path| is_there(path).is_ok()).ok_or_else(|| rustix::io::Errno::NOENT.into())
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn piped(arguments: &[String]) -> Command {
        tied(TIED, Path::new("/bin/sh"), arguments, Stdio::piped(), Stdio::piped())
    }

    #[test]
    fn a_program_and_what_it_started_end_when_this_process_does_without_a_word() {
        let line = ["-c", "sleep 1000 & echo $!; exec sleep 1000"].map(str::to_owned);
        let mut child = piped(&line).spawn().expect("a shell");
        let mut said = [0; 16];
        let more = child.stdout.as_mut().expect("piped").read(&mut said).expect("it writes");
        let started = String::from_utf8_lossy(&said[..more]).trim().to_owned();
        // All that happens when a process is killed, as far as its children can see.
        drop(child.stdin.take());
        let status = child.wait().expect("ours");
        assert_eq!(std::os::unix::process::ExitStatusExt::signal(&status), Some(9));
        let stat = || std::fs::read_to_string(format!("/proc/{started}/stat")).unwrap_or_default();
        let mut watchdog = crate::watchdog::Watchdog::of("what it started ends");
        while stat().rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['Z', 'X']))
        {
            watchdog.saw(format_args!("{started} lives on"));
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_program_has_no_input_and_gets_its_arguments_as_they_are() {
        let arguments = ["-c", "read x || printf '%s|' \"$@\"", "me", "a b", "$HOME", "'"].map(str::to_owned);
        let mut child = piped(&arguments).spawn().expect("a shell");
        let _tie = child.stdin.take();
        let output = child.wait_with_output().expect("it ends");
        assert_eq!(String::from_utf8_lossy(&output.stdout), "a b|$HOME|'|");
    }

    #[test]
    fn programs_are_found_as_a_shell_finds_them() {
        assert!(find("sh").is_ok_and(|path| path.ends_with("sh") && path.is_absolute()));
        assert_eq!(find("/bin/sh").ok(), Some("/bin/sh".into()));
        assert!(find("no-such-program").is_err_and(|why| why.kind() == std::io::ErrorKind::NotFound));
        assert!(find("/etc/passwd").is_err_and(|why| why.kind() == std::io::ErrorKind::PermissionDenied));
    }

    #[test]
    fn a_program_that_is_written_to_reads_it_all_and_its_words_are_heard() {
        let command = ["sh", "-c", "read a; echo got $a; read b || echo end"].map(str::to_owned);
        let mut running = written_to("program", &command).expect("a shell");
        running.way.as_mut().expect("open").write_all(b"one\n").expect("it reads");
        while running.last_words() != ": got one" {
            assert!(running.hear(), "{}", running.last_words());
        }
        let status = running.finish().expect("it may be ended");
        let stop = Stop::new().expect("a descriptor");
        stop.set();
        assert!(running.hear_out(&stop));
        assert_eq!(running.last_words(), ": got one", "a thread that is to end hears no more");
        // Its end comes by a pipe, which may be later than its status.
        while running.hear_out(&Stop::new().expect("a descriptor")) {}
        assert_eq!((status.and_then(|s| s.code()), running.last_words().as_str()), (Some(0), ": end"));
    }
}
