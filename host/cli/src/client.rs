//! Connects to a GCM and reads what a refusal says.
//!
//! Invariant: never waits longer than its limits; an address without a GCM is told apart from a GCM that
//! refuses. A socket of this user beside the port is taken before the port: the host then knows the caller on
//! every machine, and a Stop never waits in a queue with others.

use std::collections::BTreeMap;
use std::error::Error;
use std::time::Duration;

use tonic_types::StatusExt;
use trocar_proto::v1::attach_service_client::AttachServiceClient;
use trocar_proto::v1::gcm_service_client::GcmServiceClient;
use trocar_proto::v1::guest_service_client::GuestServiceClient;
use trocar_proto::v1::interact_service_client::InteractServiceClient;
use trocar_proto::v1::plugin_service_client::PluginServiceClient;

use trocar::control::{Dialler, Tokened, addresses, find_leader};
use trocar::runtime_dir::Door;

/// Time allowed for making a connection.
const CONNECT: Duration = Duration::from_secs(2);

/// Searches for a GCM that leads before there is said to be none, and the pause between them: another leads
/// within 3 s.
const LOOKS: usize = 8;
const LOOK: Duration = Duration::from_millis(400);

/// hyper's message for pings that were not answered; an outer test looks for the text that is then printed.
const UNANSWERED: &str = "keep-alive timed out";

/// Bytes of the largest answer taken: a list of many components with long configurations.
const LARGEST: usize = 256 << 20;

/// The services of one address.
#[derive(Clone, Debug)]
pub(super) struct Client {
    pub(super) attach: AttachServiceClient<Tokened>,
    pub(super) gcm: GcmServiceClient<Tokened>,
    pub(super) guest: GuestServiceClient<Tokened>,
    pub(super) interact: InteractServiceClient<Tokened>,
    pub(super) plugin: PluginServiceClient<Tokened>,
}

/// A gRPC status, in the words of the error table.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Told {
    pub(super) code: &'static str,
    pub(super) reason: String,
    pub(super) message: String,
    pub(super) help: String,
    pub(super) metadata: BTreeMap<String, String>,
    /// True: this is no answer of a GCM.
    pub(super) transport: bool,
    /// True: the GCM is there, but has not answered the pings of `dial`, either.
    pub(super) silent: bool,
    /// True: the GCM has not answered by the deadline that was set here for the call.
    pub(super) late: bool,
}

impl Client {
    /// Connects to `host:port` (a missing port is filled in), by the socket beside it where
    /// there is one.
    ///
    /// # Errors
    /// A sentence: malformed address, no listener, no answer in 2 s.
    pub(super) async fn connect(dialler: &Dialler, addr: &str, door: Door) -> Result<Self, String> {
        let channel =
            dialler.dial(&uri(addr), Some(door), CONNECT).await.map_err(|e| match root_cause(&*e) {
                cause if cause.contains("invalid uri") || cause.contains("invalid authority") => {
                    "not an address; write HOST:PORT, e.g. 127.0.0.1:50551".to_owned()
                }
                cause => cause,
            })?;
        Ok(Client::over(channel))
    }

    /// Connects to the GCM that leads among several, by their addresses with commas between them.
    ///
    /// # Errors
    /// A sentence: what each of them said.
    pub(super) async fn of_leader(dialler: &Dialler, addrs: &str) -> Result<Self, String> {
        let each = addresses(addrs).iter().map(|addr| uri(addr)).collect::<Vec<_>>();
        // A GCM that has just ended has a successor within some seconds.
        for pause in [LOOK; LOOKS] {
            if let Ok(leader) = find_leader(dialler, &each, Some(Door::Calls), CONNECT).await {
                return Ok(Client::over(leader.channel));
            }
            tokio::time::sleep(pause).await;
        }
        match find_leader(dialler, &each, Some(Door::Calls), CONNECT).await {
            Ok(leader) => Ok(Client::over(leader.channel)),
            Err(said) => {
                let all: Vec<String> = said.iter().map(|(addr, why)| format!("{addr}: {why}")).collect();
                Err(format!("none of them leads ({})", all.join("; ")))
            }
        }
    }

    fn over(channel: Tokened) -> Client {
        Client {
            attach: AttachServiceClient::new(channel.clone()).max_decoding_message_size(LARGEST),
            gcm: GcmServiceClient::new(channel.clone()).max_decoding_message_size(LARGEST),
            guest: GuestServiceClient::new(channel.clone()),
            interact: InteractServiceClient::new(channel.clone()).max_decoding_message_size(LARGEST),
            plugin: PluginServiceClient::new(channel).max_decoding_message_size(LARGEST),
        }
    }
}

/// `HOST:PORT`, with `https://` in front where that was said.
fn uri(addr: &str) -> String {
    let (scheme, bare) = match addr.strip_prefix("https://") {
        Some(bare) => ("https://", bare),
        None => ("", addr.strip_prefix("http://").unwrap_or(addr)),
    };
    let bare = bare.trim_end_matches('/');
    let has_port = bare
        .rsplit_once(':')
        .is_some_and(|(_, port)| !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()));
    let default_port = super::session::DEFAULT_GCM.rsplit_once(':').map_or("", |(_, port)| port);
    if has_port { format!("{scheme}{bare}") } else { format!("{scheme}{bare}:{default_port}") }
}

/// The innermost error is the one that says something ("Connection refused").
fn root_cause(e: &(dyn Error + 'static)) -> String {
    causes(e).last().unwrap_or(e).to_string()
}

/// An error and those that led to it.
fn causes<'e>(e: &'e (dyn Error + 'static)) -> impl Iterator<Item = &'e (dyn Error + 'static)> {
    std::iter::successors(Some(e), |&cause| cause.source())
}

/// Takes a status apart.
pub(super) fn explain(status: &tonic::Status) -> Told {
    let details = status.get_error_details();
    let info = details.error_info();
    let reason = info.map_or_else(String::new, |i| i.reason.clone());
    let help =
        details.help().and_then(|h| h.links.first()).map(|l| l.description.clone()).unwrap_or_default();
    let code = code_name(status.code());
    let transport = status.code() == tonic::Code::Unavailable && info.is_none();
    // The transport's own words say only which part of it failed.
    let of_transport = status.source().filter(|_| transport);
    Told {
        code,
        // A status without our details is not an answer of a GCM; its code is all there is.
        reason: if reason.is_empty() { code.to_owned() } else { reason },
        late: causes(status).any(|cause| cause.is::<tonic::TimeoutExpired>()),
        silent: causes(status).any(|cause| cause.to_string().contains(UNANSWERED)),
        message: of_transport.map_or_else(|| status.message().to_owned(), root_cause),
        help,
        metadata: info.map(|i| i.metadata.clone().into_iter().collect()).unwrap_or_default(),
        transport,
    }
}

fn code_name(code: tonic::Code) -> &'static str {
    use tonic::Code;
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

#[cfg(test)]
mod tests {
    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn a_port_is_filled_in_and_certificates_are_shown_where_that_was_said() {
        let uris = ["localhost", "http://h:1/", "10.0.0.1:99", "https://or1.local/", "https://h:1"].map(uri);
        assert_eq!(uris, ["localhost:50551", "h:1", "10.0.0.1:99", "https://or1.local:50551", "https://h:1"]);
    }

    #[test]
    fn a_refusal_is_taken_apart_into_reason_help_and_metadata() {
        let mut details = ErrorDetails::new();
        details.set_error_info(
            "CLASS_NOT_FOUND",
            "trocar.v1",
            [("nearest".to_owned(), "eyerobot".to_owned())],
        );
        details.add_help_link("did you mean eyerobot?", "");
        let told = explain(&tonic::Status::with_error_details(tonic::Code::NotFound, "no class", details));
        assert_eq!(
            (told.code, told.reason.as_str(), told.transport),
            ("NOT_FOUND", "CLASS_NOT_FOUND", false)
        );
        assert_eq!(told.help, "did you mean eyerobot?");
        assert_eq!(told.metadata.get("nearest").map(String::as_str), Some("eyerobot"));
    }

    #[test]
    fn a_broken_connection_is_not_a_refusal() {
        assert!(explain(&tonic::Status::unavailable("broken pipe")).transport);
    }
}
