//! Callers of the port, as they are let in.
//!
//! Invariant: an error of accepting never ends the port and is never answered by trying again at once: the
//! kernel keeps the caller waiting, so the next try would fail the same way, and a thread would do nothing
//! else.

mod connection;
mod seats;
mod secure;

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::io::{Errno, fcntl_dupfd_cloexec};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Sleep, sleep};
use trocar_links::Seldom;
use trocar_rt::os::{Unshared, now_ns, unshared};

pub(super) use self::connection::Connection;
use self::connection::Stream;
use self::seats::{Guest, Seats};
pub(super) use self::secure::Secure;
use super::caller::Peer;
use crate::runtime_dir::Placed;

/// Pause of letting callers in where the process may open no more files.
const PAUSE: Duration = Duration::from_millis(100);
/// Pause until a caller that was let go has closed its file.
const TURN: Duration = Duration::from_millis(1);
/// Files that are opened early, so that this many callers of a socket can be let in when no other file is
/// left.
const SPARE: usize = 4;

/// The listening socket.
enum Listener {
    Tcp(TcpListener),
    /// Files that give way to callers.
    Unix(Placed, Vec<File>),
}

/// Connections without Nagle's delay. Without a file or memory for a connection, its caller waits in the
/// kernel's queue and is let in as soon as there is one: to hang up would tell the caller nothing either, and
/// cost it the call.
pub(super) struct Incoming {
    _unshared: Option<Unshared>,
    listener: Listener,
    /// The user whose programs are no guests.
    user: u32,
    seats: Arc<Seats>,
    /// Let in, but with one of the last files.
    held: Option<TcpStream>,
    pause: Option<Pin<Box<Sleep>>>,
    nobody: Seldom,
    guests: Seldom,
    own: Seldom,
}

impl Incoming {
    pub(super) fn tcp(listener: TcpListener, user: u32) -> Incoming {
        Incoming::new(Listener::Tcp(listener), user)
    }

    pub(super) fn unix(listener: Placed, user: u32) -> Incoming {
        let mut incoming = Incoming::new(Listener::Unix(listener, Vec::new()), user);
        incoming.provide();
        incoming
    }

    fn new(listener: Listener, user: u32) -> Incoming {
        let seats = Arc::default();
        let [nobody, guests, own] = [(); 3].map(|()| Seldom::default());
        let _unshared = match &listener {
            Listener::Tcp(listener) => Some(unshared(listener)),
            // Looks after that by itself.
            Listener::Unix(..) => None,
        };
        Incoming { _unshared, listener, user, seats, held: None, pause: None, nobody, guests, own }
    }

    /// Opens the spare files anew, as far as possible.
    fn provide(&mut self) {
        let Listener::Unix(_, spare) = &mut self.listener else { return };
        while spare.len() < SPARE
            && let Ok(file) = File::open("/dev/null")
        {
            spare.push(file);
        }
    }

    /// The next caller with its file.
    fn poll_stream(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<(Stream, Peer)>> {
        let stream = match &mut self.listener {
            Listener::Unix(listener, _) => {
                let stream = ready!(listener.poll_accept(cx))?;
                let peer = Peer::of_unix(&stream);
                return Poll::Ready(Ok((Stream::Unix(stream), peer)));
            }
            Listener::Tcp(listener) => match self.held.take() {
                Some(held) => lower(held)?,
                None => ready!(listener.poll_accept(cx))?.0,
            },
        };
        let peer = match seats::is_of_the_last(stream.as_raw_fd()) {
            true => Err(Errno::MFILE.into()),
            false => stream.peer_addr().and_then(|addr| Peer::of_tcp(&stream, addr)),
        };
        let peer = match peer {
            Ok(peer) => peer,
            Err(e) => {
                // A caller is judged when there is a file for asking the kernel, and not as another user
                // before.
                self.held = is_short_of_files(&e).then_some(stream);
                return Poll::Ready(Err(e));
            }
        };
        if let Err(e) = stream.set_nodelay(true) {
            log::debug!("small answers to a caller may come late: {e}");
        }
        Poll::Ready(Ok((Stream::Tcp(stream), peer)))
    }

    /// Waits until a silent caller has given way, or for better times.
    fn wait(&mut self, e: &io::Error) {
        let somebody_went = is_short_of_files(e) && self.seats.give_up_one();
        if !somebody_went {
            self.nobody.warn(now_ns(), &why(e));
        }
        let pause = if somebody_went { TURN } else { PAUSE };
        self.pause = Some(Box::pin(sleep(pause)));
    }

    /// A place for it, if it may have one.
    fn seat(&mut self, stream: Stream, peer: Peer) -> Option<Connection> {
        let guest = (!peer.is_of(self.user)).then(|| Guest::User(peer.user()));
        let is_own = guest.is_none();
        match self.seats.take(guest) {
            Some(seat) => Some(Connection::new(stream, peer, seat)),
            None if is_own => {
                let most = seats::OWN;
                let why = format!(
                    "{peer} was sent away: this user's programs have {most} connections here, which is the most: end some \
                     (`ss -tnp` names them); `trocar stop` has a socket of its own"
                );
                self.own.warn(now_ns(), &why);
                None
            }
            None => {
                let most = seats::OF_ONE;
                let why = format!(
                    "{peer} was sent away: another user gets {most} connections, all of them together four times as many"
                );
                self.guests.warn(now_ns(), &why);
                None
            }
        }
    }
}

/// The same connection by the lowest number that is free now.
fn lower(stream: TcpStream) -> io::Result<TcpStream> {
    let stream = stream.into_std()?;
    let moved = fcntl_dupfd_cloexec(stream.as_fd(), 0);
    TcpStream::from_std(moved.map_or(stream, std::net::TcpStream::from))
}

impl tokio_stream::Stream for Incoming {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        loop {
            if let Some(pause) = &mut self.pause {
                ready!(pause.as_mut().poll(cx));
                self.pause = None;
            }
            match ready!(self.poll_stream(cx)) {
                Ok((stream, peer)) => {
                    self.provide();
                    if let Some(connection) = self.seat(stream, peer) {
                        return Poll::Ready(Some(Ok(connection)));
                    }
                }
                Err(e) if is_of_one_caller(&e) => {}
                Err(e) => {
                    if let Listener::Unix(_, spare) = &mut self.listener
                        && spare.pop().is_some()
                    {
                        continue;
                    }
                    self.wait(&e);
                }
            }
        }
    }
}

/// An error that went from the queue with its caller: the next one is another's.
fn is_of_one_caller(e: &io::Error) -> bool {
    let of_one =
        [Errno::CONNABORTED, Errno::CONNRESET, Errno::INTR, Errno::NOTCONN, Errno::PERM, Errno::PROTO];
    Errno::from_io_error(e).is_some_and(|errno| of_one.contains(&errno))
}

fn is_short_of_files(e: &io::Error) -> bool {
    Errno::from_io_error(e).is_some_and(|errno| [Errno::MFILE, Errno::NFILE].contains(&errno))
}

fn why(e: &io::Error) -> String {
    let help = match Errno::from_io_error(e) {
        Some(Errno::MFILE) => {
            "end callers, or let it open more files: `ulimit -n` before its start, `prlimit --pid PID --nofile=4096` \
             while it runs"
        }
        Some(Errno::NFILE) => "the machine has no more files: end programs, or raise `sysctl fs.file-max`",
        Some(Errno::NOMEM | Errno::NOBUFS) => "the machine has no more memory for sockets: end programs",
        _ => "it is tried again",
    };
    format!("new callers of the gRPC port wait, as none can be let in: {e}; {help}")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn what_befalls_one_caller_is_no_reason_to_wait_and_what_befalls_all_says_what_to_do() {
        for of_one in
            [Errno::CONNABORTED, Errno::CONNRESET, Errno::INTR, Errno::NOTCONN, Errno::PROTO, Errno::PERM]
        {
            assert!(is_of_one_caller(&of_one.into()), "{of_one}");
        }
        for (of_all, help) in [
            (Errno::MFILE, "ulimit -n"),
            (Errno::NFILE, "fs.file-max"),
            (Errno::NOMEM, "memory"),
            (Errno::NOBUFS, "memory"),
            (Errno::INVAL, "tried again"),
        ] {
            assert!(!is_of_one_caller(&of_all.into()), "{of_all}");
            let why = why(&of_all.into());
            assert!(why.contains(help) && why.contains("callers of the gRPC port wait"), "{why}");
        }
    }
}
