//! The user whose program is the peer of a TCP connection of this machine: the kernel knows, and is asked.
//!
//! Invariant: a user is returned only for a socket that is in use now and stayed in use during the question.
//! A socket that its program has closed belongs to nobody (the kernel then says user 0), and after a reset
//! the next connection may have the same two addresses.

use std::io;
use std::net::SocketAddr;
use std::os::fd::{AsFd, OwnedFd};

use netlink_packet_core::{NLM_F_REQUEST, NetlinkHeader, NetlinkMessage, NetlinkPayload};
use netlink_packet_sock_diag::SockDiagMessage;
use netlink_packet_sock_diag::constants::{AF_INET, AF_INET6, IPPROTO_TCP, TCP_ESTABLISHED};
use netlink_packet_sock_diag::inet::{ExtensionFlags, InetRequest, InetResponseHeader, SocketId, StateFlags};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, netlink, recv, send, socket_with,
};
use tokio::net::TcpStream;

/// Room for one answer about one socket.
const ANSWER: usize = 4096;
/// A kernel that takes the question answers it before `send` comes back.
const AT_ONCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 0 };

/// Returns the user whose program holds the remote end of `stream`.
///
/// # Errors
/// The kernel answers no such questions here, or the caller has gone meanwhile.
pub(super) fn of(stream: &TcpStream) -> io::Result<u32> {
    let (own, other) = (stream.local_addr()?, stream.peer_addr()?);
    let diagnosis = open()?;
    let first = ask(&diagnosis, other, own)?;
    let again = ask(&diagnosis, other, own)?;
    if first.socket_id.cookie != again.socket_id.cookie || first.uid != again.uid {
        return Err(gone());
    }
    if !is_whole(stream)? {
        return Err(gone());
    }
    Ok(first.uid)
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::NotConnected, "the caller has closed its end")
}

fn open() -> io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let kind = Some(netlink::SOCK_DIAG);
    Ok(socket_with(AddressFamily::NETLINK, SocketType::DGRAM, flags, kind)?)
}

/// The kernel's answer about the socket from `source` to `destination`.
fn ask(diagnosis: &OwnedFd, source: SocketAddr, destination: SocketAddr) -> io::Result<InetResponseHeader> {
    send(diagnosis, &question(source, destination), SendFlags::empty())?;
    let mut waiting = [PollFd::new(diagnosis, PollFlags::IN)];
    if poll(&mut waiting, Some(&AT_ONCE))? == 0 {
        return Err(io::Error::new(
            io::ErrorKind::Unsupported,
            "the kernel does not say whose a connection is",
        ));
    }
    let mut answer = [0; ANSWER];
    let (_, length) = recv(diagnosis, &mut answer[..], RecvFlags::empty())?;
    let socket = read(answer.get(..length).unwrap_or_default())?;
    // Without an inode no program holds it.
    if socket.state != TCP_ESTABLISHED || socket.inode == 0 {
        return Err(gone());
    }
    Ok(socket)
}

fn question(source: SocketAddr, destination: SocketAddr) -> Vec<u8> {
    let socket_id = SocketId {
        source_port: source.port(),
        destination_port: destination.port(),
        source_address: source.ip(),
        destination_address: destination.ip(),
        interface_id: 0,
        cookie: [0xff; 8],
    };
    let request = InetRequest {
        family: if source.is_ipv4() { AF_INET } else { AF_INET6 },
        protocol: IPPROTO_TCP,
        extensions: ExtensionFlags::empty(),
        states: StateFlags::all(),
        socket_id,
    };
    let mut header = NetlinkHeader::default();
    header.flags = NLM_F_REQUEST;
    let mut message = NetlinkMessage::new(header, SockDiagMessage::InetRequest(request).into());
    message.finalize();
    let mut bytes = vec![0; message.buffer_len()];
    message.serialize(&mut bytes);
    bytes
}

fn read(answer: &[u8]) -> io::Result<InetResponseHeader> {
    let unread = |why: String| io::Error::new(io::ErrorKind::InvalidData, why);
    let message =
        NetlinkMessage::<SockDiagMessage>::deserialize(answer).map_err(|e| unread(e.to_string()))?;
    match message.payload {
        NetlinkPayload::InnerMessage(SockDiagMessage::InetResponse(told)) => Ok(told.header),
        NetlinkPayload::Error(refused) => Err(refused.to_io()),
        other => Err(unread(format!("the kernel answered {other:?}"))),
    }
}

/// Neither end was closed or reset.
fn is_whole(stream: &TcpStream) -> io::Result<bool> {
    let ends = PollFlags::RDHUP | PollFlags::HUP | PollFlags::ERR;
    let fd = stream.as_fd();
    let mut looked = [PollFd::new(&fd, ends)];
    poll(&mut looked, Some(&AT_ONCE))?;
    Ok(!looked[0].revents().intersects(ends))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use tokio::io::AsyncWriteExt;
    use tokio::net::TcpListener;

    use super::*;

    fn own() -> u32 {
        rustix::process::geteuid().as_raw()
    }

    async fn pair(listen: &str) -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind(listen).await.unwrap();
        let caller = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        (listener.accept().await.unwrap().0, caller)
    }

    #[tokio::test]
    async fn a_caller_of_this_user_is_told_by_its_number() {
        let (here, _caller) = pair("127.0.0.1:0").await;
        assert_eq!(of(&here).unwrap(), own());
    }

    #[tokio::test]
    async fn a_caller_by_a_socket_of_both_families_is_told_too() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let socket = tokio::net::TcpSocket::new_v6().unwrap();
        let mapped = format!("[::ffff:127.0.0.1]:{}", listener.local_addr().unwrap().port());
        let _caller = socket.connect(mapped.parse().unwrap()).await.unwrap();
        let here = listener.accept().await.unwrap().0;
        assert_eq!(of(&here).unwrap(), own());
    }

    #[tokio::test]
    async fn whoever_asked_and_closed_at_once_is_nobody_although_the_kernel_says_root() {
        let (here, mut caller) = pair("127.0.0.1:0").await;
        caller.write_all(b"a request").await.unwrap();
        drop(caller);
        assert!(of(&here).is_err());
    }

    #[tokio::test]
    async fn whoever_asked_and_reset_the_connection_is_nobody_though_another_has_its_address_now() {
        // An address of this process alone: of others, any program of the machine may be given a port that is
        // free for a moment.
        let [_, b, c, d] = std::process::id().to_be_bytes();
        let alone = std::net::SocketAddr::from(([127, 64 | b, c, d | 1], 0));
        let listener = TcpListener::bind(alone).await.unwrap();
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind(alone).unwrap();
        let mut caller = socket.connect(listener.local_addr().unwrap()).await.unwrap();
        let here = listener.accept().await.unwrap().0;
        drop(listener);
        let (to, from) = (here.local_addr().unwrap(), here.peer_addr().unwrap());
        caller.write_all(b"a request").await.unwrap();
        caller.set_zero_linger().unwrap();
        drop(caller);
        // A socket of the same two addresses is made by binding both ends.
        let listener = tokio::net::TcpSocket::new_v4().unwrap();
        listener.set_reuseaddr(true).unwrap();
        listener.bind(to).unwrap();
        let listener = listener.listen(1).unwrap();
        let next = tokio::net::TcpSocket::new_v4().unwrap();
        next.set_reuseaddr(true).unwrap();
        next.bind(from).unwrap();
        let _next = next.connect(to).await.unwrap();
        let there = listener.accept().await.unwrap().0;
        assert_eq!(of(&there).unwrap(), own(), "the one that is there now");
        assert!(of(&here).is_err(), "the one that was reset");
    }
}
