//! GuestService: places in the graph for outside callers, and components that end with a caller.
//!
//! Invariant: a guest's place lasts exactly as long as its Join stream, and a held component no longer than
//! its Hold stream, unless this port closes first.

use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};
use trocar_model::{ComponentId, Name, PortId, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::guest_service_server::GuestService;

use super::identity::identity;
use super::{Edge, refuse};
use crate::control::convert;
use crate::control::deadline::{deadline, room};
use crate::gcm::{ExecuteOptions, Guest};

/// Name of a guest's component when the guest wants no other.
const COMPONENT: &str = "shell";
/// Longest description of a guest that is kept, characters.
const PROGRAM: usize = 120;

#[tonic::async_trait]
impl GuestService for Edge {
    type JoinStream = ReceiverStream<Result<v1::JoinResponse, Status>>;

    async fn join(&self, request: Request<v1::JoinRequest>) -> Result<Response<Self::JoinStream>, Status> {
        let guest = guest(request.into_inner()).map_err(refuse)?;
        let joined = self.gcm()?.join(guest).await.map_err(refuse)?;
        let (tell, told) = mpsc::channel(1);
        let first = v1::JoinResponse {
            process: joined.component.process.to_string(),
            component: joined.component.to_string(),
            epoch: joined.registered.epoch,
            term: joined.registered.term,
        };
        let mut closing = self.closing.clone();
        tokio::spawn(async move {
            // A guest that is gone already is noticed next.
            let _ = tell.send(Ok(first)).await;
            tokio::select! {
                () = tell.closed() => {}
                () = joined.ended() => {}
                // Cut by this port: the guest comes to the next GCM.
                _ = closing.changed() => {}
            }
        });
        Ok(Response::new(ReceiverStream::new(told)))
    }

    type HoldStream = ReceiverStream<Result<v1::HoldResponse, Status>>;

    async fn hold(&self, request: Request<v1::HoldRequest>) -> Result<Response<Self::HoldStream>, Status> {
        let identity = identity(&request);
        let component = ComponentId::parse(&request.into_inner().component).map_err(refuse)?;
        let place = self.standing.holds.take()?;
        let mut held = self.gcm()?.hold(component, identity).map_err(refuse)?;
        let mut closing = self.closing.clone();
        let (tell, told) = mpsc::channel(2);
        let first = v1::HoldResponse { component: held.component.to_string() };
        tokio::spawn(async move {
            let _place = place;
            // A caller that is gone already is seen next.
            let _ = tell.send(Ok(first)).await;
            tokio::select! {
                biased;
                // Cut by this port, not by the caller.
                _ = closing.changed() => {
                    held.let_go();
                    let _ = tell.try_send(Err(Status::unavailable("the GCM ends: hold it again at the next one")));
                }
                () = held.over() => {}
                () = tell.closed() => held.end().await,
            }
        });
        Ok(Response::new(ReceiverStream::new(told)))
    }

    async fn require(
        &self,
        request: Request<v1::RequireRequest>,
    ) -> Result<Response<v1::RequireResponse>, Status> {
        let until = deadline(&request);
        let identity = identity(&request);
        let r = request.into_inner();
        let gcm = self.gcm()?.clone();
        let component = ComponentId::parse(&r.component).map_err(refuse)?;
        let server = PortId::parse(&r.server).map_err(refuse)?;
        let name = Some(&r.name).filter(|name| !name.is_empty()).map(|name| Name::parse(name));
        let name = name.transpose().map_err(refuse)?;
        let deadline = Some(until - room(until));
        let options = ExecuteOptions { deadline, identity, ..ExecuteOptions::default() };
        // A caller that goes away must not leave a change half made.
        let running = tokio::spawn(async move { gcm.require(&component, name, &server, options).await });
        match running.await {
            Ok(Ok(made)) => Ok(Response::new(v1::RequireResponse {
                revision: made.revision,
                client: made.client.to_string(),
                connection: made.connection.0,
                provided: Some(convert::provided(&made.provided)),
            })),
            Ok(Err(refusal)) => Err(refuse(refusal)),
            Err(e) => Err(refuse(Refusal::Internal { text: format!("the request panicked: {e}") })),
        }
    }
}

fn guest(r: v1::JoinRequest) -> Result<Guest, Refusal> {
    let component = if r.component.is_empty() { COMPONENT } else { &r.component };
    let program = if r.program.trim().is_empty() { "a guest" } else { r.program.trim() };
    Ok(Guest {
        process: Name::parse(&r.process)?,
        component: Name::parse(component)?,
        program: program.chars().take(PROGRAM).collect(),
        pid: r.pid,
    })
}
