//! Tries a plugin out in a child process, so that a fatal fault kills that one only.
//!
//! Invariant: the child is spawned (never forked by hand), bounded in time, and always reaped; only its lines
//! with the host's own prefix count, whatever the plugin prints. The host loads nothing the child did not
//! come back from.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use trocar_model::plain::sentence;
use trocar_plugin_api::environment;
use trocar_rt::house;

use super::error::Stage;
use super::load_fault::LoadFault;
use super::{Fault, PluginError};

/// Hidden subcommand of the host binary: `__vet FILE`.
pub const VET_ARG: &str = "__vet";
/// Longest time for constructors, layout, entry and init together: so short that a Create without a deadline
/// of its own still answers with the result.
pub(crate) const VET_LIMIT: Duration = Duration::from_secs(3);
/// Longest time until the child touches the file: its own code runs on a machine that may be busy.
pub(crate) const BEGIN_LIMIT: Duration = Duration::from_secs(20);
/// Prefix of every line of the child that is meant for the host.
pub(crate) const PREFIX: &str = "trocar-vet ";
/// Most bytes of the child's report.
const REPORT_LIMIT: u64 = 64 << 10;

/// Bytes of its standard error that are told, from the end.
const WORDS_LIMIT: usize = 400;
/// Time for its last words to arrive after its end.
const AFTERWARDS: Duration = Duration::from_millis(200);

/// Tries a file a user names as a host does before it loads it: constructors, tables, entry and init, in a
/// child process of `exe`, a program that knows the hidden subcommand.
///
/// # Errors
/// The sentence a host would refuse it with.
pub fn try_file(file: &Path, exe: &Path) -> Result<(), PluginError> {
    // A name without a slash would be looked for among the libraries of the system.
    let whole = std::path::absolute(file).unwrap_or_else(|_| file.to_path_buf());
    vet(exe, &whole, VET_LIMIT).map_err(|fault| PluginError::Refused { file: file.to_path_buf(), fault })
}

/// Runs `exe __vet file` and turns what happened into a verdict.
pub(crate) fn vet(exe: &Path, file: &Path, limit: Duration) -> Result<(), Fault> {
    // Runs the binary of this process where the file was replaced since its start.
    let replaced = exe.as_os_str().as_encoded_bytes().ends_with(b" (deleted)");
    let exe = if replaced { Path::new("/proc/self/exe") } else { exe };
    let failed = |e: io::Error| Fault::VetFailed { because: format!("{}: {e}", exe.display()) };
    let mut program = Command::new(exe);
    environment::give_to(&mut program);
    let mut child = program
        .arg(VET_ARG)
        .arg(file)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .process_group(0)
        .spawn()
        .map_err(failed)?;
    let words = child.stderr.take().map(LastWords::follow);
    let in_time = match begins_within(&child, BEGIN_LIMIT) {
        Ok(true) => ends_within(&child, limit),
        never => never,
    };
    let status = end_group(&mut child).map_err(failed)?;
    let status = in_time.map_err(failed)?.then_some(status);
    let report = Report::parse(&read_report(&mut child));
    report.verdict(status, limit, &words.map_or_else(String::new, |words| words.said()))
}

/// The end of the child's output on standard error, however much that is.
struct LastWords(Arc<Mutex<VecDeque<u8>>>, Receiver<()>);

impl LastWords {
    /// Reads as long as the pipe has a writer: a pipe without a reader would hold the child up.
    fn follow(mut from: ChildStderr) -> LastWords {
        let kept = Arc::new(Mutex::new(VecDeque::new()));
        let (told, over) = mpsc::channel();
        let into = kept.clone();
        let reading = move || {
            let mut piece = [0; 4096];
            while let Ok(read @ 1..) = from.read(&mut piece) {
                let mut kept = into.lock();
                kept.extend(&piece[..read]);
                let more = kept.len().saturating_sub(WORDS_LIMIT);
                kept.drain(..more);
            }
            drop(told);
        };
        if let Err(error) = house::spawn(std::thread::Builder::new().name("trocar-vet".into()), reading) {
            log::debug!("what a plugin says while it is tried cannot be read: {error}");
        }
        LastWords(kept, over)
    }

    /// Returns the words as one line. A grandchild may hold the pipe open: then those that have come by now.
    fn said(self) -> String {
        let _ = self.1.recv_timeout(AFTERWARDS);
        let bytes: Vec<u8> = self.0.lock().iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        sentence(lines.join("; ").as_bytes())
    }
}

/// Report of the child.
#[derive(Debug, Default, PartialEq)]
struct Report {
    stage: Option<Stage>,
    result: Option<Result<(), LoadFault>>,
}

impl Report {
    fn parse(text: &str) -> Report {
        let mut report = Report::default();
        for line in text.lines().filter_map(|l| l.strip_prefix(PREFIX)) {
            match line {
                "loading" => report.stage = Some(Stage::Loading),
                "layout" => report.stage = Some(Stage::Layout),
                "entry" => report.stage = Some(Stage::Entry),
                "init" => report.stage = Some(Stage::Init),
                "ok" => report.result = Some(Ok(())),
                json => {
                    if let Ok(fault) = serde_json::from_str(json) {
                        report.result = Some(Err(fault));
                    }
                }
            }
        }
        report
    }

    /// Turns the report into a verdict; `status` is none when the child had to be ended.
    fn verdict(self, status: Option<ExitStatus>, limit: Duration, said: &str) -> Result<(), Fault> {
        let said = said.to_string();
        match (self.result, self.stage, status) {
            (Some(Ok(())), _, Some(status)) if status.success() => Ok(()),
            (Some(Err(fault)), ..) => Err(fault.into()),
            (_, None, None) => Err(Fault::VetFailed { because: "the child did not answer in time".into() }),
            (_, None, Some(status)) => {
                Err(Fault::VetFailed { because: format!("the child ended with {status}") })
            }
            (_, Some(during), None) => Err(Fault::Hung { during, seconds: limit.as_secs().max(1), said }),
            (_, Some(during), Some(status)) => match status.signal() {
                Some(signal) => Err(Fault::Crashed { during, how: signal_name(signal), said }),
                None => Err(Fault::Quit { during, code: status.code().unwrap_or(-1), said }),
            },
        }
    }
}

/// Returns the word for a stage on the wire.
pub(crate) fn stage_word(stage: Stage) -> &'static str {
    match stage {
        Stage::Loading => "loading",
        Stage::Layout => "layout",
        Stage::Entry => "entry",
        Stage::Init => "init",
    }
}

fn signal_name(signal: i32) -> String {
    match signal {
        libc::SIGSEGV => "SIGSEGV, an invalid memory access".into(),
        libc::SIGBUS => "SIGBUS, memory that its file does not have".into(),
        libc::SIGABRT => "SIGABRT, abort or a panic that left the plugin".into(),
        libc::SIGILL => "SIGILL, an instruction this processor does not have".into(),
        libc::SIGFPE => "SIGFPE, an arithmetic error".into(),
        other => format!("signal {other}"),
    }
}

/// Waits for the first word of the child, or its end; false when the limit passed.
fn begins_within(child: &Child, limit: Duration) -> io::Result<bool> {
    let says = child.stdout.as_ref().map_or(-1, AsRawFd::as_raw_fd);
    wait(child, says, limit)
}

/// Waits for the end of the child; false when the limit passed. Does not wait for the pipe, which a
/// grandchild may hold open.
fn ends_within(child: &Child, limit: Duration) -> io::Result<bool> {
    wait(child, -1, limit)
}

/// Waits until there is something to read in `says` (-1: nothing ever is), or for the end of the child. The
/// child is not reaped, so that its number stays its own.
fn wait(child: &Child, says: i32, limit: Duration) -> io::Result<bool> {
    // Kernels before 5.3 have no pidfd; then poll only sleeps, in short steps.
    let pidfd = open_pidfd(child.id()).ok();
    let (ends, longest) = pidfd.as_ref().map_or((-1, 5), |fd| (fd.as_raw_fd(), 1000));
    let begin = Instant::now();
    let mut events = [ends, says].map(|fd| libc::pollfd { fd, events: libc::POLLIN, revents: 0 });
    loop {
        if events[1].revents != 0 || has_ended(child.id())? {
            return Ok(true);
        }
        let left = limit.saturating_sub(begin.elapsed()).as_millis() as i32;
        if left == 0 {
            return Ok(false);
        }
        // SAFETY: two entries, ours to write.
        unsafe { libc::poll(events.as_mut_ptr(), 2, left.min(longest)) };
    }
}

fn has_ended(pid: u32) -> io::Result<bool> {
    // SAFETY: `siginfo_t` is plain data for which all zeros is valid.
    let mut info: libc::siginfo_t = unsafe { std::mem::zeroed() };
    let options = libc::WEXITED | libc::WNOHANG | libc::WNOWAIT;
    // SAFETY: `info` is ours to write; the child is ours and not reaped.
    match unsafe { libc::waitid(libc::P_PID, pid, &raw mut info, options) } {
        // SAFETY: waitid has filled the fields of a child's end, or left them zero.
        0 => Ok(unsafe { info.si_pid() } != 0),
        _ => Err(io::Error::last_os_error()),
    }
}

fn open_pidfd(pid: u32) -> io::Result<OwnedFd> {
    // SAFETY: plain integers; the child is not reaped yet, so the number is its own.
    let fd = unsafe { libc::syscall(libc::SYS_pidfd_open, pid, 0) };
    match fd {
        0.. => {
            // SAFETY: the kernel has just given this descriptor to us alone.
            Ok(unsafe { OwnedFd::from_raw_fd(fd as i32) })
        }
        _ => Err(io::Error::last_os_error()),
    }
}

/// Ends the child if it still runs, and every process it started; then reaps it.
fn end_group(child: &mut Child) -> io::Result<ExitStatus> {
    if let Ok(group) = i32::try_from(child.id()) {
        // SAFETY: a plain number: the group the child leads, which exists until it is reaped.
        unsafe { libc::kill(-group, libc::SIGKILL) };
    }
    child.wait()
}

/// Returns the bytes in the pipe now; never waits for more.
fn read_report(child: &mut Child) -> String {
    let Some(stdout) = child.stdout.take() else { return String::new() };
    // SAFETY: an open descriptor of ours; the call changes only its mode.
    unsafe { libc::fcntl(stdout.as_raw_fd(), libc::F_SETFL, libc::O_NONBLOCK) };
    let mut bytes = Vec::new();
    // "Would block" ends the reading like an end of file; what came until then is kept.
    let _ = stdout.take(REPORT_LIMIT).read_to_end(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
#[path = "vet_tests.rs"]
mod tests;
