//! The ways by which lines go: a program's input, datagrams, a serial line, a file.
//!
//! Invariant: writing never waits but in `poll`, with the word to stop beside the file; what a reader does
//! not take is not taken from anybody else.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::process::ChildStdin;
use std::time::{Duration, Instant};

use rustix::termios::{QueueSelector, tcflush};
use trocar_imaging::program::{self, Running};
use trocar_imaging::waits::Stop;

use crate::serial;

/// Longest sleep.
const SLEEP: Duration = Duration::from_secs(1);

/// The goal of the lines, as configured.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Goal {
    Program(Vec<String>),
    Udp(SocketAddr),
    Serial {
        port: String,
        baud: u32,
    },
    /// `more`: the file was made by this component, and is written on.
    File {
        path: PathBuf,
        more: bool,
    },
}

/// An open goal.
pub(crate) enum Open {
    /// With whether it may say something.
    Program(Running<Option<ChildStdin>>, bool),
    Udp(UdpSocket),
    Serial(Port),
    File(File),
}

/// A serial line that is written.
pub(crate) struct Port {
    file: File,
    baud: u32,
    /// When all that it took is on the wire.
    sent_at: Instant,
    /// The line takes no more for now.
    full: bool,
}

impl Port {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.file.write(bytes);
        self.full = matches!(&written, Err(why) if why.kind() == ErrorKind::WouldBlock);
        let n = written?;
        // A byte has ten bits on the wire.
        let time = Duration::from_secs_f64(10.0 * n as f64 / f64::from(self.baud.max(1)));
        self.sent_at = self.sent_at.max(Instant::now()) + time;
        Ok(n)
    }
}

impl Goal {
    /// # Errors
    /// A sentence that names the setting.
    pub(crate) fn open(&self) -> Result<Open, String> {
        match self {
            Goal::Program(command) => {
                let running = program::written_to("program", command)?;
                if let Some(input) = &running.way {
                    rustix::io::ioctl_fionbio(input, true).map_err(|why| {
                        format!("program: its input cannot be written without waiting: {why}")
                    })?;
                }
                Ok(Open::Program(running, true))
            }
            Goal::Udp(to) => {
                let from: SocketAddr =
                    if to.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0u16; 8], 0).into() };
                let socket = UdpSocket::bind(from).and_then(|socket| {
                    socket.connect(to)?;
                    socket.set_nonblocking(true)?;
                    Ok(socket)
                });
                Ok(Open::Udp(socket.map_err(|why| format!("udp: nothing can be sent to {to}: {why}"))?))
            }
            Goal::Serial { port, baud } => {
                let file = serial::open(port, *baud)?;
                Ok(Open::Serial(Port { file, baud: *baud, sent_at: Instant::now(), full: false }))
            }
            Goal::File { path, more } => {
                let file = OpenOptions::new().append(true).create(*more).create_new(!more).open(path);
                let shown = path.display();
                Ok(Open::File(file.map_err(|why| match why.kind() {
                    ErrorKind::AlreadyExists => {
                        format!("file: {shown} exists, and nothing is written over: choose another name, or remove it")
                    }
                    _ => format!("file: {shown} cannot be made: {why}; choose a directory that the host may write to"),
                })?))
            }
        }
    }

    pub(crate) fn name(&self) -> String {
        match self {
            Goal::Program(command) => command.first().cloned().unwrap_or_default(),
            Goal::Udp(to) => to.to_string(),
            Goal::Serial { port, .. } => port.clone(),
            Goal::File { path, .. } => path.display().to_string(),
        }
    }
}

impl Open {
    /// Writes all of it; false where it was a datagram that nobody takes. `sent` counts the bytes that went
    /// out.
    ///
    /// # Errors
    /// The receiver takes nothing any more: why. Empty where the word to stop came first.
    pub(crate) fn write(
        &mut self,
        bytes: &[u8],
        sent: &mut usize,
        name: &str,
        stop: &Stop,
    ) -> Result<bool, String> {
        if let Open::Udp(socket) = self {
            *sent = socket.send(bytes).unwrap_or(0);
            return Ok(*sent > 0);
        }
        while let rest @ [_, ..] = bytes.get(*sent..).unwrap_or_default() {
            self.hear(stop);
            let written = match self {
                Open::Program(running, _) => match &mut running.way {
                    Some(input) => input.write(rest),
                    None => Ok(0),
                },
                Open::Serial(port) => port.write(rest),
                Open::File(file) => file.write(rest),
                Open::Udp(_) => Ok(0),
            };
            match written {
                Ok(0) => return Err(self.ended(name, "takes nothing any more", stop)),
                Ok(n) => *sent += n,
                Err(why) if why.kind() == ErrorKind::Interrupted => {}
                Err(why) if why.kind() == ErrorKind::WouldBlock => {
                    let Some(file) = self.file() else { return Err(String::new()) };
                    let _ = stop.poll_room(file, SLEEP);
                    if stop.is_set() {
                        return Err(String::new());
                    }
                }
                Err(why) => return Err(self.ended(name, &why.to_string(), stop)),
            }
        }
        Ok(true)
    }

    /// Takes what a program says, so that it never waits for a reader; of a flood a part.
    pub(crate) fn hear(&mut self, stop: &Stop) {
        if let Open::Program(running, talks) = self {
            *talks = *talks && running.hear_out(stop);
        }
    }

    /// Nothing more comes: a program may read to the end.
    pub(crate) fn finish(&mut self) {
        if let Open::Program(running, _) = self {
            let _ = running.finish();
        }
    }

    /// Whether what is opened later goes on behind what was written before.
    pub(crate) fn goes_on(&self) -> bool {
        matches!(self, Open::Serial(_) | Open::File(_))
    }

    /// Lets a serial line send what it has taken, until the word to stop. The rest is given up, since the
    /// kernel would hold up the close for it; tells whether there was one.
    pub(crate) fn close(&mut self, stop: &Stop) -> bool {
        let Open::Serial(port) = self else { return false };
        let left = port.sent_at.saturating_duration_since(Instant::now());
        let unsent = (port.full || (!left.is_zero() && stop.wait(left))) && stop.is_set();
        if unsent {
            let _ = tcflush(&port.file, QueueSelector::OFlush);
        }
        unsent
    }

    fn file(&self) -> Option<BorrowedFd<'_>> {
        match self {
            Open::Program(running, _) => running.way.as_ref().map(AsFd::as_fd),
            Open::Udp(socket) => Some(socket.as_fd()),
            Open::Serial(port) => Some(port.file.as_fd()),
            Open::File(file) => Some(file.as_fd()),
        }
    }

    fn ended(&mut self, name: &str, why: &str, stop: &Stop) -> String {
        let Open::Program(running, talks) = self else { return format!("{name} cannot be written: {why}") };
        let status = running.finish();
        if *talks {
            running.hear_out(stop);
        }
        let words = running.last_words();
        match status {
            Ok(Some(status)) => format!("{name} ended ({status}){words}"),
            Ok(None) => format!("{name} closed its input; it was ended{words}"),
            Err(why) => format!("{name} closed its input; {why}{words}"),
        }
    }
}
