//! The door at which a supervised system is asked to go down: a Unix socket in its state directory.
//!
//! Invariant: only the user of the directory can ask, and the caller is answered when the system is down, not
//! before.

use std::fs::{self, File, Permissions};
use std::io::ErrorKind;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, geteuid, getpid, pidfd_open};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

const SOCKET: &str = "door.sock";
const DOWN: &str = "down\n";
/// Time for a caller's request.
const ASK: Duration = Duration::from_secs(2);
/// Time a system may take to go down.
const PATIENCE: Duration = Duration::from_secs(60);

/// The door of this system; gone when dropped.
pub struct Door {
    path: PathBuf,
    asked: mpsc::Receiver<UnixStream>,
    task: JoinHandle<()>,
}

/// Result of asking.
#[derive(Debug, PartialEq, Eq)]
pub enum Answer {
    /// Everything has ended; what did not end in order, one sentence each.
    Down(Vec<String>),
    /// No system is there.
    Nobody,
    /// The system did not go down, or its state is unknown: the reason.
    Unknown(String),
}

impl Door {
    /// Opens the door of the system with this directory, which the caller holds.
    ///
    /// # Errors
    /// The socket cannot be bound.
    pub fn open(dir: &Path) -> std::io::Result<Door> {
        // The directory may be older than this program, or made with other permissions.
        fs::set_permissions(dir, Permissions::from_mode(0o700))?;
        let path = dir.join(SOCKET);
        // The directory is ours: what lies here is a dead system's.
        let _ = fs::remove_file(&path);
        let near = Near::of(dir)?;
        let listener = UnixListener::bind(near.socket())?;
        let (tell, asked) = mpsc::channel(16);
        let task = tokio::spawn(async move {
            loop {
                match listener.accept().await {
                    Ok((stream, _)) if is_ours(&stream) => {
                        tokio::spawn(let_in(stream, tell.clone()));
                    }
                    Ok(_) => log::warn!("another user asked this system to go down"),
                    // Descriptors are used up: other code may free some.
                    Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
                }
            }
        });
        Ok(Door { path, asked, task })
    }

    /// Waits until a caller wants the system down; returns the stream for the answer.
    pub async fn asked(&mut self) -> UnixStream {
        match self.asked.recv().await {
            Some(stream) => stream,
            // The task lives as long as this does.
            None => std::future::pending().await,
        }
    }

    /// Answers every caller that the system is down, and what did not end in order.
    pub async fn answer(&mut self, first: Option<UnixStream>, failed: &[String]) {
        let mut waiting: Vec<UnixStream> = first.into_iter().collect();
        while let Ok(next) = self.asked.try_recv() {
            waiting.push(next);
        }
        let lines = failed.iter().map(|line| line.replace('\n', " ") + "\n");
        let text: String = std::iter::once(DOWN.to_owned()).chain(lines).collect();
        for mut stream in waiting {
            // The caller may have given up, or may not listen.
            let _ = tokio::time::timeout(ASK, stream.write_all(text.as_bytes())).await;
        }
    }

    /// Asks the system of this directory to go down and waits until it is down, its own process too.
    pub async fn ask(dir: &Path) -> Answer {
        let mut stream = match connect(dir).await {
            Ok(stream) => stream,
            Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::ConnectionRefused) => {
                return Answer::Nobody;
            }
            Err(e) => return Answer::Unknown(e.to_string()),
        };
        // Held before it is asked: its number then stays its own.
        let process = stream.peer_cred().ok().and_then(|peer| peer.pid()).and_then(held);
        let talk = async {
            stream.write_all(DOWN.as_bytes()).await?;
            let mut text = String::new();
            stream.read_to_string(&mut text).await?;
            if let Some(process) = process {
                // The process closes the stream before it ends.
                ended(process).await;
            }
            Ok::<_, std::io::Error>(text)
        };
        match tokio::time::timeout(PATIENCE, talk).await {
            Ok(Ok(text)) => match text.strip_prefix(DOWN) {
                Some(failed) => Answer::Down(failed.lines().map(str::to_owned).collect()),
                None => Answer::Unknown("it ended before it answered".to_owned()),
            },
            Ok(Err(e)) => Answer::Unknown(e.to_string()),
            Err(_) => Answer::Unknown(format!("no answer within {} s", PATIENCE.as_secs())),
        }
    }

    /// Tells whether a system answers there.
    pub async fn is_open(dir: &Path) -> bool {
        connect(dir).await.is_ok()
    }
}

/// A directory by a short name: the name of a socket has at most 107 bytes, that of a directory many more.
struct Near(File);

impl Near {
    fn of(dir: &Path) -> std::io::Result<Near> {
        File::open(dir).map(Near)
    }

    fn socket(&self) -> PathBuf {
        PathBuf::from(format!("/proc/self/fd/{}/{SOCKET}", self.0.as_raw_fd()))
    }
}

async fn connect(dir: &Path) -> std::io::Result<UnixStream> {
    let near = Near::of(dir)?;
    UnixStream::connect(near.socket()).await
}

/// Tells whether the peer is a program of this process's user, or of root.
fn is_ours(stream: &UnixStream) -> bool {
    stream.peer_cred().is_ok_and(|peer| peer.uid() == geteuid().as_raw() || peer.uid() == 0)
}

impl Drop for Door {
    fn drop(&mut self) {
        self.task.abort();
        let _ = fs::remove_file(&self.path);
    }
}

/// A handle of another process. `None` for this one, and where the kernel has none.
fn held(pid: i32) -> Option<OwnedFd> {
    let pid = Pid::from_raw(pid).filter(|pid| *pid != getpid())?;
    pidfd_open(pid, PidfdFlags::empty()).ok()
}

/// Waits until the process of this handle has ended.
async fn ended(process: OwnedFd) {
    let limit = Timespec::try_from(PATIENCE).ok();
    let waiting = tokio::task::spawn_blocking(move || {
        poll(&mut [PollFd::new(&process, PollFlags::IN)], limit.as_ref())
    });
    // At worst the process is still there.
    let _ = waiting.await;
}

async fn let_in(mut stream: UnixStream, tell: mpsc::Sender<UnixStream>) {
    let mut asked = [0; DOWN.len()];
    let read = tokio::time::timeout(ASK, stream.read_exact(&mut asked)).await;
    if matches!(read, Ok(Ok(_))) && asked == DOWN.as_bytes() {
        // The system is going down already.
        let _ = tell.send(stream).await;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[tokio::test]
    async fn whoever_asks_is_answered_when_it_is_done() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(Door::ask(dir.path()).await, Answer::Nobody);
        let mut door = Door::open(dir.path()).unwrap();
        assert!(Door::is_open(dir.path()).await);
        let mode = fs::metadata(dir.path()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700, "nobody else comes near it");
        let path = dir.path().to_owned();
        let asking = tokio::spawn(async move { Door::ask(&path).await });
        let first = door.asked().await;
        let failed = ["left did not end within 12 s\nand was killed".to_owned()];
        door.answer(Some(first), &failed).await;
        let told = vec!["left did not end within 12 s and was killed".to_owned()];
        assert_eq!(asking.await.unwrap(), Answer::Down(told));
    }

    #[tokio::test]
    async fn a_directory_with_a_long_name_has_a_door_too() {
        let dir = tempfile::tempdir().unwrap();
        let long = dir.path().join("d".repeat(200));
        fs::create_dir(&long).unwrap();
        let door = Door::open(&long).unwrap();
        assert!(Door::is_open(&long).await);
        drop(door);
        assert!(!Door::is_open(&long).await && !long.join(SOCKET).exists());
    }

    #[tokio::test]
    async fn a_system_that_dies_first_is_told_apart_from_one_that_is_down() {
        let dir = tempfile::tempdir().unwrap();
        let mut door = Door::open(dir.path()).unwrap();
        let path = dir.path().to_owned();
        let asking = tokio::spawn(async move { Door::ask(&path).await });
        drop(door.asked().await);
        drop(door);
        assert!(matches!(asking.await.unwrap(), Answer::Unknown(_)));
        assert_eq!(Door::ask(dir.path()).await, Answer::Nobody, "its socket is gone with it");
    }

    #[tokio::test]
    async fn who_says_something_else_is_not_heard() {
        let dir = tempfile::tempdir().unwrap();
        let mut door = Door::open(dir.path()).unwrap();
        let mut stranger = UnixStream::connect(dir.path().join(SOCKET)).await.unwrap();
        stranger.write_all(b"up up").await.unwrap();
        let mut text = String::new();
        assert_eq!(stranger.read_to_string(&mut text).await.unwrap_or(0), 0);
        assert!(door.asked.try_recv().is_err());
    }
}
