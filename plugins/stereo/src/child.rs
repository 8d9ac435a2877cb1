//! A child process that writes raw frames to its standard output, such as ffmpeg.
//!
//! Invariant: the thread that started a child is the only one that ends it, before its end is collected, so no other process is
//! ever hit; the whole process group goes, also what the child started itself. A child whose reader is gone dies of its
//! broken pipe.

use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};

use crate::feed::{Giver, Source, Stop};

/// How long a child that has closed its output may take to end.
const TO_END: Duration = Duration::from_millis(500);
/// What is kept of a child's last words, bytes.
const LAST_WORDS: usize = 512;

/// What to run.
pub(crate) struct Program {
    /// Program and arguments; no shell looks at them.
    pub(crate) command: Vec<String>,
    /// A child that writes nothing for so long has stalled.
    pub(crate) stall: Duration,
    /// From exposure to the last byte of a frame, s.
    pub(crate) delay_s: f64,
}

/// A running child; dropped, it is ended.
pub(crate) struct Running {
    child: Child,
    out: ChildStdout,
    err: ChildStderr,
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
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .map_err(|why| {
                format!("command: {program} cannot be started: {why}; is it installed, is its name right?")
            })?;
        match (child.stdout.take(), child.stderr.take()) {
            (Some(out), Some(err)) => Ok(Running { child, out, err, collected: false }),
            _ => Err(format!("command: {program} has no output")),
        }
    }

    fn pump(&self, mut running: Running, giver: &mut Giver, stop: &Stop) -> String {
        let (mut filled, mut frames) = (0, 0u64);
        let (mut words, mut talks) = (Vec::new(), true);
        let mut heard = Instant::now();
        loop {
            let left = self.stall.saturating_sub(heard.elapsed());
            if left.is_zero() {
                let (name, stall) = (self.name(), self.stall.as_secs_f64());
                return format!(
                    "{name} stalled: it wrote nothing for {stall} s after {frames} frames; it was ended"
                );
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
            heard = Instant::now();
            if filled == giver.room().len() {
                giver.give(self.delay_s);
                (filled, frames) = (0, frames + 1);
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
            Some(status) => format!("{name} ended ({status}) after {frames} frames{rest}{words}"),
            None => format!("{name} closed its output after {frames} frames{rest}; it was ended{words}"),
        }
    }
}

impl Running {
    /// How it ended, when it does so soon; what it started is ended in any case.
    fn ended(&mut self) -> Option<ExitStatus> {
        let begun = Instant::now();
        // Looked at without collecting it: until then its number is nobody else's.
        let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let by_itself = loop {
            match self.pid().map(|pid| waitid(WaitId::Pid(pid), look)) {
                Some(Ok(None)) if begun.elapsed() < TO_END => std::thread::sleep(Duration::from_millis(2)),
                Some(Ok(Some(_))) => break true,
                _ => break false,
            }
        };
        self.end().filter(|_| by_itself)
    }

    /// Ends the whole group and collects the child; nothing the second time.
    fn end(&mut self) -> Option<ExitStatus> {
        if std::mem::replace(&mut self.collected, true) {
            return None;
        }
        if let Some(group) = self.pid() {
            let _ = kill_process_group(group, Signal::KILL);
        }
        self.child.wait().ok()
    }

    fn pid(&self) -> Option<Pid> {
        Pid::from_raw(self.child.id().cast_signed())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.end();
    }
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
