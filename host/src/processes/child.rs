//! One child: spawned with its standard input as the tie, asked to end by closing it, and what it says first.
//!
//! Invariant: it is waited for by its handle (a pidfd where the kernel has them), never by its number, so nobody else is
//! ever taken for it.

use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;

use serde_json::Value;
use tokio::io::AsyncReadExt;
use tokio::process::{ChildStdin, ChildStdout, Command};
use tokio::sync::oneshot;

use super::{Exit, Policy};

/// What a child shows of its log; all of it is in its state directory.
const LEVEL: &str = "TROCAR_LOG";
/// Longest first line, bytes.
const LINE: usize = 1 << 20;
/// How long a child that was asked to end may take for it.
const PATIENCE: Duration = Duration::from_secs(12);
/// How long what a child wrote may be on its way after its end.
const LAST_WORD: Duration = Duration::from_millis(500);

/// What is run as a child: a `trocar` that serves, with `--json` and `--tied`.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// What the process is called in the system.
    pub name: String,
    pub file: PathBuf,
    pub args: Vec<OsString>,
    /// Address it listens on; port 0 takes a free one.
    pub listen: String,
    /// Started again it listens where it listened first.
    pub stays: bool,
    pub env: Vec<(String, String)>,
    pub policy: Policy,
}

/// The first line of a child.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Said {
    Listening(String),
    /// Why it does not start, as its `--json` says it.
    Refused(Value),
}

/// A running child; killed when dropped.
pub(super) struct Child {
    process: tokio::process::Child,
    tie: Option<ChildStdin>,
    pub(super) pid: u32,
    said: oneshot::Receiver<Said>,
}

impl Child {
    pub(super) fn spawn(program: &Program, listen: &str) -> std::io::Result<Child> {
        let mut command = Command::new(&program.file);
        command.args(&program.args).args(["--json", "--tied", "--listen", listen]);
        if std::env::var_os(LEVEL).is_none() {
            command.env(LEVEL, "warn");
        }
        command.envs(program.env.iter().map(|(name, value)| (name, value)));
        // Its own group: Ctrl-C is for whoever keeps it, who then ends all in order.
        command.process_group(0).kill_on_drop(true);
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn()?;
        let (tell, said) = oneshot::channel();
        if let Some(stdout) = process.stdout.take() {
            tokio::spawn(listen_to(stdout, tell));
        }
        let pid = process.id().unwrap_or_default();
        Ok(Child { tie: process.stdin.take(), process, pid, said })
    }

    /// Waits for its end. May be called again when it was given up before.
    pub(super) async fn ended(&mut self) -> Exit {
        match self.process.wait().await {
            Ok(status) => status.into(),
            Err(e) => Exit::NotStarted(format!("nobody knows what became of it: {e}")),
        }
    }

    /// What it says first; `None` when it ends, or closes its standard output, without a word.
    pub(super) async fn first_word(&mut self) -> Option<Said> {
        tokio::select! {
            biased;
            said = &mut self.said => return said.ok(),
            _ = self.process.wait() => {}
        }
        // What it wrote last may still be on the way; a child of its own may keep the pipe open.
        tokio::time::timeout(LAST_WORD, &mut self.said).await.ok()?.ok()
    }

    /// Asks it to end, and kills it when it does not.
    pub(super) async fn end(&mut self) -> Exit {
        drop(self.tie.take());
        if let Ok(exit) = tokio::time::timeout(PATIENCE, self.ended()).await {
            return exit;
        }
        log::error!("process {} did not end within {} s and is killed", self.pid, PATIENCE.as_secs());
        // It may have ended in this moment.
        let _ = self.process.start_kill();
        self.ended().await
    }
}

/// Takes the first line, and passes on to standard error what plugins print after it.
async fn listen_to(mut stdout: ChildStdout, tell: oneshot::Sender<Said>) {
    let (mut tell, mut line, mut chunk) = (Some(tell), Vec::new(), vec![0; 8192]);
    while let Ok(n @ 1..) = stdout.read(&mut chunk).await {
        let mut rest = &chunk[..n];
        if let Some(teller) = tell.take() {
            let end = rest.iter().position(|b| *b == b'\n');
            line.extend_from_slice(&rest[..end.unwrap_or(n)]);
            match end {
                None if line.len() < LINE => {
                    tell = Some(teller);
                    continue;
                }
                None => continue,
                Some(end) => rest = &rest[end + 1..],
            }
            if let Some(said) = understood(&line) {
                // Whoever waited may have given up.
                let _ = teller.send(said);
            }
            line = Vec::new();
        }
        // Nobody has to read what plugins print.
        let _ = std::io::stderr().write_all(rest);
    }
}

fn understood(line: &[u8]) -> Option<Said> {
    let value: Value = serde_json::from_slice(line).ok()?;
    match value.get("listening").and_then(Value::as_str) {
        Some(address) => Some(Said::Listening(address.to_owned())),
        None => value.get("reason").is_some().then_some(Said::Refused(value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_is_an_address_or_a_refusal() {
        let address = understood(br#"{"listening":"127.0.0.1:7","pid":3}"#);
        assert_eq!(address, Some(Said::Listening("127.0.0.1:7".into())));
        let refused = understood(br#"{"reason":"LISTEN","message":"taken"}"#);
        assert!(matches!(&refused, Some(Said::Refused(v)) if v["message"] == "taken"), "{refused:?}");
        assert_eq!(understood(b"hello"), None);
    }
}
