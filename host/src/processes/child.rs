//! One child: spawned with its standard input as the tie, asked to end by closing it, and what it says over
//! it.
//!
//! Invariant: it is waited for by its handle (a pidfd where the kernel has them), never by its number, so
//! nobody else is ever taken for it. What it started ends with it: what has stayed in its group, or has its
//! mark. Nothing it prints passes through this process: it can wait for no reader.

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

/// What a child shows of its log; all of it is in its state directory.
const LEVEL: &str = "TROCAR_LOG";
/// Longest line it says, bytes.
const LINE: usize = 1 << 20;
/// How long what a child said may be on its way after its end.
const LAST_WORD: Duration = Duration::from_millis(500);
/// How long a child that was killed may take to be gone.
const GONE: Duration = Duration::from_secs(5);

/// What is run as a child: this program, serving, with `--json` and `--tied`.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// What the process is called in the system.
    pub name: String,
    pub args: Vec<OsString>,
    /// Address it listens on; port 0 takes a free one.
    pub listen: String,
    /// Started again it listens where it listened first.
    pub stays: bool,
    pub env: Vec<(String, String)>,
    /// Its working directory; `None`: that of whoever starts it.
    pub folder: Option<PathBuf>,
    /// Where all it prints goes.
    pub output: PathBuf,
    pub policy: Policy,
}

/// The first line of a child.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Said {
    Listening(String),
    /// Why it does not start, as its `--json` says it.
    Refused(Value),
}

/// The last words of a child.
#[derive(Default)]
struct LastWords {
    /// It ends because somebody asked it to.
    farewell: AtomicBool,
    /// It served, and ends for this.
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
        // Somebody may have emptied the state directory.
        if let Some(place) = program.output.parent() {
            DirBuilder::new().recursive(true).mode(0o700).create(place)?;
        }
        let output = File::options().create(true).append(true).open(&program.output)?;
        // Its own group: Ctrl-C is for whoever keeps it, who then ends all in order.
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

    /// Waits for its end. May be called again when it was given up before.
    pub(super) async fn ended(&mut self) -> Exit {
        let exit = match collected(&mut self.process, &self.mark).await {
            Ok(status) => status.into(),
            Err(e) => Exit::NotStarted(format!("nobody knows what became of it: {e}")),
        };
        // What it said last may still be on the way; a child of its own may keep the tie open.
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

    /// Somebody asked it to end, and it did: a plugin that ends the process says nothing.
    pub(super) fn said_farewell(&self) -> bool {
        self.last.farewell.load(Ordering::Acquire)
    }

    /// What it says first; `None` when it ends, or closes its standard input, without a word.
    pub(super) async fn first_word(&mut self) -> Option<Said> {
        tokio::select! {
            biased;
            said = &mut self.said => return said.ok(),
            _ = collected(&mut self.process, &self.mark) => {}
        }
        tokio::time::timeout(LAST_WORD, &mut self.said).await.ok()?.ok()
    }

    /// Asks it to end, and kills it when it does not within its time. `why` it is to: `None`, as all have to
    /// some time.
    pub(super) async fn end(&mut self, patience: Duration, why: Option<String>) -> Exit {
        drop(self.tie.take());
        let why = match (tokio::time::timeout(patience, self.ended()).await, why) {
            (Ok(exit), None) => return exit,
            (Ok(_), Some(why)) => return Exit::Killed(why),
            (Err(_), Some(why)) => why,
            (Err(_), None) => format!("did not end within {} s", patience.as_secs()),
        };
        log::error!("process {} {why} and is killed", self.pid);
        // It may have ended in this moment.
        let _ = self.process.start_kill();
        match tokio::time::timeout(GONE, self.ended()).await {
            Ok(_) => Exit::Killed(why),
            // The kernel holds it, in a driver for one.
            Err(_) => Exit::Stuck(why),
        }
    }
}

/// Waits for the end of a child, and ends what is left of what it started.
async fn collected(child: &mut tokio::process::Child, mark: &Mark) -> std::io::Result<ExitStatus> {
    if let Some(leader) = child.id().and_then(group)
        && ends(leader).await
    {
        // Not collected yet, so the number of its group is nobody else's. It is there itself, if nobody else
        // is.
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

/// The program that runs here, also when another one lies in its place by now: they might not understand each
/// other.
fn this_program() -> std::io::Result<PathBuf> {
    let path = std::env::current_exe()?;
    let replaced = path.as_os_str().as_encoded_bytes().ends_with(b" (deleted)");
    Ok(if replaced { PathBuf::from("/proc/self/exe") } else { path })
}

/// Takes what it says: where it serves or why it does not, and at its end that somebody asked for that, or
/// why it is.
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
                        // Whoever waited may have given up.
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
