//! Facts a process tells about itself so that other processes of its machine can reach it.

use std::fmt;
use std::io;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Layout of memory that two processes share, and the meaning of its words; both must have the same.
pub const LAYOUT: u32 = 4;

/// Bytes of a name on a card.
const MOST_NAME: usize = 128;
/// Bytes of an address on a card.
const MOST_NET: usize = 300;
/// Bytes of a path on a card.
const MOST_PATH: usize = 4096;

/// A process of a machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Card {
    pub process: String,
    /// Identifies this run of the process: two runs never have the same.
    pub instance: String,
    /// Identifies this run of the machine.
    pub boot: String,
    pub uid: u32,
    /// Socket the process listens at.
    pub socket: PathBuf,
    /// `HOST:PORT` at which processes of other machines reach it; empty: they do not.
    #[serde(default)]
    pub net: String,
    /// Its [`LAYOUT`].
    pub layout: u32,
}

/// Why two processes cannot share memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unreachable {
    OtherMachine { process: String },
    OtherUser { process: String, theirs: u32, ours: u32 },
    OtherLayout { process: String, theirs: u32, ours: u32 },
}

impl fmt::Display for Unreachable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Unreachable::OtherMachine { process } => {
                write!(
                    f,
                    "{process} runs on another machine, or this one was started anew since: only processes of one machine \
                           share memory"
                )
            }
            Unreachable::OtherUser { process, theirs, ours } => {
                write!(
                    f,
                    "{process} runs as user {theirs}, this process as {ours}: both must run as the same user"
                )
            }
            Unreachable::OtherLayout { process, theirs, ours } => write!(
                f,
                "{process} lays shared memory out in version {theirs}, this process in {ours}: both must be of the same release"
            ),
        }
    }
}

impl std::error::Error for Unreachable {}

impl Card {
    /// This process's card.
    ///
    /// # Errors
    /// The machine does not say which run of it this is, or has no random numbers.
    pub fn own(process: &str, socket: PathBuf) -> io::Result<Card> {
        Ok(Card {
            process: process.into(),
            instance: hex(&random()?),
            boot: std::fs::read_to_string("/proc/sys/kernel/random/boot_id")?.trim().into(),
            uid: rustix::process::geteuid().as_raw(),
            socket,
            net: String::new(),
            layout: LAYOUT,
        })
    }

    /// Whether another process's card can be one, before anything of it is kept.
    ///
    /// # Errors
    /// It cannot.
    pub(crate) fn check(&self) -> Result<(), String> {
        let is_name = |text: &str| {
            let of_name = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
            (1..=MOST_NAME).contains(&text.len()) && text.chars().all(of_name)
        };
        if !is_name(&self.process) || !is_name(&self.instance) || !is_name(&self.boot) {
            return Err(format!(
                "its card has a name that is none: 1 to {MOST_NAME} letters, digits, `_`, `.` and `-` are one"
            ));
        }
        if self.socket.as_os_str().len() > MOST_PATH {
            return Err(format!("its card names a socket by more than {MOST_PATH} bytes"));
        }
        if self.net.len() > MOST_NET || self.net.contains(char::is_control) {
            return Err("its card names an address that is none".into());
        }
        Ok(())
    }

    /// Whether the process of this card and that of `other` can share memory.
    ///
    /// # Errors
    /// They cannot, and why.
    pub fn reaches(&self, other: &Card) -> Result<(), Unreachable> {
        let process = other.process.clone();
        if self.boot != other.boot {
            return Err(Unreachable::OtherMachine { process });
        }
        if self.uid != other.uid {
            return Err(Unreachable::OtherUser { process, theirs: other.uid, ours: self.uid });
        }
        if self.layout != other.layout {
            return Err(Unreachable::OtherLayout { process, theirs: other.layout, ours: self.layout });
        }
        Ok(())
    }
}

/// Sixteen bytes nobody can guess.
pub(crate) fn random() -> io::Result<[u8; 16]> {
    let mut bytes = [0; 16];
    let mut filled = 0;
    while filled < bytes.len() {
        filled += rustix::rand::getrandom(&mut bytes[filled..], rustix::rand::GetRandomFlags::empty())?;
    }
    Ok(bytes)
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
