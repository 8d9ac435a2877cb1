//! A component that ends with this program, in whatever way the program ends.
//!
//! Invariant: it is held before it is created; a manager that comes back is told of it again.

use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tonic::{Code, Status};
use trocar_proto::v1;
use trocar_proto::v1::guest_service_client::GuestServiceClient;

use super::Session;
use crate::failure::Failure;
use trocar::control::Tokened;

/// Pause before a manager that is away is asked again.
const AGAIN: Duration = Duration::from_millis(200);

/// Holds until it is dropped; nothing where the manager knows no Hold.
pub(crate) struct Holding(Option<Staying>);

/// The task that holds, and whether a manager knows of it now.
struct Staying(JoinHandle<()>, watch::Receiver<bool>);

impl Holding {
    /// Waits until the manager knows of it, until then at most; whether it does.
    pub(crate) async fn stands(&self, until: Instant) -> bool {
        let Some(Staying(_, known)) = &self.0 else { return true };
        // Nobody tells any more where there is nothing to be held.
        tokio::time::timeout_at(until, known.clone().wait_for(|known| *known)).await.is_ok()
    }
}

impl Drop for Holding {
    fn drop(&mut self) {
        if let Some(Staying(task, _)) = &self.0 {
            task.abort();
        }
    }
}

impl Session {
    /// Ties a component, which is created after this, to the life of this program. A manager that knows no
    /// Hold leaves it without.
    pub(crate) async fn hold(&self, path: &str) -> Result<Holding, Failure> {
        let mut guest = self.client().await?.guest;
        let first = match hold(&mut guest, path).await {
            Ok(first) => first,
            Err(status) if status.code() == Code::Unimplemented => return Ok(Holding(None)),
            Err(status) => return Err(self.failed(&status)),
        };
        let (tell, known) = watch::channel(true);
        Ok(Holding(Some(Staying(tokio::spawn(stay(guest, first, path.to_owned(), tell)), known))))
    }
}

type Held = tonic::Streaming<v1::HoldResponse>;

async fn hold(guest: &mut GuestServiceClient<Tokened>, path: &str) -> Result<Held, Status> {
    let mut held = guest.hold(v1::HoldRequest { component: path.to_owned() }).await?.into_inner();
    match held.message().await? {
        Some(_) => Ok(held),
        None => Err(Status::unavailable("the manager ended the call without an answer")),
    }
}

/// Holds as long as there is something to be held: then the call ends in order. A manager that ends breaks
/// it, and is asked again.
async fn stay(
    mut guest: GuestServiceClient<Tokened>,
    mut held: Held,
    path: String,
    known: watch::Sender<bool>,
) {
    loop {
        let ended = loop {
            match held.message().await {
                Ok(Some(_)) => {}
                Ok(None) => return,
                Err(status) => break status,
            }
        };
        log::debug!("{path} is held no more: {ended}");
        known.send_replace(false);
        held = loop {
            tokio::time::sleep(AGAIN).await;
            match hold(&mut guest, &path).await {
                Ok(held) => break held,
                Err(status) => log::debug!("{path} cannot be held: {status}"),
            }
        };
        known.send_replace(true);
    }
}
