//! One child: spawned with its standard input as the tie, asked to end by closing the tie, and the messages
//! it sends over it.
//!
//! Invariant: a child is waited for by its handle (a pidfd where the kernel has them), never by its number,
//! so no other process is ever taken for it. Programs it started end with it: those that stayed in its group,
//! or have its mark. Nothing it prints passes through this process: it never waits for a reader.

use std::ffi::OsString;
use std::fs::{DirBuilder, File};
use std::os::fd::OwnedFd;
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use serde_json::Value;
use tokio::io::AsyncReadExt;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::process::Command;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::offspring::Mark;
use super::{Exit, Policy};

/// Variable with the log level of a child's output; the child's state directory has the whole log.
const LEVEL: &str = "TROCAR_LOG";
/// Longest line of a child, bytes.
const LINE: usize = 1 << 20;
/// Time for a child's last messages to arrive after its end.
const LAST_WORD: Duration = Duration::from_millis(500);
/// Time for a killed child to be gone.
const GONE: Duration = Duration::from_secs(5);

/// The program of a child: this one, serving, with `--json` and `--tied`.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// Name of the process in the system.
    pub name: String,
    pub args: Vec<OsString>,
    /// Address it listens on; port 0 takes a free one.
    pub listen: String,
    /// When started again, it listens where it listened first.
    pub stays: bool,
    pub env: Vec<(String, String)>,
    /// Its working directory; `None`: that of its parent.
    pub folder: Option<PathBuf>,
    /// File for everything it prints.
    pub output: PathBuf,
    pub policy: Policy,
}

/// The first line of a child.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Said {
    Listening(String),
    /// The reason why it does not start, as its `--json` says it.
    Refused(Value),
}

/// The last words of a child.
#[derive(Default)]
struct LastWords {
    /// The child ends because it was asked to.
    farewell: AtomicBool,
    /// The reason for which a child that served ends.
    why: OnceLock<String>,
}

/// A running child; let go when dropped, and then ends by itself.
pub(super) struct Child {
    process: tokio::process::Child,
    tie: Option<OwnedWriteHalf>,
    pub(super) pid: u32,
    mark: Mark,
    said: oneshot::Receiver<Said>,
    last: Arc<LastWords>,
    hearing: Option<JoinHandle<()>>,
}

impl Child {
    pub(super) fn spawn(program: &Program, listen: &str) -> std::io::Result<Child> {
        let mut command = Command::new(this_program()?);
        command.args(&program.args).args(["--json", "--tied", "--listen", listen]);
        if std::env::var_os(LEVEL).is_none() {
            command.env(LEVEL, "warn");
        }
        command.envs(program.env.iter().map(|(name, value)| (name, value)));
        let mark = Mark::new();
        let (name, value) = mark.variable();
        command.env(name, value);
        if let Some(folder) = &program.folder {
            command.current_dir(folder);
        }
        let (ours, its) = UnixStream::pair()?;
        ours.set_nonblocking(true)?;
        // The state directory may have been emptied.
        if let Some(place) = program.output.parent() {
            DirBuilder::new().recursive(true).mode(0o700).create(place)?;
        }
        let output = File::options().create(true).append(true).open(&program.output)?;
        // A group of its own: Ctrl-C is for its keeper, which then ends all in order.
        command.process_group(0).stdin(Stdio::from(OwnedFd::from(its)));
        command.stdout(output.try_clone()?).stderr(output);
        let process = command.spawn()?;
        let (from, tie) = tokio::net::UnixStream::from_std(ours)?.into_split();
        let (tell, said) = oneshot::channel();
        let last = Arc::new(LastWords::default());
        let hearing = Some(tokio::spawn(hear(from, tell, last.clone())));
        let pid = process.id().unwrap_or_default();
        Ok(Child { process, tie: Some(tie), pid, mark, said, last, hearing })
    }

    /// Waits for its end. May be called again after it was cancelled.
    pub(super) async fn ended(&mut self) -> Exit {
        let exit = match collected(&mut self.process, &self.mark).await {
            Ok(status) => status.into(),
            Err(e) => Exit::NotStarted(format!("nobody knows what became of it: {e}")),
        };
        // Its last message may still be on the way; a child of its own may keep the tie open.
        if let Some(hearing) = &mut self.hearing
            && tokio::time::timeout(LAST_WORD, hearing).await.is_ok()
        {
            self.hearing = None;
        }
        match (exit, self.last.why.get()) {
            (Exit::Code(code), Some(why)) => Exit::Because { code, why: why.clone() },
            (exit, _) => exit,
        }
    }

    /// Tells whether it was asked to end, and did: a plugin that ends the process says nothing.
    pub(super) fn said_farewell(&self) -> bool {
        self.last.farewell.load(Ordering::Acquire)
    }

    /// Returns its first message; `None` when it ends, or closes its standard input, without one.
    pub(super) async fn first_word(&mut self) -> Option<Said> {
        tokio::select! {
            biased;
            said = &mut self.said => return said.ok(),
            _ = collected(&mut self.process, &self.mark) => {}
        }
        tokio::time::timeout(LAST_WORD, &mut self.said).await.ok()?.ok()
    }

    /// Asks it to end, and kills it when it does not within its time. `why` is the reason to end it; `None`:
    /// an ordinary end.
    pub(super) async fn end(&mut self, patience: Duration, why: Option<String>) -> Exit {
        drop(self.tie.take());
        let why = match (tokio::time::timeout(patience, self.ended()).await, why) {
            (Ok(exit), None) => return exit,
            (Ok(_), Some(why)) => return Exit::Killed(why),
            (Err(_), Some(why)) => why,
            (Err(_), None) => format!("did not end within {} s", patience.as_secs()),
        };
        log::error!("process {} {why} and is killed", self.pid);
        // The process may have ended meanwhile.
        let _ = self.process.start_kill();
        match tokio::time::timeout(GONE, self.ended()).await {
            Ok(_) => Exit::Killed(why),
            // The kernel holds it, in a driver for one.
            Err(_) => Exit::Stuck(why),
        }
    }
}

/// Waits for the end of a child, and ends the rest of the programs it started.
async fn collected(child: &mut tokio::process::Child, mark: &Mark) -> std::io::Result<ExitStatus> {
    if let Some(leader) = child.id().and_then(group)
        && ends(leader).await
    {
        // The child is not collected yet, so the number of its group belongs to no other group. The group
        // exists if only by the child itself.
        let _ = kill_process_group(leader, Signal::KILL);
        let mark = mark.clone();
        let killed = tokio::task::spawn_blocking(move || mark.kill_all()).await;
        if let Err(e) = killed {
            log::error!("what process {} has left behind was not looked for: {e}", child.id().unwrap_or(0));
        }
    }
    child.wait().await
}

/// Waits for the end of a child without collecting it; false where that cannot be.
async fn ends(child: Pid) -> bool {
    let Ok(mut ended) = signal(SignalKind::child()) else { return false };
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    loop {
        match waitid(WaitId::Pid(child), look) {
            Ok(None) => {}
            Ok(Some(_)) => return true,
            Err(_) => return false,
        }
        if ended.recv().await.is_none() {
            return false;
        }
    }
}

/// The group that a child leads.
fn group(pid: u32) -> Option<Pid> {
    i32::try_from(pid).ok().and_then(Pid::from_raw)
}

/// Returns the program that runs here, also when its file was replaced meanwhile: the two might not
/// understand each other.
fn this_program() -> std::io::Result<PathBuf> {
    let path = std::env::current_exe()?;
    let replaced = path.as_os_str().as_encoded_bytes().ends_with(b" (deleted)");
    Ok(if replaced { PathBuf::from("/proc/self/exe") } else { path })
}

/// Takes its messages: first its address or the reason why it does not start; at its end, that it was asked
/// to, or the reason.
async fn hear(mut from: OwnedReadHalf, tell: oneshot::Sender<Said>, last: Arc<LastWords>) {
    let (mut tell, mut line, mut chunk) = (Some(tell), Vec::new(), vec![0; 4096]);
    while let Ok(n @ 1..) = from.read(&mut chunk).await {
        for byte in &chunk[..n] {
            match byte {
                b'\n' => {
                    match (understood(&line), tell.take()) {
                        (Some(Word::Farewell), teller) => {
                            last.farewell.store(true, Ordering::Release);
                            tell = teller;
                        }
                        // The waiting task may have given up.
                        (Some(Word::First(said)), Some(teller)) => _ = teller.send(said),
                        (Some(Word::First(Said::Refused(why))), None) => {
                            // One end has one reason.
                            let _ = last.why.set(why["message"].as_str().unwrap_or_default().to_owned());
                        }
                        (_, teller) => tell = teller,
                    }
                    line.clear();
                }
                _ if line.len() < LINE => line.push(*byte),
                _ => {}
            }
        }
    }
}

#[derive(Debug, PartialEq)]
enum Word {
    First(Said),
    Farewell,
}

fn understood(line: &[u8]) -> Option<Word> {
    let value: Value = serde_json::from_slice(line).ok()?;
    if value.get("ending").is_some() {
        return Some(Word::Farewell);
    }
    match value.get("listening").and_then(Value::as_str) {
        Some(address) => Some(Word::First(Said::Listening(address.to_owned()))),
        None => value.get("reason").is_some().then_some(Word::First(Said::Refused(value))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_is_an_address_or_a_refusal_and_the_last_a_farewell() {
        let address = understood(br#"{"listening":"127.0.0.1:7","pid":3}"#);
        assert_eq!(address, Some(Word::First(Said::Listening("127.0.0.1:7".into()))));
        let refused = understood(br#"{"reason":"LISTEN","message":"taken"}"#);
        assert!(
            matches!(&refused, Some(Word::First(Said::Refused(v))) if v["message"] == "taken"),
            "{refused:?}"
        );
        assert_eq!(understood(br#"{"ending":true}"#), Some(Word::Farewell));
        assert_eq!(understood(b"hello"), None);
    }
}
