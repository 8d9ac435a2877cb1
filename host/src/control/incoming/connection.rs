//! A connection of the port: its bytes, and whether its caller has said anything yet.
//!
//! Invariant: a caller that does not ask within [`PATIENCE`] is let go, as is one that gives its place to
//! another; a caller that has asked once keeps its connection, whatever it does then.

use std::io::{self, IoSlice};
use std::pin::{Pin, pin};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio::time::{Sleep, sleep};
use tonic::transport::server::Connected;
use trocar_rt::os::{Unshared, unshared};

use super::seats::Seat;
use crate::control::caller::Peer;

/// Time a caller has to say what it wants.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// The ways to a port.
#[derive(Debug)]
pub(super) enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

/// A caller that was let in.
#[derive(Debug)]
pub(in crate::control) struct Connection {
    /// A forked child that kept it would keep its caller waiting after the end of this process.
    _unshared: Unshared,
    stream: Stream,
    peer: Peer,
    seat: Seat,
    /// The first question as far as it has come, and until when it is waited for; `None` once it has asked.
    silence: Option<(Head, Pin<Box<Sleep>>)>,
}

impl Connection {
    pub(super) fn new(stream: Stream, peer: Peer, seat: Seat) -> Connection {
        let silence = Some((Head::default(), Box::pin(sleep(PATIENCE))));
        let _unshared = match &stream {
            Stream::Tcp(stream) => unshared(stream),
            Stream::Unix(stream) => unshared(stream),
        };
        Connection { _unshared, stream, peer, seat, silence }
    }
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        let before = buf.filled().len();
        let read = match &mut this.stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_read(cx, buf),
            Stream::Unix(stream) => Pin::new(stream).poll_read(cx, buf),
        };
        let Some((head, patience)) = &mut this.silence else { return read };
        if read.is_ready() {
            head.hear(buf.filled().get(before..).unwrap_or_default());
            if head.is_whole() {
                this.silence = None;
                this.seat.speaks();
            }
            return read;
        }
        if patience.as_mut().poll(cx).is_ready() || this.seat.poll_given_up(cx).is_ready() {
            // The end of what it says, as if it had closed its end.
            return Poll::Ready(Ok(()));
        }
        Poll::Pending
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        match &mut self.get_mut().stream {
            Stream::Tcp(stream) => pin!(stream).poll_write(cx, buf),
            Stream::Unix(stream) => pin!(stream).poll_write(cx, buf),
        }
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match &mut self.get_mut().stream {
            Stream::Tcp(stream) => pin!(stream).poll_write_vectored(cx, bufs),
            Stream::Unix(stream) => pin!(stream).poll_write_vectored(cx, bufs),
        }
    }

    fn is_write_vectored(&self) -> bool {
        match &self.stream {
            Stream::Tcp(stream) => stream.is_write_vectored(),
            Stream::Unix(stream) => stream.is_write_vectored(),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.get_mut().stream {
            Stream::Tcp(stream) => pin!(stream).poll_flush(cx),
            Stream::Unix(stream) => pin!(stream).poll_flush(cx),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.get_mut().stream {
            Stream::Tcp(stream) => pin!(stream).poll_shutdown(cx),
            Stream::Unix(stream) => pin!(stream).poll_shutdown(cx),
        }
    }
}

/// The head of a first question as far as it has come. HTTP/1 ends it by an empty line; HTTP/2 opens with a
/// fixed text that holds one.
#[derive(Debug, Default)]
struct Head {
    heard: usize,
    last: [u8; 4],
    is_http2: bool,
    ended: bool,
}

/// Length of the text that opens HTTP/2 (RFC 9113, section 3.4); its first letter begins no method of ours.
const PREFACE: usize = "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".len();

impl Head {
    fn hear(&mut self, said: &[u8]) {
        if self.heard == 0 {
            self.is_http2 = said.starts_with(b"PR");
        }
        self.heard = self.heard.saturating_add(said.len());
        for byte in said {
            self.last.rotate_left(1);
            self.last[3] = *byte;
            self.ended |= self.last == *b"\r\n\r\n";
        }
    }

    fn is_whole(&self) -> bool {
        if self.is_http2 { self.heard >= PREFACE } else { self.ended }
    }
}

#[cfg(test)]
mod tests {
    use super::Head;

    fn heard(parts: &[&str]) -> bool {
        let mut head = Head::default();
        parts.iter().for_each(|part| head.hear(part.as_bytes()));
        head.is_whole()
    }

    #[test]
    fn a_question_is_whole_at_its_empty_line_however_it_comes_in() {
        assert!(heard(&["GET / HTTP/1.0\r\n\r\n"]));
        assert!(heard(&["G", "ET / HTTP/1.1\r\nHost: x\r\n\r", "\n"]));
        assert!(heard(&["PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n and frames"]));
        assert!(heard(&["PRI * HTTP/2.0\r\n\r\n", "SM\r\n\r\n"]));
    }

    #[test]
    fn half_a_question_is_none() {
        for parts in
            [&[][..], &["G"], &["GET / HTTP/1.1\r\nHost: x\r\n"], &["PRI * HTTP/2.0\r\n\r\n"], &["PRI"]]
        {
            assert!(!heard(parts), "{parts:?}");
        }
    }
}
