//! A Unix socket per host process, for its own user: how `trocar stop --all` works without a GCM.
//!
//! Invariant: it needs no gRPC, no name and no port; the directory is readable by its user only, so no other
//! user can ask.

use std::fs;
use std::future::poll_fn;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;

use super::HostError;
use crate::runtime_dir::{Place, Placed, RuntimeDir, pid_of};

/// Time that a process may take to stop its components.
const PATIENCE: Duration = Duration::from_secs(5);
const STOP: &str = "stop\n";

/// This process's socket; removed on drop.
pub(super) struct Announcement(Placed);

/// The answer of one process that was asked to stop its components.
#[derive(Clone, Debug)]
pub struct Stopped {
    /// The process by the kernel's number.
    pub pid: u32,
    /// The text of its answer when everything stands still; otherwise the reason why not, as far as one is
    /// known.
    pub result: Result<String, String>,
}

impl Stopped {
    /// The text either way.
    pub fn text(&self) -> &str {
        match &self.result {
            Ok(text) | Err(text) => text,
        }
    }
}

impl Announcement {
    /// Opens the socket of this process in `instance`'s name (several hosts may live in one process).
    ///
    /// # Errors
    /// The directory cannot be made or the socket cannot be bound.
    pub(super) fn open(instance: &str) -> Result<Self, HostError> {
        Self::open_in(&RuntimeDir::of_user(), instance)
    }

    fn open_in(dir: &RuntimeDir, instance: &str) -> Result<Self, HostError> {
        let failed = |e: std::io::Error| HostError::StateUnwritable {
            dir: dir.path().to_owned(),
            because: e.to_string(),
        };
        let (own, path) = (dir.clone(), dir.path().join(format!("{}.{instance}.sock", std::process::id())));
        let at = path.clone();
        let bind = move || {
            own.prepare()?;
            UnixListener::bind(&at)
        };
        Place::new(path, bind).and_then(Place::wait).map(Self).map_err(failed)
    }

    /// Serves requests for ever: each one runs `stop`, whose words go back to the asker.
    pub(super) async fn serve<F, S>(mut self, stop: S)
    where
        S: Fn() -> F + Clone + Send + 'static,
        F: Future<Output = Result<String, String>> + Send,
    {
        loop {
            match poll_fn(|cx| self.0.poll_accept(cx)).await {
                Ok(stream) => {
                    let stop = stop.clone();
                    tokio::spawn(async move { answer(stream, stop).await });
                }
                // Out of descriptors: others may free some.
                Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
            }
        }
    }
}

async fn answer<F: Future<Output = Result<String, String>>>(mut stream: UnixStream, stop: impl Fn() -> F) {
    let mut asked = [0; STOP.len()];
    let read = tokio::time::timeout(PATIENCE, stream.read_exact(&mut asked)).await;
    if !matches!(read, Ok(Ok(_))) || asked != STOP.as_bytes() {
        return;
    }
    let answer = match stop().await {
        Ok(text) => format!("+{text}"),
        Err(text) => format!("-{text}"),
    };
    // The asker may have gone; the stop is done all the same.
    let _ = stream.write_all(answer.as_bytes()).await;
}

impl Drop for Announcement {
    fn drop(&mut self) {
        let _ = fs::remove_file(self.0.path());
    }
}

/// Asks every host process of this user on this machine, of whatever system, to stop its components, all at
/// once; the calling one, too. Needs a tokio runtime; takes as long as the slowest answer, seconds at most.
/// Empty where there are none, or where their directory is another user's.
pub async fn stop_everything() -> Vec<Stopped> {
    stop_everything_in(&RuntimeDir::of_user()).await
}

async fn stop_everything_in(dir: &RuntimeDir) -> Vec<Stopped> {
    if let Err(e) = dir.is_own() {
        log::debug!("no sockets of this user's hosts: {e}");
        return Vec::new();
    }
    let asked: Vec<_> = dir
        .entries()
        .filter(|p| p.extension().is_some_and(|e| e == "sock"))
        .map(|path| tokio::spawn(async move { ask(&path).await }))
        .collect();
    let mut answers = Vec::new();
    for one in asked {
        answers.extend(one.await.ok().flatten());
    }
    answers
}

/// Asks one process; `None`: no process listens at this socket any more.
async fn ask(path: &Path) -> Option<Stopped> {
    let pid = pid_of(path)?;
    let mut stream = match UnixStream::connect(path).await {
        Ok(stream) => stream,
        Err(e) if e.kind() == std::io::ErrorKind::ConnectionRefused => {
            let _ = fs::remove_file(path);
            return None;
        }
        Err(_) => return None,
    };
    let talk = async {
        stream.write_all(STOP.as_bytes()).await.map_err(|e| e.to_string())?;
        let mut text = String::new();
        stream.read_to_string(&mut text).await.map_err(|e| e.to_string())?;
        match text.split_at_checked(1) {
            Some(("+", words)) => Ok(words.to_owned()),
            Some(("-", words)) => Err(words.to_owned()),
            _ => Err("it ended before it answered".to_owned()),
        }
    };
    let silent = format!("no answer within {} s", PATIENCE.as_secs());
    let result = tokio::time::timeout(PATIENCE, talk).await.unwrap_or(Err(silent));
    Some(Stopped { pid, result })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    async fn serving(
        dir: &RuntimeDir,
        instance: &str,
        answer: Result<String, String>,
    ) -> tokio::task::JoinHandle<()> {
        let announcement = Announcement::open_in(dir, instance).unwrap();
        tokio::spawn(async move { announcement.serve(move || std::future::ready(answer.clone())).await })
    }

    #[tokio::test]
    async fn every_process_is_asked_and_its_words_come_back() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path());
        let good = serving(&dir, "a", Ok("everything stands still".into())).await;
        let bad = serving(&dir, "b", Err("host/x did not stop".into())).await;
        let mut answers = stop_everything_in(&dir).await;
        answers.sort_by_key(|a| a.result.is_err());
        assert_eq!(answers[0].text(), "everything stands still");
        assert_eq!(answers[1].result, Err("host/x did not stop".into()));
        assert!(answers.iter().all(|a| a.pid == std::process::id()), "{answers:?}");
        good.abort();
        bad.abort();
    }

    #[tokio::test]
    async fn a_socket_nobody_listens_on_is_swept_away() {
        let temp = tempfile::tempdir().unwrap();
        let dead = temp.path().join("4242.host.sock");
        drop(std::os::unix::net::UnixListener::bind(&dead).unwrap());
        assert!(stop_everything_in(&RuntimeDir::at(temp.path())).await.is_empty());
        assert!(!dead.exists(), "the dead socket is still there");
    }
}
