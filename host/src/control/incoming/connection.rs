//! A connection of the port: its bytes, and whether its caller has asked anything yet.
//!
//! Invariant: a caller that does not ask within [`PATIENCE`] is let go, as is a caller that gives its place
//! to another; a caller that has asked once keeps its connection, whatever it does then, unless its
//! certificate is revoked. Opening HTTP/2 does not count as asking.

use std::io::{self, IoSlice};
use std::pin::{Pin, pin};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio::time::{Sleep, sleep};
use tokio_rustls::server::TlsStream;
use tonic::transport::server::Connected;
use trocar_rt::os::{Unshared, unshared};

use super::seats::Seat;
use super::secure::Belief;
use crate::control::caller::Peer;

/// Time a caller has for its first request.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// The ways to a port.
#[derive(Debug)]
pub(super) enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
    Tls(Box<TlsStream<TcpStream>>),
}

/// A caller that was let in.
#[derive(Debug)]
pub(crate) struct Connection {
    /// A forked child that kept it would keep its caller waiting after the end of this process.
    _unshared: Unshared,
    stream: Stream,
    peer: Peer,
    seat: Seat,
    /// Until when its certificate is believed; `None`: it has shown none.
    belief: Option<Belief>,
    /// The first request as far as it has come, and the time limit for it; `None` once it has come.
    silence: Option<(Head, Pin<Box<Sleep>>)>,
}

impl Connection {
    pub(super) fn new(stream: Stream, peer: Peer, seat: Seat) -> Connection {
        let silence = Some((Head::default(), Box::pin(sleep(PATIENCE))));
        let _unshared = match &stream {
            Stream::Tcp(stream) => unshared(stream),
            Stream::Unix(stream) => unshared(stream),
            Stream::Tls(stream) => unshared(stream.get_ref().0),
        };
        Connection { _unshared, stream, peer, seat, belief: None, silence }
    }

    /// Ends when it is believed no more.
    pub(super) fn believed(self, belief: Belief) -> Connection {
        Connection { belief: Some(belief), ..self }
    }

    /// Notes how its connection ended, where that is the outcome.
    fn noted<T>(&self, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if let Poll::Ready(Err(e)) = &written {
            self.peer.note_end(e);
        }
        written
    }

    /// # Errors
    /// The caller is not believed any more: nothing is read of it, and nothing told to it.
    fn is_believed(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        let is_over = self.belief.as_mut().is_some_and(|belief| belief.poll_over(cx));
        let revoked = || io::Error::new(io::ErrorKind::ConnectionAborted, "its certificate was revoked");
        if is_over { Err(revoked()) } else { Ok(()) }
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
        this.is_believed(cx)?;
        let before = buf.filled().len();
        let read = match &mut this.stream {
            Stream::Tcp(stream) => Pin::new(stream).poll_read(cx, buf),
            Stream::Unix(stream) => Pin::new(stream).poll_read(cx, buf),
            Stream::Tls(stream) => Pin::new(stream).poll_read(cx, buf),
        };
        if let Poll::Ready(Err(e)) = &read {
            this.peer.note_end(e);
        }
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
            // The caller's bytes end here, as if it had closed its end.
            return Poll::Ready(Ok(()));
        }
        Poll::Pending
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        this.is_believed(cx)?;
        let written = match &mut this.stream {
            Stream::Tcp(stream) => pin!(stream).poll_write(cx, buf),
            Stream::Unix(stream) => pin!(stream).poll_write(cx, buf),
            Stream::Tls(stream) => pin!(stream).poll_write(cx, buf),
        };
        this.noted(written)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        this.is_believed(cx)?;
        let written = match &mut this.stream {
            Stream::Tcp(stream) => pin!(stream).poll_write_vectored(cx, bufs),
            Stream::Unix(stream) => pin!(stream).poll_write_vectored(cx, bufs),
            Stream::Tls(stream) => pin!(stream).poll_write_vectored(cx, bufs),
        };
        this.noted(written)
    }

    fn is_write_vectored(&self) -> bool {
        match &self.stream {
            Stream::Tcp(stream) => stream.is_write_vectored(),
            Stream::Unix(stream) => stream.is_write_vectored(),
            Stream::Tls(stream) => stream.is_write_vectored(),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        this.is_believed(cx)?;
        let flushed = match &mut this.stream {
            Stream::Tcp(stream) => pin!(stream).poll_flush(cx),
            Stream::Unix(stream) => pin!(stream).poll_flush(cx),
            Stream::Tls(stream) => pin!(stream).poll_flush(cx),
        };
        this.noted(flushed)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        this.is_believed(cx)?;
        match &mut this.stream {
            Stream::Tcp(stream) => pin!(stream).poll_shutdown(cx),
            Stream::Unix(stream) => pin!(stream).poll_shutdown(cx),
            Stream::Tls(stream) => pin!(stream).poll_shutdown(cx),
        }
    }
}

/// The head of a first request as far as it has come. HTTP/1 ends it by an empty line; HTTP/2 opens with a
/// fixed text, which asks nothing yet, and ends it in a frame.
#[derive(Debug, Default)]
struct Head {
    heard: usize,
    last: [u8; 4],
    /// Something else than the text that opens HTTP/2 was heard.
    is_http1: bool,
    frames: Frames,
    ended: bool,
}

/// The text that opens HTTP/2 (RFC 9113, section 3.4); its first word is no method of ours.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

impl Head {
    fn hear(&mut self, said: &[u8]) {
        let opening = PREFACE.get(self.heard..).unwrap_or_default();
        let frames = said.get(opening.len()..).unwrap_or_default();
        self.is_http1 |= opening.iter().zip(said).any(|(expected, byte)| expected != byte);
        self.heard = self.heard.saturating_add(said.len());
        if !self.is_http1 {
            self.ended |= self.frames.hear(frames);
            return;
        }
        for byte in said {
            self.last.rotate_left(1);
            self.last[3] = *byte;
            self.ended |= self.last == *b"\r\n\r\n";
        }
    }

    fn is_whole(&self) -> bool {
        self.ended
    }
}

/// Frames of HTTP/2 as far as they have come (RFC 9113, section 4.1): settings and pings ask nothing.
#[derive(Debug, Default)]
struct Frames {
    /// Length, type, flags and stream of the present one, and how much of that was heard.
    head: [u8; 9],
    heard: usize,
    /// Bytes of the present one that are still to come behind its head.
    left: usize,
}

const HEADERS: u8 = 1;
const CONTINUATION: u8 = 9;
const END_HEADERS: u8 = 4;

impl Frames {
    /// Returns true when the headers of a request have ended in these bytes.
    fn hear(&mut self, mut said: &[u8]) -> bool {
        while let Some((byte, rest)) = said.split_first() {
            if let Some(place) = self.head.get_mut(self.heard) {
                *place = *byte;
                self.heard += 1;
                said = rest;
                let [a, b, c, ..] = self.head;
                self.left = u32::from_be_bytes([0, a, b, c]) as usize;
            } else {
                let heard = self.left.min(said.len());
                self.left -= heard;
                said = said.get(heard..).unwrap_or_default();
            }
            if self.heard == self.head.len() && self.left == 0 {
                let [_, _, _, kind, flags, ..] = self.head;
                if [HEADERS, CONTINUATION].contains(&kind) && flags & END_HEADERS != 0 {
                    return true;
                }
                self.heard = 0;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::{CONTINUATION, END_HEADERS, HEADERS, Head, PREFACE};

    fn heard(parts: &[&[u8]]) -> bool {
        let mut head = Head::default();
        parts.iter().for_each(|part| head.hear(part));
        head.is_whole()
    }

    fn frame(kind: u8, flags: u8, payload: &[u8]) -> Vec<u8> {
        let [_, length @ ..] = (payload.len() as u32).to_be_bytes();
        [&length[..], &[kind, flags, 0, 0, 0, 1], payload].concat()
    }

    /// A caller over HTTP/2 that asks says: settings, a window, the headers in two frames.
    fn asks() -> Vec<u8> {
        let settings = frame(4, 0, &[0, 3, 0, 0, 0, 1]);
        let window = frame(8, 0, &[0, 0, 0, 1]);
        let begin = frame(HEADERS, 0, b"\r\n\r\n");
        [PREFACE, &settings, &window, &begin, &frame(CONTINUATION, END_HEADERS, &[7; 300])].concat()
    }

    #[test]
    fn a_question_is_whole_at_the_end_of_its_head_however_it_comes_in() {
        assert!(heard(&[b"GET / HTTP/1.0\r\n\r\n"]));
        assert!(heard(&[b"G", b"ET / HTTP/1.1\r\nHost: x\r\n\r", b"\n"]));
        assert!(heard(&[b"P", b"OST / HTTP/1.1\r\n\r\n"]));
        let asks = asks();
        for size in 1..=asks.len() {
            let parts: Vec<&[u8]> = asks.chunks(size).collect();
            assert!(heard(&parts), "in pieces of {size} bytes");
            assert!(!heard(&parts[..parts.len() - 1]), "without the last of pieces of {size} bytes");
        }
    }

    #[test]
    fn half_a_question_is_none_and_neither_is_what_only_opens_a_connection() {
        let halves: [&[&[u8]]; 5] =
            [&[], &[b"G"], &[b"GET / HTTP/1.1\r\nHost: x\r\n"], &[&PREFACE[..18]], &[&PREFACE[..3]]];
        for parts in halves {
            assert!(!heard(parts), "{parts:?}");
        }
        assert!(!heard(&[PREFACE]) && !heard(&[b"P", &PREFACE[1..]]), "the opening text alone");
        let pings = [PREFACE, &frame(4, 0, &[]), &frame(6, 0, &[0; 8]).repeat(100)].concat();
        assert!(!heard(&[&pings]), "settings and pings");
    }
}
