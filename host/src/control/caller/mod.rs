//! The peer of a connection of the port: its identity, and its rights.
//!
//! Invariant: the kernel identifies the peer, or a certificate of the system's authority does; its own words
//! count only as far as it holds the token of this host's user. An unknown caller may read, and nothing else.

mod access;
mod bearer;
mod owner;
mod rights;
mod rules;

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::io::Errno;
use tokio::net::{TcpStream, UnixStream};
use trocar_net::Holder;

pub(super) use self::access::{Access, OnlyReads, READERS, known, only_reads};
pub use self::bearer::Tokened;
pub(super) use self::bearer::with_token;
pub(super) use self::rights::is_process;
pub use self::rules::{PortRules, Viewer};

/// The peer of a connection. Every request on the connection carries one.
#[derive(Clone, Debug)]
pub(crate) struct Peer {
    from: From,
    /// `None`: the kernel does not say.
    uid: Option<u32>,
    /// By its certificate, which it has shown where it comes from beyond the loopback.
    holder: Option<Arc<Holder>>,
    /// The network lost its connection, which nobody has ended.
    is_cut: Arc<AtomicBool>,
}

#[derive(Clone, Debug)]
enum From {
    Address(SocketAddr),
    /// A socket in the file system, with the caller's process as the kernel has it.
    Socket {
        pid: Option<i32>,
    },
}

impl Peer {
    /// # Errors
    /// The process has no file to ask the kernel by.
    pub(super) fn of_tcp(stream: &TcpStream, addr: SocketAddr) -> io::Result<Peer> {
        let short = [Errno::MFILE, Errno::NFILE, Errno::NOBUFS, Errno::NOMEM];
        let uid = match owner::of(stream) {
            Ok(uid) => Some(uid),
            Err(e) if Errno::from_io_error(&e).is_some_and(|errno| short.contains(&errno)) => return Err(e),
            Err(e) => {
                log::debug!("whose {addr} is cannot be told: {e}");
                None
            }
        };
        Ok(Peer { from: From::Address(addr), uid, holder: None, is_cut: Arc::default() })
    }

    pub(super) fn of_unix(stream: &UnixStream) -> Peer {
        let known = stream.peer_cred().inspect_err(|e| log::debug!("who calls cannot be told: {e}")).ok();
        let pid = known.as_ref().and_then(tokio::net::unix::UCred::pid);
        Peer {
            from: From::Socket { pid },
            uid: known.map(|known| known.uid()),
            holder: None,
            is_cut: Arc::default(),
        }
    }

    pub(super) fn of_holder(holder: Arc<Holder>, addr: SocketAddr) -> Peer {
        Peer { from: From::Address(addr), uid: None, holder: Some(holder), is_cut: Arc::default() }
    }

    /// The holder of the certificate that it has shown, if it was asked for one.
    pub(super) fn holder(&self) -> Option<&Arc<Holder>> {
        self.holder.as_ref()
    }

    /// The user of its program, as the kernel has it.
    pub(super) fn user(&self) -> Option<u32> {
        self.uid
    }

    /// Notes why its connection ended: of one that it has ended itself, the kernel of its machine says so.
    pub(super) fn note_end(&self, e: &io::Error) {
        let lost = [
            io::ErrorKind::TimedOut,
            io::ErrorKind::HostUnreachable,
            io::ErrorKind::NetworkUnreachable,
            io::ErrorKind::NetworkDown,
        ];
        if lost.contains(&e.kind()) {
            self.is_cut.store(true, Ordering::Release);
        }
    }

    /// Tells whether the network has lost its connection: it may be there all the same.
    pub(super) fn is_cut(&self) -> bool {
        self.is_cut.load(Ordering::Acquire)
    }

    /// This user's own program, or root's.
    pub(super) fn is_of(&self, user: u32) -> bool {
        self.uid.is_some_and(|uid| uid == user || uid == 0)
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.holder, self.uid) {
            (Some(holder), _) => write!(f, "{holder}")?,
            (None, Some(uid)) => write!(f, "user {uid}")?,
            (None, None) => f.write_str("an unknown user")?,
        }
        match &self.from {
            From::Address(addr) => write!(f, " at {addr}"),
            From::Socket { pid: Some(pid) } => write!(f, " by process {pid}"),
            From::Socket { pid: None } => Ok(()),
        }
    }
}

/// The user this process runs as.
pub(super) fn own_user() -> u32 {
    rustix::process::geteuid().as_raw()
}
