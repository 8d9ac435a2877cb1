//! A component that ends with this program, whatever ends the program.
//!
//! Invariant: it is held before it is created; a manager that comes back is told of it again.

use std::time::Duration;

use tokio::task::JoinHandle;
use tonic::{Code, Status};
use trocar_proto::v1;
use trocar_proto::v1::guest_service_client::GuestServiceClient;

use super::Session;
use crate::cli::failure::Failure;
use crate::control::Tokened;

/// Pause before a manager that is away is asked again.
const AGAIN: Duration = Duration::from_millis(200);

/// Holds until it is dropped.
pub(in crate::cli) struct Holding(Option<JoinHandle<()>>);

impl Drop for Holding {
    fn drop(&mut self) {
        if let Some(held) = &self.0 {
            held.abort();
        }
    }
}

impl Session {
    /// Ties a component, which is created after this, to the life of this program. A manager that knows no
    /// Hold leaves it without.
    pub(in crate::cli) async fn hold(&self, path: &str) -> Result<Holding, Failure> {
        let mut guest = self.client().await?.guest;
        let first = match hold(&mut guest, path).await {
            Ok(first) => first,
            Err(status) if status.code() == Code::Unimplemented => return Ok(Holding(None)),
            Err(status) => return Err(self.failed(&status)),
        };
        Ok(Holding(Some(tokio::spawn(stay(guest, first, path.to_owned())))))
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
async fn stay(mut guest: GuestServiceClient<Tokened>, mut held: Held, path: String) {
    loop {
        let ended = loop {
            match held.message().await {
                Ok(Some(_)) => {}
                Ok(None) => return,
                Err(status) => break status,
            }
        };
        log::debug!("{path} is held no more: {ended}");
        held = loop {
            tokio::time::sleep(AGAIN).await;
            match hold(&mut guest, &path).await {
                Ok(held) => break held,
                Err(status) => log::debug!("{path} cannot be held: {status}"),
            }
        };
    }
}
