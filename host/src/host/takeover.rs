//! A GCM takes the place of another one in its state directory: a newer trocar, while everything runs.
//!
//! Invariant: the one that runs is asked to end only when it is a GCM without components that nobody starts
//! again, and this program can read its journal; otherwise it goes on as it was.

use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::retry_on_intr;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

use super::HostError;
use super::state_dir::{Kind, holder};
use crate::journal::{self, View};
use crate::processes::is_kept;

/// Time the one before gets to end: it puts on record what it has decided.
const ENDS: Timespec = Timespec { tv_sec: 10, tv_nsec: 0 };

/// The GCM that runs in a state directory.
#[derive(Debug)]
pub struct Predecessor {
    dir: PathBuf,
    process: OwnedFd,
    pid: u32,
    addr: SocketAddr,
}

impl Predecessor {
    /// Returns the GCM that runs in this directory, if this program can go on in its place; `None`: nobody is
    /// there.
    ///
    /// # Errors
    /// Another program is there, or one that is started again when it ends; its journal cannot be read.
    pub fn of(dir: &Path) -> Result<Option<Predecessor>, HostError> {
        let Some(found) = holder(dir) else { return Ok(None) };
        let not = |because: &str, help: &str| HostError::NotTakenOver {
            dir: dir.to_owned(),
            pid: found.pid.to_string(),
            because: because.to_owned(),
            help: help.to_owned(),
        };
        let gone = || not("it ended just now", "start it again");
        let pid = i32::try_from(found.pid).ok().and_then(Pid::from_raw).ok_or_else(gone)?;
        let process = pidfd_open(pid, PidfdFlags::empty()).map_err(|_| gone())?;
        // Only now does the number stand for the process that was found.
        if holder(dir).as_ref() != Some(&found) {
            return Err(gone());
        }
        let addr = match found.kind {
            Kind::Gcm(addr) => addr,
            Kind::Candidate => {
                let help = "start this one beside it, with a state directory of its own and the same --store; then end that one";
                return Err(not("it is one of several over etcd", help));
            }
            Kind::Other => {
                let help = "to end it in order: `kill PID`; what runs in it ends with it";
                return Err(not(
                    "it is no GCM by itself, or of a trocar that cannot be taken over from",
                    help,
                ));
            }
        };
        if is_kept(found.pid) {
            let help = "only a GCM that was started by itself is taken over from: `trocar gcm`, and `trocar up --gcm ADDR`";
            return Err(not("it is kept by `trocar up`, which starts it again when it ends", help));
        }
        if dir.join(journal::FILE).exists() {
            View::open(dir).map_err(|fault| HostError::Journal(fault.error))?;
        }
        Ok(Some(Predecessor { dir: dir.to_owned(), process, pid: found.pid, addr }))
    }

    /// Returns the address it listens at, where its processes look for their GCM.
    pub fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Has it end in order, and waits for that.
    ///
    /// # Errors
    /// It is another user's, or does not end.
    pub async fn end(self) -> Result<(), HostError> {
        let (dir, pid) = (self.dir, self.pid.to_string());
        let not = |because: String, help: String| HostError::NotTakenOver {
            dir: dir.clone(),
            pid: pid.clone(),
            because,
            help,
        };
        log::info!("this GCM takes over from process {}", self.pid);
        match pidfd_send_signal(&self.process, Signal::TERM) {
            // It ended by itself.
            Ok(()) | Err(rustix::io::Errno::SRCH) => {}
            Err(e) => {
                return Err(not(format!("it cannot be ended: {e}"), "ask as its user, or as root".into()));
            }
        }
        let process = self.process;
        let ended = tokio::task::spawn_blocking(move || ends(&process)).await;
        if !matches!(ended, Ok(Ok(true))) {
            return Err(not(
                format!("it was asked to end, and has not within {} s", ENDS.tv_sec),
                format!("`kill -9 {}` ends it; then start this one without --takeover", self.pid),
            ));
        }
        Ok(())
    }
}

/// Waits until a process has ended; false: it has not.
fn ends(process: &OwnedFd) -> rustix::io::Result<bool> {
    let mut there = [PollFd::new(process, PollFlags::IN)];
    retry_on_intr(|| poll(&mut there, Some(&ENDS))).map(|events| events > 0)
}
