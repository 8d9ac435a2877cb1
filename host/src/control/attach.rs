//! Temporary.
use crate::gcm::Gcm;
use tonic::{Request, Response, Status, Streaming};
use trocar_proto::v1;
pub(super) struct AttachEdge(#[allow(dead_code)] Gcm);
impl AttachEdge {
    pub(super) fn new(gcm: Gcm) -> Self {
        AttachEdge(gcm)
    }
}
#[tonic::async_trait]
impl v1::attach_service_server::AttachService for AttachEdge {
    type AttachStream = tokio_stream::wrappers::ReceiverStream<Result<v1::AttachResponse, Status>>;
    async fn attach(
        &self,
        _: Request<Streaming<v1::AttachRequest>>,
    ) -> Result<Response<Self::AttachStream>, Status> {
        Err(Status::unimplemented("later"))
    }
}
