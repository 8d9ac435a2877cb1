//! The program that holds the address this process was to listen on.
//!
//! Invariant: this module only asks, and for no longer than `PATIENCE`; a listener that does not answer as
//! trocar does is some other program.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use tonic::Status;
use tonic::transport::Endpoint;
use tonic_types::StatusExt;
use trocar_proto::v1;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;

/// Time all questions together may take.
pub(super) const PATIENCE: Duration = Duration::from_millis(300);

/// The listener at an address.
#[derive(Debug)]
pub(super) enum Occupant {
    /// A host with a GCM of its own.
    Host(v1::Process),
    /// A host of another process's GCM; which one is known only when that GCM answers.
    Managed { by: String, process: Option<v1::Process> },
    /// A GCM without components.
    Gcm,
    /// Something that does not answer as trocar does.
    Stranger,
}

impl Occupant {
    /// Returns the process of the host, where it is known.
    pub(super) fn process(&self) -> Option<&v1::Process> {
        match self {
            Occupant::Host(process) => Some(process),
            Occupant::Managed { process, .. } => process.as_ref(),
            Occupant::Gcm | Occupant::Stranger => None,
        }
    }
}

/// Asks the address for its occupant.
pub(super) async fn ask(addr: SocketAddr) -> Occupant {
    let until = Instant::now() + PATIENCE;
    let here = addr.to_string();
    match processes(&here, until).await {
        Ok(processes) => at(processes, &here).map_or(Occupant::Gcm, Occupant::Host),
        Err(status) => {
            let details = status.get_error_details();
            if details.error_info().is_some_and(|info| info.reason == "NOT_LEADER") {
                return Occupant::Gcm;
            }
            let told = details.error_info().filter(|info| info.reason == "MANAGED_ELSEWHERE");
            let by = told.and_then(|info| info.metadata.get("gcm")).filter(|by| !by.is_empty());
            let Some(by) = by else { return Occupant::Stranger };
            let known = processes(by, until).await.unwrap_or_default();
            Occupant::Managed { by: by.clone(), process: at(known, &here) }
        }
    }
}

fn at(processes: Vec<v1::Process>, endpoint: &str) -> Option<v1::Process> {
    processes.into_iter().find(|process| process.endpoint == endpoint)
}

/// Returns the processes that the GCM at an address lists.
async fn processes(addr: &str, until: Instant) -> Result<Vec<v1::Process>, Status> {
    let asking = async {
        let uri = format!("http://{}", addr.trim_start_matches("http://"));
        let unheard = |e: tonic::transport::Error| Status::unavailable(e.to_string());
        let channel = Endpoint::from_shared(uri).map_err(unheard)?.connect().await.map_err(unheard)?;
        let brief = v1::ListRequest { brief: true, ..Default::default() };
        Ok(GcmServiceClient::new(channel).list(brief).await?.into_inner().processes)
    };
    let silent = |_| Err(Status::deadline_exceeded("it does not answer"));
    timeout_at(until, asking).await.unwrap_or_else(silent)
}
