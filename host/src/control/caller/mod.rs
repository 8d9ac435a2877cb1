//! Who is at the other end of a connection of the port, and what that one may ask.
//!
//! Invariant: the kernel says who it is; what a caller says of itself counts only as far as it holds the
//! token of this host's user. A caller nobody knows may read, and nothing else.

mod access;
mod bearer;
mod owner;

use std::fmt;
use std::net::SocketAddr;

use tokio::net::{TcpStream, UnixStream};

pub(super) use self::access::{Access, OnlyReads, only_allowed};
pub use self::bearer::Tokened;
pub(super) use self::bearer::with_token;

/// The other end of a connection. Every request that comes over it carries one.
#[derive(Clone, Debug)]
pub(super) struct Peer {
    from: From,
    /// `None`: the kernel does not say.
    uid: Option<u32>,
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
    pub(super) fn of_tcp(stream: &TcpStream, addr: SocketAddr) -> Peer {
        let uid = owner::of(stream).inspect_err(|e| log::debug!("whose {addr} is cannot be told: {e}")).ok();
        Peer { from: From::Address(addr), uid }
    }

    pub(super) fn of_unix(stream: &UnixStream) -> Peer {
        let known = stream.peer_cred().inspect_err(|e| log::debug!("who calls cannot be told: {e}")).ok();
        let pid = known.as_ref().and_then(tokio::net::unix::UCred::pid);
        Peer { from: From::Socket { pid }, uid: known.map(|known| known.uid()) }
    }

    /// This user's own program, or root's.
    pub(super) fn is_of(&self, user: u32) -> bool {
        self.uid.is_some_and(|uid| uid == user || uid == 0)
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.uid {
            Some(uid) => write!(f, "user {uid}")?,
            None => f.write_str("an unknown user")?,
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
