//! A GCM takes the place of another one in its state directory: a newer trocar, while everything runs.
//!
//! Invariant: the one that runs is asked to end only when it is a GCM without components that nobody starts
//! again, and this program can read its journal; otherwise it goes on as it was.

use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::retry_on_intr;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

use tonic::transport::Endpoint;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use super::HostError;
use super::state_dir::{Kind, holder, is_held_by};
use crate::control::JOURNAL;
use crate::journal::{self, View};
use crate::processes::is_kept;

/// Time the one before gets to end: it puts on record what it has decided.
const ENDS: Timespec = Timespec { tv_sec: 10, tv_nsec: 0 };

/// Time for it to say how its journal stands.
const ANSWERS: Duration = Duration::from_secs(1);

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
        let unknown = || {
            let because = "it is another user's or container's, or starts or ends just now";
            not(because, "try again in a moment, as its user and beside it")
        };
        let pid = i32::try_from(found.pid).ok().and_then(Pid::from_raw).ok_or_else(unknown)?;
        let process = pidfd_open(pid, PidfdFlags::empty()).map_err(|_| unknown())?;
        // Only now does the number stand for one process.
        if !is_held_by(dir, found.pid) {
            return Err(unknown());
        }
        let addr = match found.kind {
            Kind::Gcm(addr) => addr,
            Kind::Candidate => {
                let help = "start this one beside it, with a state directory of its own and the same --store; then end that one";
                return Err(not("it is one of several over etcd", help));
            }
            Kind::Other => {
                let because = "it is no GCM by itself, or of a trocar that cannot be taken over from";
                let help = format!("to end it in order: `kill {}`; what runs in it ends with it", found.pid);
                return Err(not(because, &help));
            }
        };
        if is_kept(found.pid) {
            let help = "only a GCM that was started by itself is taken over from: `trocar gcm`, and `trocar up --gcm ADDR`";
            return Err(not("it is kept by `trocar up`, which starts it again when it ends", help));
        }
        if dir.join(journal::FILE).exists() {
            let read = View::open(dir).and_then(|view| view.verify());
            read.map_err(|fault| HostError::Journal(fault.error))?;
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
    /// It is another user's, has decisions in memory alone, or does not end.
    pub async fn end(self) -> Result<(), HostError> {
        let (dir, pid) = (self.dir, self.pid.to_string());
        let not = |because: String, help: String| HostError::NotTakenOver {
            dir: dir.clone(),
            pid: pid.clone(),
            because,
            help,
        };
        if journal_is_behind(self.addr).await {
            let help = "make room on its disk until `trocar ls` warns no more; a GCM that ends before forgets what is not on record";
            return Err(not("its journal is behind".into(), help.into()));
        }
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
                format!(
                    "wait until it has; or `kill -9 {}`. Then start this one without --takeover",
                    self.pid
                ),
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

/// Tells whether what was decided there is in memory alone; one that does not answer says nothing.
async fn journal_is_behind(addr: SocketAddr) -> bool {
    let asking = async {
        let channel = Endpoint::from_shared(format!("http://{addr}")).ok()?.connect().await.ok()?;
        let request = HealthCheckRequest { service: JOURNAL.to_owned() };
        HealthClient::new(channel).check(request).await.ok()
    };
    let health = tokio::time::timeout(ANSWERS, asking).await.ok().flatten();
    health.is_some_and(|health| health.into_inner().status() == ServingStatus::NotServing)
}
