//! A session with one process, from the moment both made sure of each other until one of them is gone.

use std::fmt;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use rustix::io::Errno;
use rustix::net::Shutdown;
use trocar_rt::pulse::Pulse;

use crate::greeting::data_head;
use crate::plain::plain;
use crate::socket::{MOST_BYTES, MOST_FDS, send};

/// Identity of the process at the other end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    pub process: String,
    /// Identifies this run of the process.
    pub instance: String,
    /// As the kernel told it.
    pub pid: i32,
}

/// Why a session is over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lost {
    /// The other process ended, or closed it.
    Closed,
    /// The other process died, or ended on the spot: the kernel, or the process itself, marked its word in
    /// the shared page.
    Died,
    /// The other process exists, but stands still.
    Stopped,
    /// Nothing was heard of the other process for this long.
    Silent { ms: u64 },
    /// The other process said what it may not.
    Nonsense { what: String },
    /// This process ended the session.
    Ended,
}

impl fmt::Display for Lost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Lost::Closed => f.write_str("it ended or closed the connection"),
            Lost::Died => f.write_str("it died, or ended without taking leave"),
            Lost::Stopped => f.write_str("it was stopped (SIGSTOP, a debugger)"),
            Lost::Silent { ms } => write!(f, "nothing was heard of it for {ms} ms"),
            Lost::Nonsense { what } => write!(f, "it said what it may not: {what}"),
            Lost::Ended => f.write_str("ended from here"),
        }
    }
}

/// Reason why a message could not be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    TooLong {
        bytes: usize,
    },
    TooManyFiles {
        files: usize,
    },
    /// The other process does not read earlier messages.
    Busy,
    Lost,
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SendError::TooLong { bytes } => {
                write!(f, "{bytes} bytes are more than one message holds ({MOST_BYTES})")
            }
            SendError::TooManyFiles { files } => {
                write!(f, "{files} files are more than one message carries ({MOST_FDS})")
            }
            SendError::Busy => f.write_str("the other process does not read what it was told before"),
            SendError::Lost => f.write_str("the other process is gone"),
        }
    }
}

impl std::error::Error for SendError {}

/// Most messages of one session that wait to be handled; a file counts as four. Beyond that the socket is not
/// read, and the other process gets [`SendError::Busy`].
const MOST_HELD: usize = 512;

/// A message's share of [`MOST_HELD`], given back when it was handled.
#[derive(Debug)]
struct Held {
    all: Arc<AtomicUsize>,
    mine: usize,
}

impl Held {
    fn new(all: &Arc<AtomicUsize>, files: usize) -> Held {
        let mine = 1 + 4 * files;
        all.fetch_add(mine, Ordering::Relaxed);
        Held { all: Arc::clone(all), mine }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.all.fetch_sub(self.mine, Ordering::Relaxed);
    }
}

/// Something the other process said. It counts against its session until it is dropped.
#[derive(Debug)]
pub struct Message {
    pub bytes: Vec<u8>,
    /// Files that came along.
    pub files: Vec<OwnedFd>,
    /// Number of files the sender announced: more than came where this process may open no more files.
    pub announced: usize,
    _held: Held,
}

/// A live connection to one process. Any thread may speak.
#[derive(Debug)]
pub struct Session {
    number: u64,
    peer: Peer,
    /// Socket the other process listens at.
    at: PathBuf,
    socket: OwnedFd,
    pub(crate) pulse: Pulse,
    lost: AtomicBool,
    ended: AtomicBool,
    /// Reason why the user of the session does not listen to it any more.
    condemned: OnceLock<String>,
    /// Part of [`MOST_HELD`] in use by its messages.
    held: Arc<AtomicUsize>,
    /// The other process began it.
    guest: bool,
}

impl Session {
    pub(crate) fn new(
        number: u64,
        peer: Peer,
        (at, guest): (PathBuf, bool),
        socket: OwnedFd,
        pulse: Pulse,
    ) -> Session {
        Session {
            number,
            peer,
            at,
            socket,
            pulse,
            lost: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            condemned: OnceLock::new(),
            held: Arc::default(),
            guest,
        }
    }

    /// Makes a message of this session.
    pub(crate) fn message(&self, bytes: &[u8], files: Vec<OwnedFd>, announced: usize) -> Message {
        let held = Held::new(&self.held, files.len());
        Message { bytes: bytes.to_vec(), files, announced, _held: held }
    }

    /// Tells whether so many of its messages wait that no more is read.
    pub(crate) fn is_full(&self) -> bool {
        self.held.load(Ordering::Relaxed) >= MOST_HELD
    }

    pub(crate) fn is_guest(&self) -> bool {
        self.guest
    }

    /// Number in this process: no two sessions have the same.
    pub fn number(&self) -> u64 {
        self.number
    }

    pub fn peer(&self) -> &Peer {
        &self.peer
    }

    /// Socket the other process listens at.
    pub fn at(&self) -> &PathBuf {
        &self.at
    }

    /// Tells whether the session was given up, for good.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Acquire)
    }

    /// Sends a message, with files that come along. Never waits.
    ///
    /// # Errors
    /// It is too much, or the other process does not listen, or is gone.
    pub fn send(&self, bytes: &[u8], files: &[BorrowedFd<'_>]) -> Result<(), SendError> {
        if bytes.len() > MOST_BYTES {
            return Err(SendError::TooLong { bytes: bytes.len() });
        }
        if files.len() > MOST_FDS {
            return Err(SendError::TooManyFiles { files: files.len() });
        }
        if self.is_lost() {
            return Err(SendError::Lost);
        }
        match send(self.socket.as_fd(), &[&data_head(files.len()), bytes], files) {
            Ok(()) => Ok(()),
            Err(Errno::AGAIN | Errno::NOBUFS | Errno::TOOMANYREFS) => Err(SendError::Busy),
            Err(Errno::MSGSIZE) => Err(SendError::TooLong { bytes: bytes.len() }),
            Err(_) => Err(SendError::Lost),
        }
    }

    /// Ends the session: both ends are told that it is lost.
    pub(crate) fn end(&self) {
        self.ended.store(true, Ordering::Release);
        // The session may have ended already.
        let _ = rustix::net::shutdown(&self.socket, Shutdown::Both);
    }

    /// Ends the session, since the other process said what it may not. The log tells the reason, seldom;
    /// [`Lost`] carries it.
    pub fn condemn(&self, what: &str) {
        // The first reason stays.
        let _ = self.condemned.set(plain(what));
        self.end();
    }

    /// Returns why it is over, where that was decided here.
    pub(crate) fn why_ended(&self) -> Option<Lost> {
        let condemned = self.condemned.get().map(|what| Lost::Nonsense { what: what.clone() });
        condemned.or_else(|| self.ended.load(Ordering::Acquire).then_some(Lost::Ended))
    }

    pub(crate) fn give_up(&self) {
        self.lost.store(true, Ordering::Release);
        let _ = rustix::net::shutdown(&self.socket, Shutdown::Both);
    }

    pub(crate) fn socket(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}
