//! Messages over a socket: bytes, and the files that come along.
//!
//! Invariant: neither sending nor receiving waits, and what is too long is never taken in part.

use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{BorrowedFd, OwnedFd};

use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, ReturnFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags,
};

use crate::greeting::DATA_HEAD;

/// The longest message.
pub const MOST_BYTES: usize = 128 << 10;
/// Files that can come along with one message.
pub const MOST_FDS: usize = 32;

pub(crate) fn send(to: BorrowedFd<'_>, parts: &[&[u8]], files: &[BorrowedFd<'_>]) -> rustix::io::Result<()> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MOST_FDS))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    if !files.is_empty() && !control.push(SendAncillaryMessage::ScmRights(files)) {
        return Err(Errno::MSGSIZE);
    }
    let parts: Vec<IoSlice<'_>> = parts.iter().map(|part| IoSlice::new(part)).collect();
    let flags = SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
    rustix::net::sendmsg(to, &parts, &mut control, flags).map(|_| ())
}

/// Result of one look at a socket.
pub(crate) enum Heard {
    /// So many bytes of the buffer, and what came along.
    Message(usize, Vec<OwnedFd>),
    Nothing,
    End,
    TooLong,
}

/// Room for the longest message.
pub(crate) fn room() -> Vec<u8> {
    vec![0; MOST_BYTES + DATA_HEAD]
}

pub(crate) fn receive(from: BorrowedFd<'_>, room: &mut [u8]) -> Heard {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MOST_FDS))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let flags = RecvFlags::DONTWAIT | RecvFlags::CMSG_CLOEXEC;
    let mut resets = 0;
    let got = loop {
        match rustix::net::recvmsg(from, &mut [IoSliceMut::new(room)], &mut control, flags) {
            Err(Errno::INTR) => {}
            // The other end closed without having read all: its earlier messages are still there, and may say
            // why.
            Err(Errno::CONNRESET) if resets == 0 => resets += 1,
            other => break other,
        }
    };
    let files = control
        .drain()
        .flat_map(|message| match message {
            RecvAncillaryMessage::ScmRights(files) => files.collect::<Vec<_>>(),
            _ => Vec::new(),
        })
        .collect();
    match got {
        Err(Errno::AGAIN) => Heard::Nothing,
        Err(_) => Heard::End,
        Ok(got) if got.flags.contains(ReturnFlags::TRUNC) => Heard::TooLong,
        // An empty message is never sent here: it is the end.
        Ok(got) if got.bytes == 0 => Heard::End,
        Ok(got) => Heard::Message(got.bytes, files),
    }
}
