//! The process's half of Attach: dials the GCM, does what it orders, tells it the news, dials again when it is lost.
//!
//! Invariant: components run on without the GCM; an order that was begun is finished and remembered before the process
//! says Hello again.

mod orders;
mod session;
#[cfg(test)]
mod tests;

use std::error::Error;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{RwLock, oneshot};
use tokio::task::JoinHandle;
use trocar_model::{Refusal, SystemGraph};
use trocar_proto::v1;
use trocar_proto::v1::attach_service_client::AttachServiceClient;

use self::session::Session;
use super::attach::MAX_MESSAGE;
use super::caller::Tokened;
use super::dial::dial;
use crate::gcm::{Registration, Slice};
use crate::lcm::Lcm;

/// Time for a GCM to answer at all. One that hangs answers when it goes on, so nothing is gained by waiting longer.
const ATTEMPT: Duration = Duration::from_secs(1);
/// Time for one that does, until Registered: a Hello may be large.
const TAKEN_IN: Duration = Duration::from_secs(3);
/// Pauses between attempts: a process is attached again well within a second of its GCM's return, however long that was away.
const PAUSE: (Duration, Duration) = (Duration::from_millis(50), Duration::from_millis(200));

/// Why a process is not attached.
#[derive(Clone, Debug, PartialEq)]
pub enum UplinkError {
    /// Nobody answers at the address, or not a GCM.
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

/// How long a process that waits for its GCM takes it that its name is held by what it was before.
const HELD: Duration = Duration::from_secs(3);

/// What happens when the GCM does not take a process in at the first attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// That is the answer.
    AtOnce,
    /// It dials on until a GCM is there; a name that is taken is asked for a while longer.
    Patient,
}

/// A process's tie to its GCM.
pub struct Uplink {
    /// `None`: somebody else ends it.
    task: Option<JoinHandle<()>>,
    refused: oneshot::Receiver<Refusal>,
}

impl Uplink {
    /// Attaches, and stays attached in the background.
    ///
    /// # Errors
    /// Nobody answers at `addr` (`HOST:PORT`); the GCM refuses this process. Later losses only mean dialing again.
    pub async fn start(
        addr: String,
        registration: Registration,
        lcm: Arc<dyn Lcm>,
        begin: Begin,
    ) -> Result<Uplink, UplinkError> {
        let mut tie = Tie { addr, registration, lcm, told: Arc::default(), quiet: Arc::default() };
        let session = match begin {
            Begin::AtOnce => tie.attempt().await?,
            Begin::Patient => tie.attempts().await?,
        };
        tie.registration.epoch = session.epoch;
        let (tell, refused) = oneshot::channel();
        Ok(Uplink { task: Some(tokio::spawn(tie.stay(session, tell))), refused })
    }

    /// Waits until the GCM sends this process away for good, as when its name was given to another one meanwhile.
    pub async fn refused(&mut self) -> Refusal {
        match (&mut self.refused).await {
            Ok(refusal) => refusal,
            // The task ended without: nothing more will come.
            Err(_) => std::future::pending().await,
        }
    }

    /// What to abort to leave the GCM, in the hands of the caller from now on.
    pub(crate) fn take_task(&mut self) -> Option<JoinHandle<()>> {
        self.task.take()
    }

    /// Leaves the GCM, which then lists the process as lost.
    pub async fn shutdown(self) {
        if let Some(task) = self.task {
            task.abort();
            // Aborted is what it is meant to be.
            let _ = task.await;
        }
    }
}

/// What this process was told to have, as far as it was done.
type Told = Arc<Mutex<SystemGraph>>;

struct Tie {
    addr: String,
    registration: Registration,
    lcm: Arc<dyn Lcm>,
    told: Told,
    /// Held for reading while a change is carried out.
    quiet: Arc<RwLock<()>>,
}

impl Tie {
    async fn stay(mut self, mut session: Session, tell: oneshot::Sender<Refusal>) {
        loop {
            let why = session.serve().await;
            log::warn!("the GCM at {} is lost ({why}); dialing again", self.addr);
            let mut pause = PAUSE.0;
            session = loop {
                tokio::time::sleep(pause).await;
                pause = longer(pause);
                match self.attempt().await {
                    Ok(session) => break session,
                    Err(UplinkError::Refused(refusal @ Refusal::ProcessExists { .. })) => {
                        log::error!("the GCM at {} does not take this process back: {refusal}", self.addr);
                        // Whoever would listen may be gone.
                        let _ = tell.send(refusal);
                        return;
                    }
                    // Whatever else it has against this process may pass.
                    Err(e) => log::debug!("{e}"),
                }
            };
            self.registration.epoch = session.epoch;
            log::info!("attached to the GCM at {} again", self.addr);
        }
    }

    /// The first attempts of a process that waits.
    async fn attempts(&self) -> Result<Session, UplinkError> {
        let (mut pause, mut since) = (PAUSE.0, None);
        loop {
            match self.attempt().await {
                Err(UplinkError::NoGcm { addr, because }) => log::debug!("no GCM at {addr} yet: {because}"),
                Err(UplinkError::Refused(Refusal::ProcessExists { .. }))
                    if since.get_or_insert_with(Instant::now).elapsed() < HELD => {}
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
        let dialed = tokio::time::timeout(ATTEMPT, self.dial()).await.map_err(|_| late(ATTEMPT))?;
        let client = dialed.map_err(told)?;
        let taken_in = tokio::time::timeout(TAKEN_IN, self.hello(client)).await;
        taken_in.map_err(|_| late(TAKEN_IN))?.map_err(told)
    }

    /// A GCM that answers. One that hangs must not find, when it goes on, the Hello of every attempt that was given up meanwhile.
    async fn dial(&self) -> Result<AttachServiceClient<Tokened>, Refused> {
        let uri = format!("http://{}", self.addr.trim_start_matches("http://"));
        let channel = dial(&uri, None, ATTEMPT).await.map_err(|e| Refused::Unheard(because(&e)))?;
        let mut client = AttachServiceClient::new(channel)
            .max_decoding_message_size(MAX_MESSAGE)
            .max_encoding_message_size(MAX_MESSAGE);
        let nothing = v1::TellRequest::default();
        client.tell(nothing).await.map_err(|e| Refused::Unheard(e.message().to_owned()))?;
        Ok(client)
    }

    async fn hello(&self, client: AttachServiceClient<Tokened>) -> Result<Session, Refused> {
        // What was begun for the last session is finished first, so that the slice has it.
        let _quiet = self.quiet.write().await;
        let registration = Registration { slice: self.slice(), ..self.registration.clone() };
        Session::open(client, registration, self.lcm.clone(), self.told.clone(), self.quiet.clone()).await
    }

    fn slice(&self) -> Slice {
        let told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        Slice {
            components: told.components.iter().map(|(id, c)| (id.clone(), c.clone())).collect(),
            connections: told.connections.values().cloned().collect(),
        }
    }
}

fn longer(pause: Duration) -> Duration {
    (pause * 2).min(PAUSE.1)
}

/// Why an attempt ended.
enum Refused {
    /// By a GCM that was asked.
    ByGcm(Refusal),
    /// Nobody was asked, or the answer is not a GCM's.
    Unheard(String),
}

/// The innermost cause: the outer ones say "transport error".
fn because(e: &(dyn Error + 'static)) -> String {
    let mut inner = e;
    while let Some(source) = inner.source() {
        inner = source;
    }
    inner.to_string()
}
