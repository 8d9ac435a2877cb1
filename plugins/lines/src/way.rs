//! The ways by which lines come: a program's output, datagrams, a serial line.
//!
//! Invariant: reading never waits; the thread sleeps in `poll` alone, with the word to stop beside the file.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::process::ChildStdout;

use trocar_imaging::program::{self, Running};
use trocar_imaging::waits::Stop;

use crate::serial;

/// The source of the lines, as configured.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Origin {
    Program(Vec<String>),
    Udp(SocketAddr),
    Serial { port: String, baud: u32 },
}

/// An open source.
pub(crate) enum Way {
    /// With whether it may say something besides.
    Program(Running<ChildStdout>, bool),
    Udp(UdpSocket),
    Serial(File),
}

/// The result of a look.
pub(crate) enum Got {
    Bytes(usize),
    /// A whole one.
    Datagram(usize),
    Nothing,
    Ended(String),
}

impl Origin {
    /// # Errors
    /// A sentence that names the setting.
    pub(crate) fn open(&self) -> Result<Way, String> {
        match self {
            Origin::Program(command) => Ok(Way::Program(program::listened_to("program", command)?, true)),
            Origin::Udp(address) => {
                let socket = UdpSocket::bind(address).and_then(|socket| {
                    socket.set_nonblocking(true)?;
                    Ok(socket)
                });
                let why =
                    |why| format!("udp: {address} cannot be listened at: {why}; is another program there?");
                Ok(Way::Udp(socket.map_err(why)?))
            }
            Origin::Serial { port, baud } => Ok(Way::Serial(serial::open(port, *baud)?)),
        }
    }

    pub(crate) fn name(&self) -> &str {
        match self {
            Origin::Program(command) => command.first().map_or("", String::as_str),
            Origin::Udp(_) => "udp",
            Origin::Serial { port, .. } => port,
        }
    }
}

impl Way {
    /// The UDP port it listens at; 0 for the others.
    pub(crate) fn udp_port(&self) -> u16 {
        match self {
            Way::Udp(socket) => socket.local_addr().map_or(0, |address| address.port()),
            _ => 0,
        }
    }

    /// The thread sleeps for these.
    pub(crate) fn files(&self) -> [Option<BorrowedFd<'_>>; 2] {
        match self {
            Way::Program(running, talks) => [Some(running.way.as_fd()), talks.then(|| running.err.as_fd())],
            Way::Udp(socket) => [Some(socket.as_fd()), None],
            Way::Serial(file) => [Some(file.as_fd()), None],
        }
    }

    /// Takes what the program says besides.
    pub(crate) fn hear(&mut self) {
        if let Way::Program(running, talks) = self {
            *talks = *talks && running.hear();
        }
    }

    /// Reads what is there; asked when there is something.
    pub(crate) fn read(&mut self, to: &mut [u8], name: &str, stop: &Stop) -> Got {
        let read = match self {
            Way::Program(running, _) => running.way.read(to),
            Way::Udp(socket) => {
                return match socket.recv(to) {
                    Ok(n) => Got::Datagram(n),
                    // Also what another program's refusal of an answer leaves behind.
                    Err(_) => Got::Nothing,
                };
            }
            Way::Serial(file) => file.read(to),
        };
        match read {
            Ok(0) => Got::Ended(self.ended(name, stop)),
            Ok(n) => Got::Bytes(n),
            Err(why) if matches!(why.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => Got::Nothing,
            Err(why) => Got::Ended(format!("{name} cannot be read any more: {why}")),
        }
    }

    fn ended(&mut self, name: &str, stop: &Stop) -> String {
        let Way::Program(running, talks) = self else { return format!("{name} is gone") };
        // First ended: one that talks on and on is cut then.
        let status = running.ended();
        if *talks {
            running.hear_out(stop);
        }
        let words = running.last_words();
        match status {
            Ok(Some(status)) => format!("{name} ended ({status}){words}"),
            Ok(None) => format!("{name} closed its output; it was ended{words}"),
            Err(why) => format!("{name} closed its output; {why}{words}"),
        }
    }
}
