//! One encrypted connection of bytes, and the messages in it.
//!
//! A message is its length (u32, little-endian, of what follows), its kind (one byte) and its content. Two
//! threads use a connection: one sends, one receives. Invariant: no length of the other end's is made room
//! for before it was compared with [`MOST_BYTES`].

use std::io::{self, BufRead, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rustix::io::retry_on_intr;
use rustix::net::{SendFlags, send, sockopt};
use rustls::Connection;
use trocar_rt::os::{set_most_rate, set_most_unsent, set_priority};

use super::greeting::Refused;
use crate::holder::Holder;
use crate::tls::said;

/// The longest content of a message: a frame of a large camera fits.
pub const MOST_BYTES: usize = 64 << 20;
/// The longest message of a greeting.
pub(super) const MOST_GREETING: usize = 4096;
/// Bytes of length and kind.
const HEAD: usize = 5;
/// Bytes of room that stay for the next messages in any case.
const KEPT: usize = 1 << 20;
/// Bytes that are encrypted before the receiving thread may come in between.
const AT_ONCE: usize = 64 << 10;
/// As above, where bytes are to leave evenly: what the card is given at once, it sends at once.
const EVENLY: usize = 16 << 10;
/// Uses of some room after which what none of them needed is given back.
const USES: u32 = 64;

/// The need of some room: one large message does not keep it for ever, and a stream of them does
/// not ask the kernel for it again and again.
#[derive(Debug, Default)]
struct Needed {
    most: usize,
    uses: u32,
}

impl Needed {
    /// Empties the room after a use.
    fn clear(&mut self, room: &mut Vec<u8>) {
        self.most = self.most.max(room.len());
        self.uses += 1;
        room.clear();
        if self.uses >= USES {
            room.shrink_to(self.most.max(KEPT));
            *self = Needed::default();
        }
    }
}

/// Messages on their way out.
#[derive(Debug, Default)]
pub struct Outbox {
    bytes: Vec<u8>,
    needed: Needed,
}

impl Outbox {
    /// Appends a message; `fill` appends its content.
    pub fn message(&mut self, kind: u8, fill: impl FnOnce(&mut Vec<u8>)) {
        let start = self.bytes.len();
        self.bytes.extend_from_slice(&[0, 0, 0, 0, kind]);
        fill(&mut self.bytes);
        let length = (self.bytes.len() - start - 4) as u32;
        self.bytes[start..start + 4].copy_from_slice(&length.to_le_bytes());
    }

    /// Bytes that wait to be sent.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    pub(super) fn clear(&mut self) {
        self.needed.clear(&mut self.bytes);
    }

    /// The messages as they are sent.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Messages that came, as far as they are complete.
#[derive(Debug, Default)]
pub(super) struct Inbox {
    bytes: Vec<u8>,
    /// Bytes that were handed out.
    done: usize,
    needed: Needed,
}

impl Inbox {
    /// The next complete message: its kind and content.
    ///
    /// # Errors
    /// It would be longer than `most`, or has no kind.
    pub(super) fn next(&mut self, most: usize) -> Result<Option<(u8, &[u8])>, String> {
        let rest = self.bytes.len() - self.done;
        let Some(length) = self.bytes[self.done..].first_chunk().map(|length| u32::from_le_bytes(*length))
        else {
            self.tidy();
            return Ok(None);
        };
        let length = length as usize;
        if length == 0 || length > most {
            return Err(format!("a message of {length} bytes, where 1 to {most} are possible"));
        }
        if rest < HEAD - 1 + length {
            self.tidy();
            return Ok(None);
        }
        let start = self.done + HEAD - 1;
        self.done = start + length;
        Ok(Some((self.bytes[start], &self.bytes[start + 1..start + length])))
    }

    /// Moves what is not complete to the front.
    fn tidy(&mut self) {
        let done = std::mem::take(&mut self.done);
        if done == 0 {
            return;
        }
        if done == self.bytes.len() {
            self.needed.clear(&mut self.bytes);
        } else {
            self.needed.most = self.needed.most.max(self.bytes.len());
            self.bytes.drain(..done);
        }
    }
}

/// The rank of a connection's packets beside others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rank {
    /// In the queues of this machine.
    pub(super) priority: u8,
    /// In those of switches: the byte of the IP header.
    pub(super) class: u8,
    /// Bytes that may wait in the kernel.
    pub(super) most_unsent: u32,
    /// Bytes/s.
    pub(super) most_rate: Option<u64>,
}

pub(super) struct Wire {
    stream: TcpStream,
    tls: Mutex<Connection>,
    /// Bytes leave evenly.
    evenly: AtomicBool,
}

/// Result of one look at a connection.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Came {
    Bytes,
    Nothing,
    End,
}

impl Wire {
    /// Shows this side's certificate and looks at the other one's; returns whose it is.
    ///
    /// # Errors
    /// The sentence why nothing comes of it.
    pub(super) fn greeted(
        stream: TcpStream,
        tls: Connection,
        until: Instant,
    ) -> Result<(Wire, Holder, Inbox), Refused> {
        stream.set_nodelay(true).map_err(|e| e.to_string())?;
        let left = until.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
        stream.set_write_timeout(Some(left)).map_err(|e| e.to_string())?;
        let mut wire = Wire { stream, tls: Mutex::new(tls), evenly: AtomicBool::new(false) };
        let (mut room, mut inbox) = ([0; 4096], Inbox::default());
        while wire.tls.get_mut().is_handshaking() {
            wire.flush().map_err(|e| e.to_string())?;
            if !wire.tls.get_mut().is_handshaking() {
                break;
            }
            let n = wire.read(&mut room, until)?;
            // A quick caller's greeting comes along with the end of its handshake.
            wire.take_in(&room[..n], &mut inbox)?;
        }
        wire.flush().map_err(|e| e.to_string())?;
        let certificates = wire.tls.get_mut().peer_certificates().unwrap_or_default();
        let shown = certificates.first().ok_or_else(|| "it shows no certificate".to_owned())?;
        let holder = Holder::of(shown)?;
        Ok((wire, holder, inbox))
    }

    /// Waits for bytes until then.
    fn read(&mut self, room: &mut [u8], until: Instant) -> Result<usize, String> {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err("it takes too long to greet".into());
            }
            let _ = self.stream.set_read_timeout(Some(left));
            match self.stream.read(room) {
                Ok(0) => return Err("it ended the connection".into()),
                Ok(n) => return Ok(n),
                Err(e) if is_nothing(&e) => {}
                Err(e) => return Err(e.to_string()),
            }
        }
    }

    /// Waits for one message of a greeting.
    pub(super) fn hear(&mut self, inbox: &mut Inbox, until: Instant) -> Result<(u8, Vec<u8>), Refused> {
        let mut room = [0; 4096];
        loop {
            if let Some((kind, content)) = inbox.next(MOST_GREETING)? {
                return Ok((kind, content.to_vec()));
            }
            let n = self.read(&mut room, until)?;
            self.take_in(&room[..n], inbox)?;
        }
    }

    /// Sets the rank of its packets in this machine's queues and in those of switches, and how many bytes
    /// lie in the kernel where a newer sample can no longer take their place. A network that takes none of
    /// it is a slower one.
    pub(super) fn rank(&self, Rank { priority, class, most_unsent, most_rate }: Rank) {
        let socket = self.stream.as_fd();
        // A socket of version 6 may carry packets of version 4.
        let _ = sockopt::set_ipv6_tclass(socket, class.into());
        let _ = sockopt::set_ip_tos(socket, class);
        // The class has set another one.
        let _ = set_priority(socket, priority);
        let _ = set_most_unsent(socket, most_unsent);
        if let Some(rate) = most_rate {
            let _ = set_most_rate(socket, rate);
            self.evenly.store(true, Ordering::Relaxed);
        }
    }

    /// Sets how long [`Wire::receive`] waits at most for a byte, and [`Wire::send`] until one is taken.
    pub(super) fn wait_for(&self, come: Duration, go: Duration) -> io::Result<()> {
        self.stream.set_read_timeout(Some(come))?;
        self.stream.set_write_timeout(Some(go))
    }

    /// Looks for bytes, for the receiving thread.
    pub(super) fn receive(&self, room: &mut [u8], inbox: &mut Inbox) -> Result<Came, String> {
        match (&self.stream).read(room) {
            Ok(0) => Ok(Came::End),
            Ok(n) => self.take_in(&room[..n], inbox).map(|()| Came::Bytes).map_err(|refused| refused.why),
            Err(e) if is_nothing(&e) => Ok(Came::Nothing),
            Err(e) => Err(e.to_string()),
        }
    }

    fn take_in(&self, mut bytes: &[u8], inbox: &mut Inbox) -> Result<(), Refused> {
        let mut tls = self.tls.lock();
        while !bytes.is_empty() {
            // After the other end has taken leave nothing more is read.
            if tls.read_tls(&mut bytes).map_err(|e| e.to_string())? == 0 {
                return Err("it ended the connection".to_owned().into());
            }
            if let Err(e) = tls.process_new_packets() {
                // The other end is told why.
                let mut alert = Vec::new();
                let _ = tls.write_tls(&mut alert);
                drop(tls);
                let _ = (&self.stream).write_all(&alert);
                return Err(Refused { why: said(&e), for_long: true });
            }
            let mut reader = tls.reader();
            while let Ok(piece) = reader.fill_buf()
                && !piece.is_empty()
            {
                inbox.bytes.extend_from_slice(piece);
                let taken = piece.len();
                reader.consume(taken);
            }
        }
        Ok(())
    }

    /// Sends these messages, for the sending thread.
    ///
    /// # Errors
    /// The connection is over.
    pub(super) fn send(&self, mut bytes: &[u8]) -> io::Result<()> {
        // The kernel joins no two pieces that end so.
        let (most, flags) = match self.evenly.load(Ordering::Relaxed) {
            true => (EVENLY, SendFlags::NOSIGNAL | SendFlags::EOR),
            false => (AT_ONCE, SendFlags::NOSIGNAL),
        };
        let mut sealed = Vec::with_capacity(bytes.len().min(most) + 1024);
        while !bytes.is_empty() {
            let mut tls = self.tls.lock();
            let n = tls.writer().write(&bytes[..bytes.len().min(most)])?;
            bytes = &bytes[n..];
            sealed.clear();
            while tls.wants_write() {
                tls.write_tls(&mut sealed)?;
            }
            drop(tls);
            let mut rest = &sealed[..];
            while !rest.is_empty() {
                let sent = retry_on_intr(|| send(&self.stream, rest, flags))?;
                rest = &rest[sent..];
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        let (tls, stream) = (self.tls.get_mut(), &mut self.stream);
        while tls.wants_write() {
            tls.write_tls(stream)?;
        }
        Ok(())
    }

    /// Ends it, for both threads and the other end.
    pub(super) fn end(&self) {
        // It may have ended already.
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

/// Tells whether an attempt came to nothing for now.
pub(super) fn is_nothing(e: &io::Error) -> bool {
    matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn messages_come_out_as_they_went_in_however_they_are_cut() {
        let mut out = Outbox::default();
        out.message(1, |content| content.extend_from_slice(b"one"));
        out.message(2, |_| {});
        out.message(3, |content| content.extend(vec![7; 70_000]));
        for step in [1, 4, 5, 1000, 100_000] {
            let (mut inbox, mut seen) = (Inbox::default(), Vec::new());
            for piece in out.bytes().chunks(step) {
                inbox.bytes.extend_from_slice(piece);
                while let Some((kind, content)) = inbox.next(MOST_BYTES).unwrap() {
                    seen.push((kind, content.len()));
                }
            }
            assert_eq!(seen, [(1, 3), (2, 0), (3, 70_000)], "in pieces of {step}");
            assert!(inbox.bytes.is_empty());
        }
    }

    #[test]
    fn a_length_that_cannot_be_is_refused_before_there_is_room_for_it() {
        for length in [0, MOST_BYTES as u32 + 1, u32::MAX] {
            let mut inbox = Inbox { bytes: length.to_le_bytes().to_vec(), ..Inbox::default() };
            assert!(inbox.next(MOST_BYTES).unwrap_err().contains("bytes"), "{length}");
        }
    }
}
