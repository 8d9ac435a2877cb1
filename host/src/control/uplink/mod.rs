//! The process's half of Attach: dials the GCM, carries out its orders, sends it news, dials again after a
//! loss.
//!
//! Invariant: components run on without the GCM. The process says Hello again without waiting for what takes
//! long: an order under way is given up with its session, and taken back.

mod feed;
mod lateness;
mod orders;
mod questions;
mod session;
#[cfg(test)]
mod tests;
mod way;

use std::error::Error;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{RwLock, oneshot, watch};
use tokio::task::JoinHandle;
use trocar_lcm_api::clock;
use trocar_model::Refusal;

pub use self::feed::{FeedInbound, FeedOutgoing, Feeder};
use self::lateness::Lateness;
use self::orders::Told;
use self::session::Session;
use self::way::Grpc;
pub use self::way::{Inbound, Line, Refused, Way};
use crate::control::dial::Dialler;
use crate::gcm::{Registration, Slice};
use crate::lcm::Lcm;

/// Time for a GCM to answer at all. A GCM that hangs answers when it goes on, so a longer wait gains nothing.
const ATTEMPT: Duration = Duration::from_secs(1);
/// Time until Registered for a GCM that answers: a Hello may be large.
const TAKEN_IN: Duration = Duration::from_secs(3);
/// Pauses between attempts: a process is attached again well within a second of its GCM's return, however
/// long the GCM was away.
const PAUSE: (Duration, Duration) = (Duration::from_millis(50), Duration::from_millis(200));

/// Why a process is not attached.
#[derive(Clone, Debug, PartialEq)]
pub enum UplinkError {
    /// No answer from the address, or not a GCM's.
    NoGcm { addr: String, because: String },
    /// The GCM does not take this process.
    Refused(Refusal),
}

impl fmt::Display for UplinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            UplinkError::NoGcm { addr, because } => write!(f, "no GCM answers at {addr}: {because}"),
            UplinkError::Refused(refusal) => write!(f, "{refusal}"),
        }
    }
}

impl Error for UplinkError {}

/// Time for which a waiting process takes the holder of its name for its own earlier incarnation.
const HELD: Duration = Duration::from_secs(3);

/// Reaction to a GCM that does not take the process in at the first attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// The failure is the answer.
    AtOnce,
    /// The process dials on until a GCM is there; it asks for a taken name for a while longer.
    Patient,
}

/// A process's tie to its GCM.
pub struct Uplink {
    /// `None`: another owner ends it.
    task: Option<JoinHandle<()>>,
    refused: oneshot::Receiver<Refusal>,
}

impl Uplink {
    /// Attaches, and stays attached in the background.
    ///
    /// # Errors
    /// Nobody answers at `addr` (`HOST:PORT`, `https://HOST:PORT`, or several with commas between), or the
    /// GCM refuses this process. A later loss only means dialing again.
    pub async fn start(
        addr: String,
        dialler: Dialler,
        registration: Registration,
        lcm: Arc<dyn Lcm>,
        begin: Begin,
    ) -> Result<Uplink, UplinkError> {
        let way = Grpc::new(&addr, dialler, ATTEMPT);
        Uplink::over(way, addr, registration, lcm, begin).await
    }

    /// Attaches over a way of its own, and stays attached in the background. `addr` names it for people.
    ///
    /// # Errors
    /// As [`Uplink::start`].
    pub async fn over(
        way: impl Way,
        addr: String,
        registration: Registration,
        lcm: Arc<dyn Lcm>,
        begin: Begin,
    ) -> Result<Uplink, UplinkError> {
        let (told, quiet, lateness) = (Arc::default(), Arc::default(), Arc::default());
        let mut tie = Tie { way, addr, registration, lcm, told, quiet, lateness };
        let session = match begin {
            Begin::AtOnce => tie.attempt().await?,
            Begin::Patient => tie.attempts().await?,
        };
        tie.registration.epoch = session.epoch;
        let (tell, refused) = oneshot::channel();
        Ok(Uplink { task: Some(tokio::spawn(tie.stay(session, tell))), refused })
    }

    /// Waits until the GCM sends this process away for good, for example because its name belongs to another
    /// process now.
    pub async fn refused(&mut self) -> Refusal {
        match (&mut self.refused).await {
            Ok(refusal) => refusal,
            // The task ended without: nothing more will come.
            Err(_) => std::future::pending().await,
        }
    }

    /// Hands over the task; to leave the GCM, the caller aborts it.
    pub(crate) fn take_task(&mut self) -> Option<JoinHandle<()>> {
        self.task.take()
    }

    /// Leaves the GCM, which then lists the process as lost.
    pub async fn shutdown(self) {
        if let Some(task) = self.task {
            task.abort();
            // The task is meant to be aborted.
            let _ = task.await;
        }
    }
}

struct Tie<W> {
    way: W,
    /// Name of the GCM's place, for people.
    addr: String,
    registration: Registration,
    lcm: Arc<dyn Lcm>,
    told: Told,
    /// Held for reading while a change is remembered, or taken back, and while something is taken away.
    quiet: Arc<RwLock<()>>,
    lateness: Arc<Mutex<Lateness>>,
}

impl<W: Way> Tie<W> {
    async fn stay(mut self, mut session: Session, tell: oneshot::Sender<Refusal>) {
        loop {
            let doubted = session.doubted.subscribe();
            let why = tokio::select! {
                why = session.serve() => why,
                () = self.another_leads(doubted) => "another GCM leads".to_owned(),
            };
            self.registration.revision = session.revision;
            // Its orders are taken back.
            drop(session);
            log::warn!("the GCM at {} is lost ({why}); dialing again", self.addr);
            let mut pause = PAUSE.0;
            session = loop {
                tokio::time::sleep(pause).await;
                pause = longer(pause);
                match self.attempt().await {
                    Ok(session) => break session,
                    Err(UplinkError::Refused(refusal @ Refusal::ProcessExists { .. })) => {
                        log::error!("the GCM at {} does not take this process back: {refusal}", self.addr);
                        // The listener may be gone.
                        let _ = tell.send(refusal);
                        return;
                    }
                    // Any other failure may pass.
                    Err(e) => log::debug!("{e}"),
                }
            };
            self.registration.epoch = session.epoch;
            log::info!("attached to the GCM at {} again", self.addr);
        }
    }

    /// Waits until the GCM doubts its lead, and another one has it.
    async fn another_leads(&self, mut doubted: watch::Receiver<bool>) {
        loop {
            if doubted.wait_for(|doubted| *doubted).await.is_err() {
                return std::future::pending().await;
            }
            tokio::time::sleep(PAUSE.1).await;
            let finds = *doubted.borrow()
                && matches!(tokio::time::timeout(ATTEMPT, self.way.dial()).await, Ok(Ok(_)));
            if !finds {
                continue;
            }
            // It may have been the same GCM, whose next heartbeat says that it leads again.
            tokio::time::sleep(PAUSE.1).await;
            if *doubted.borrow() {
                return;
            }
        }
    }

    /// The first attempts of a process that waits.
    async fn attempts(&self) -> Result<Session, UplinkError> {
        let (mut pause, mut since) = (PAUSE.0, None);
        loop {
            match self.attempt().await {
                Err(UplinkError::NoGcm { addr, because }) => log::debug!("no GCM at {addr} yet: {because}"),
                Err(UplinkError::Refused(Refusal::ProcessExists { .. }))
                    if clock::since(*since.get_or_insert_with(clock::now)) < HELD => {}
                Err(UplinkError::Refused(refusal @ Refusal::JournalUnavailable { .. })) => {
                    log::debug!("the GCM does not take this process in yet: {refusal}");
                }
                done => return done,
            }
            tokio::time::sleep(pause).await;
            pause = longer(pause);
        }
    }

    async fn attempt(&self) -> Result<Session, UplinkError> {
        let no_gcm = |because| UplinkError::NoGcm { addr: self.addr.clone(), because };
        let late = |within: Duration| no_gcm(format!("it did not answer within {} s", within.as_secs()));
        let told = |refused| match refused {
            Refused::ByGcm(refusal) => UplinkError::Refused(refusal),
            Refused::Unheard(because) => no_gcm(because),
        };
        let dialed = tokio::time::timeout(ATTEMPT, self.way.dial()).await.map_err(|_| late(ATTEMPT))?;
        let line = dialed.map_err(told)?;
        let taken_in = tokio::time::timeout(TAKEN_IN, self.hello(line)).await;
        taken_in.map_err(|_| late(TAKEN_IN))?.map_err(told)
    }

    async fn hello(&self, line: W::Line) -> Result<Session, Refused> {
        // A change that is just being remembered is in the slice.
        let _quiet = self.quiet.write().await;
        let registration = Registration { slice: self.slice(), ..self.registration.clone() };
        let memory = (self.told.clone(), self.quiet.clone());
        Session::open(line, registration, self.lcm.clone(), memory, self.lateness.clone()).await
    }

    fn slice(&self) -> Slice {
        let told = self.told.lock();
        Slice {
            components: told.components.iter().map(|(id, c)| (id.clone(), c.clone())).collect(),
            connections: told.connections.values().cloned().collect(),
        }
    }
}

fn longer(pause: Duration) -> Duration {
    (pause * 2).min(PAUSE.1)
}
