//! Requests of components, carried out like anybody's: through the GCM service, here or in another process.
//!
//! Invariant: nothing is checked, decided or logged here that the GCM service would not do for grpcurl; only
//! the caller differs, and JSON takes the place of protobuf.

mod dynamic;

use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use serde_json::{Map, Value, json};
use tokio::runtime::Handle;
use tokio::sync::{Semaphore, watch};
use tonic::client::Grpc;
use tonic::{Request, Status};
use tonic_types::StatusExt;
use trocar_model::{ComponentId, Refusal};
use trocar_proto::v1::gcm_service_server::GcmServiceServer;
use trocar_proto::v1::plugin_service_server::PluginServiceServer;

use self::dynamic::{Dynamic, Rpc};
use super::attach::MAX_MESSAGE;
use super::caller::Tokened;
use super::dial::Dialler;
use super::leader::{addresses, find_leader, innermost, leader_named};
use super::server::{Caller, Commanded, Edge, FOLLOWED, Standing};
use super::status::{code_name, status};
use crate::gcm::Gcm;
use crate::lcm::{ReplyTo, Services};

/// Time limit for connecting to a GCM in another process.
const CONNECT: Duration = Duration::from_secs(2);
/// Time limit of a request, as for a caller that names no deadline.
const WITHIN: Duration = Duration::from_secs(5);
/// Time limit of WaitFor; its own `deadline` ends it earlier.
const LONGEST: Duration = Duration::from_secs(60);
/// Header that names the component a host asks for.
pub(super) const FOR_COMPONENT: &str = "trocar-component";

/// The way from the components of a host to its GCM.
pub struct GcmServices {
    runtime: Handle,
    way: Way,
    /// Calls that wait for something end with it.
    _open: watch::Sender<()>,
}

#[derive(Clone)]
enum Way {
    Here(Edge),
    There { addr: String, channel: Tokened },
    Among(Arc<Among>),
}

/// Several GCMs, of which one leads.
struct Among {
    dialler: Dialler,
    addrs: Vec<String>,
    /// The one that led when it was asked last.
    leader: Mutex<Option<(String, Tokened)>>,
}

impl Among {
    async fn leader(&self) -> Result<(String, Tokened), Status> {
        if let Some(known) = self.leader.lock().clone() {
            return Ok(known);
        }
        let found = find_leader(&self.dialler, &self.addrs, None, CONNECT).await.map_err(|said| {
            let all: Vec<String> = said.iter().map(|(addr, why)| format!("{addr}: {why}")).collect();
            let why = format!("no GCM leads ({})", all.join("; "));
            status(&Refusal::NotLeader { leader: String::new(), why })
        })?;
        let leader = (found.addr, found.channel);
        *self.leader.lock() = Some(leader.clone());
        Ok(leader)
    }

    /// Looks for the leader anew after it did not answer as one. True: it has done nothing.
    fn was_refused(&self, refused: &Status) -> bool {
        let is_other = leader_named(refused).is_some();
        if is_other || refused.get_error_details().error_info().is_none() {
            *self.leader.lock() = None;
        }
        is_other
    }
}

impl GcmServices {
    /// Asks a GCM in this process. Call it inside a tokio runtime.
    pub fn here(gcm: Gcm) -> GcmServices {
        let lines = gcm.lines().clone();
        let (open, closing) = watch::channel(());
        let followed = Arc::new(Semaphore::new(FOLLOWED));
        let standing = Arc::new(Standing::default());
        let edge = Edge {
            gcm: Some(gcm),
            local: None,
            managed_by: None,
            lines,
            followed,
            standing,
            commanded: Commanded::default(),
            closing,
        };
        GcmServices { runtime: Handle::current(), way: Way::Here(edge), _open: open }
    }

    /// Asks the GCM at `addr`, or the one that leads where it names several with commas between them. It
    /// connects at the first request, and again after a loss. Call it inside a tokio runtime.
    ///
    /// # Errors
    /// The address is malformed.
    pub fn at(addr: &str, dialler: &Dialler) -> Result<GcmServices, String> {
        let addrs = addresses(addr);
        if addrs.len() > 1 {
            let way =
                Way::Among(Arc::new(Among { dialler: dialler.clone(), addrs, leader: Mutex::default() }));
            return Ok(GcmServices { runtime: Handle::current(), way, _open: watch::channel(()).0 });
        }
        let channel = dialler.lazily(addr, CONNECT).map_err(|e| innermost(&*e))?;
        let way = Way::There { addr: addr.strip_prefix("http://").unwrap_or(addr).into(), channel };
        Ok(GcmServices { runtime: Handle::current(), way, _open: watch::channel(()).0 })
    }
}

impl Services for GcmServices {
    fn request(&self, from: ComponentId, request: String, reply: ReplyTo) {
        let way = self.way.clone();
        self.runtime.spawn(async move {
            let answer = match answer(way, &from, &request).await {
                Ok(response) => json!({ "ok": true, "response": response }),
                Err(status) => refused(&status),
            };
            reply(answer.to_string());
        });
    }
}

async fn answer(way: Way, from: &ComponentId, text: &str) -> Result<Value, Status> {
    let (verb, fields) = taken_apart(text).map_err(|refusal| status(&refusal))?;
    let rpc = Rpc::named(&verb).map_err(|refusal| status(&refusal))?;
    let message = || rpc.message(fields.clone()).map_err(|refusal| status(&refusal));
    let within = if verb == "WaitFor" { LONGEST } else { WITHIN };
    let answered = match way {
        Way::Here(edge) => {
            let mut request = Request::new(message()?);
            request.set_timeout(within);
            request.extensions_mut().insert(Caller(from.to_string()));
            if rpc.of_plugins() {
                rpc.ask(Grpc::new(PluginServiceServer::new(edge)), request).await
            } else {
                rpc.ask(Grpc::new(GcmServiceServer::new(edge)), request).await
            }
        }
        Way::There { addr, channel } => asked_there(&rpc, message()?, from, within, (addr, channel)).await,
        Way::Among(among) => {
            let first = asked_there(&rpc, message()?, from, within, among.leader().await?).await;
            match first {
                // Once more: a GCM that does not lead has done nothing.
                Err(refused) if among.was_refused(&refused) => {
                    let second = asked_there(&rpc, message()?, from, within, among.leader().await?).await;
                    second.inspect_err(|refused| _ = among.was_refused(refused))
                }
                answered => answered,
            }
        }
    };
    answered.and_then(|message| message.to_json().map_err(|refusal| status(&refusal)))
}

async fn asked_there(
    rpc: &Rpc,
    message: Dynamic,
    from: &ComponentId,
    within: Duration,
    (addr, channel): (String, Tokened),
) -> Result<Dynamic, Status> {
    let mut request = Request::new(message);
    request.set_timeout(within);
    if let Ok(path) = from.to_string().parse() {
        request.metadata_mut().insert(FOR_COMPONENT, path);
    }
    let grpc = Grpc::new(channel).max_decoding_message_size(MAX_MESSAGE);
    rpc.ask(grpc, request).await.map_err(|e| unreached(&addr, e))
}

/// The verb and the fields beside it.
fn taken_apart(text: &str) -> Result<(String, Map<String, Value>), Refusal> {
    let invalid = |why: String| Refusal::ArgumentInvalid {
        what: "the request for a service".into(),
        why,
        field: "verb".into(),
    };
    let mut fields: Map<String, Value> =
        serde_json::from_str(text).map_err(|e| invalid(format!("it is not a JSON object: {e}")))?;
    match fields.remove("verb") {
        Some(Value::String(verb)) => Ok((verb, fields)),
        _ => Err(invalid("it has no \"verb\"".into())),
    }
}

/// A status that no GCM gave: it was not reached.
fn unreached(addr: &str, status: Status) -> Status {
    let given = status.get_error_details().error_info().is_some();
    if given || !matches!(status.code(), tonic::Code::Unavailable | tonic::Code::Unknown) {
        return status;
    }
    let mut details = tonic_types::ErrorDetails::new();
    details.set_error_info("NO_GCM", super::status::DOMAIN, [("addr".to_owned(), addr.to_owned())]);
    details.add_help_link("ask again: the host connects anew each time", "");
    let text = format!("no GCM answers at {addr}: {}", status.message());
    Status::with_error_details(tonic::Code::Unavailable, text, details)
}

fn refused(status: &Status) -> Value {
    let details = status.get_error_details();
    let reason = details.error_info().map_or("", |info| info.reason.as_str());
    let help = details.help().and_then(|h| h.links.first()).map_or("", |link| link.description.as_str());
    json!({
        "ok": false,
        "code": code_name(status.code()),
        "reason": reason,
        "message": status.message(),
        "help": help,
    })
}

#[cfg(test)]
mod tests;
