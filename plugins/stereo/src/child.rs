//! A child process that writes raw frames to its standard output, such as ffmpeg.
//!
//! Invariant: the thread that started a child is the only one that ends it, before its end is collected, so no other process is
//! ever hit; the whole process group goes, also what the child started itself, and also when this process is killed: a watcher
//! in the group ends it when a pipe from here closes. Nothing here waits for ever, not for a child that cannot be ended either.

use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use trocar_sdk::environment;
use trocar_sdk::prelude::log;

use crate::feed::{Giver, Source, Stop};

/// How long a child that has closed its output may take to end.
const TO_END: Duration = Duration::from_millis(500);
/// How long a killed child may take to be gone.
const TO_DIE: Duration = Duration::from_secs(2);
/// Runs the program in the shell's own place, with a watcher beside it in the same group: as soon as the pipe that is the shell's
/// input closes, because this process has ended however it did, the watcher ends the group. The program has none of this.
const TIED: &str = "exec 3<&0 </dev/null; (read -r end <&3; kill -KILL 0) >/dev/null 2>&1 & exec \"$@\" 3<&-";
/// What is kept of a child's last words, bytes.
const LAST_WORDS: usize = 512;

/// What to run.
pub(crate) struct Program {
    /// Program and arguments; no shell looks at them.
    pub(crate) command: Vec<String>,
    /// A child that does not complete a frame for so long has stalled.
    pub(crate) stall: Duration,
    /// From exposure to the last byte of a frame, s.
    pub(crate) delay_s: f64,
}

/// A running child; dropped, it is ended.
pub(crate) struct Running {
    child: Child,
    out: ChildStdout,
    err: ChildStderr,
    /// What the watcher listens to; it ends the group when this is closed.
    _tie: ChildStdin,
    collected: bool,
}

impl Program {
    fn name(&self) -> &str {
        self.command.first().map_or("", String::as_str)
    }
}

impl Source for Program {
    type Session = Running;

    fn open(&self) -> Result<Running, String> {
        let (program, arguments) = self.command.split_first().ok_or("command: is empty; name a program")?;
        let refused = |why: &dyn std::fmt::Display| {
            format!("command: {program} cannot be started: {why}; is it installed, is its name right?")
        };
        let path = find(program).map_err(|why| refused(&why))?;
        let mut child = tied(&path, arguments).spawn().map_err(|why| refused(&why))?;
        match (child.stdin.take(), child.stdout.take(), child.stderr.take()) {
            (Some(tie), Some(out), Some(err)) => Ok(Running { child, out, err, _tie: tie, collected: false }),
            _ => Err(format!("command: {program} has no output")),
        }
    }

    fn pump(&self, mut running: Running, giver: &mut Giver, stop: &Stop) -> String {
        let (mut filled, mut frames) = (0, 0u64);
        let (mut words, mut talks) = (Vec::new(), true);
        // Of the frame: a child that writes a byte now and then has stalled, too.
        let mut begun = Instant::now();
        loop {
            let left = self.stall.saturating_sub(begun.elapsed());
            if left.is_zero() {
                let (name, stall) = (self.name(), self.stall.as_secs_f64());
                let wrote = if filled == 0 { "nothing".into() } else { format!("{filled} B of a frame") };
                let end = match running.end() {
                    Ok(_) => "it was ended".into(),
                    Err(why) => why,
                };
                return format!("{name} stalled: it wrote {wrote} in {stall} s after {frames} frames; {end}");
            }
            let files = [running.out.as_fd(), running.err.as_fd()];
            let [out, err] = stop.poll(&files[..if talks { 2 } else { 1 }], left);
            if stop.is_set() {
                return String::new();
            }
            if err {
                talks = hear(&mut running.err, &mut words);
            }
            if !out {
                continue;
            }
            let room = giver.room().get_mut(filled..).unwrap_or_default();
            match running.out.read(room) {
                Ok(0) => break,
                Ok(more) => filled += more,
                Err(why) if why.kind() == std::io::ErrorKind::Interrupted => {}
                Err(why) => return format!("{}: its output cannot be read: {why}", self.name()),
            }
            if filled == giver.room().len() {
                giver.give(self.delay_s);
                (filled, frames, begun) = (0, frames + 1, Instant::now());
            }
        }
        while talks && stop.poll(&[running.err.as_fd()], Duration::ZERO)[0] {
            talks = hear(&mut running.err, &mut words);
        }
        let status = running.ended();
        let rest = if filled > 0 { format!(" and {filled} B of the next") } else { String::new() };
        let words = last_line(&words);
        let name = self.name();
        match status {
            Ok(Some(status)) => format!("{name} ended ({status}) after {frames} frames{rest}{words}"),
            Ok(None) => format!("{name} closed its output after {frames} frames{rest}; it was ended{words}"),
            Err(why) => format!("{name} closed its output after {frames} frames{rest}; {why}{words}"),
        }
    }
}

impl Running {
    /// How it ended, when it does so soon; what it started is ended in any case.
    ///
    /// # Errors
    /// As [`Running::end`].
    fn ended(&mut self) -> Result<Option<ExitStatus>, String> {
        let by_itself = self.is_over_within(TO_END);
        self.end().map(|status| status.filter(|_| by_itself))
    }

    /// Ends the whole group and collects the child; nothing the second time.
    ///
    /// # Errors
    /// It does not die, or may not be ended: a sentence about it. It is left alone then.
    fn end(&mut self) -> Result<Option<ExitStatus>, String> {
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

    /// Whether it ends within a time. Looked at without collecting it: until then its number is nobody else's.
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

impl Drop for Running {
    fn drop(&mut self) {
        if let Err(why) = self.end() {
            log::warn!("{why}");
        }
    }
}

/// The program as a group of its own that does not outlive this process.
fn tied(program: &Path, arguments: &[String]) -> Command {
    let mut command = Command::new("/bin/sh");
    environment::give_to(&mut command);
    command.args(["-c", TIED, "sh"]).arg(program).args(arguments);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
    command
}

/// Where a program is: asked before the shell is, so that a missing one is refused at once.
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

/// Takes what the child says besides; false when it will say no more.
fn hear(err: &mut ChildStderr, words: &mut Vec<u8>) -> bool {
    let mut said = [0; LAST_WORDS];
    let Ok(more @ 1..) = err.read(&mut said) else { return false };
    words.extend_from_slice(&said[..more]);
    let too_many = words.len().saturating_sub(LAST_WORDS);
    words.drain(..too_many);
    true
}

/// ": what it said last", or nothing.
fn last_line(words: &[u8]) -> String {
    let words = String::from_utf8_lossy(words);
    let line = words.lines().rev().map(str::trim).find(|line| !line.is_empty());
    line.map_or_else(String::new, |line| format!(": {line}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_and_what_it_started_end_when_this_process_does_without_a_word() {
        let line = ["-c", "sleep 1000 & echo $!; exec sleep 1000"].map(str::to_owned);
        let mut child = tied(Path::new("/bin/sh"), &line).spawn().expect("a shell");
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
        let mut child = tied(Path::new("/bin/sh"), &arguments).spawn().expect("a shell");
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
}
