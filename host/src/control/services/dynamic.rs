//! Any unary call of the GCM service, and Load and Unload, by name; their messages are known by their
//! descriptors only.
//!
//! Invariant: JSON here is the proto3 mapping, so field names, enum words and 64-bit numbers are those
//! grpcurl shows; a field that does not exist is refused, never ignored.

use std::sync::OnceLock;

use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, MethodDescriptor};
use serde_json::{Map, Value};
use tonic::client::{Grpc, GrpcService};
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::codegen::http::uri::PathAndQuery;
use tonic::codegen::{Body, Bytes, StdError};
use tonic::{Request, Status};
use trocar_model::Refusal;
use trocar_proto::FILE_DESCRIPTOR_SET;

const SERVICE: &str = "trocar.v1.GcmService";
/// The service with the methods on plugins.
const PLUGINS: &str = "trocar.v1.PluginService";
/// The methods of `PLUGINS` a component may ask for.
const OF_PLUGINS: [&str; 2] = ["Load", "Unload"];

/// The descriptions the binary carries; read once.
fn pool() -> Result<&'static DescriptorPool, Refusal> {
    static POOL: OnceLock<Result<DescriptorPool, String>> = OnceLock::new();
    let read = || DescriptorPool::decode(FILE_DESCRIPTOR_SET).map_err(|e| e.to_string());
    POOL.get_or_init(read).as_ref().map_err(|e| Refusal::Internal { text: format!("its descriptions: {e}") })
}

/// One unary method a component may ask for.
pub(super) struct Rpc(MethodDescriptor);

impl Rpc {
    /// # Errors
    /// No method, or one that streams.
    pub(super) fn named(verb: &str) -> Result<Rpc, Refusal> {
        let name = if OF_PLUGINS.contains(&verb) { PLUGINS } else { SERVICE };
        let service = pool()?.get_service_by_name(name);
        let service =
            service.ok_or_else(|| Refusal::Internal { text: format!("{name} is not described") })?;
        let unary = |m: &MethodDescriptor| !m.is_server_streaming() && !m.is_client_streaming();
        match service.methods().find(|m| m.name() == verb) {
            Some(method) if unary(&method) => Ok(Rpc(method)),
            Some(_) => Err(unknown(format!(
                "{verb} is a stream, and a component gets one reply: ask WaitFor for one component, or List with \
                 unless_etag, the etag of its last answer"
            ))),
            None => {
                let mut known: Vec<String> =
                    service.methods().filter(unary).map(|m| m.name().to_owned()).collect();
                known.extend(OF_PLUGINS.map(str::to_owned));
                Err(unknown(format!("\"{verb}\" is not one of {}", known.join(", "))))
            }
        }
    }

    /// Tells whether this is a method of the plugin service.
    pub(super) fn of_plugins(&self) -> bool {
        self.0.parent_service().full_name() == PLUGINS
    }

    /// The request message with these fields.
    ///
    /// # Errors
    /// A field that does not exist or does not hold such a value.
    pub(super) fn message(&self, fields: Map<String, Value>) -> Result<Dynamic, Refusal> {
        DynamicMessage::deserialize(self.0.input(), Value::Object(fields)).map(Dynamic).map_err(|e| {
            Refusal::ArgumentInvalid { what: self.0.name().into(), why: e.to_string(), field: String::new() }
        })
    }

    /// Calls it.
    ///
    /// # Errors
    /// The status of the service, or that of a connection that fails.
    pub(super) async fn ask<T>(&self, mut grpc: Grpc<T>, request: Request<Dynamic>) -> Result<Dynamic, Status>
    where
        T: GrpcService<tonic::body::Body>,
        T::Error: Into<StdError>,
        T::ResponseBody: Body<Data = Bytes> + Send + 'static,
        <T::ResponseBody as Body>::Error: Into<StdError> + Send,
    {
        grpc.ready().await.map_err(|e| Status::unavailable(root_cause(e.into())))?;
        let path = format!("/{}/{}", self.0.parent_service().full_name(), self.0.name());
        let path = PathAndQuery::try_from(path).map_err(|e| Status::internal(e.to_string()))?;
        Ok(grpc.unary(request, path, Dynamics { answer: self.0.output() }).await?.into_inner())
    }
}

fn unknown(why: String) -> Refusal {
    Refusal::ArgumentInvalid { what: "verb".into(), why, field: "verb".into() }
}

/// The innermost error is the one that says something ("Connection refused").
fn root_cause(e: StdError) -> String {
    let mut cause: &dyn std::error::Error = &*e;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}

/// A message of any type.
pub(super) struct Dynamic(DynamicMessage);

impl Dynamic {
    /// The proto3 mapping; fields with their default are left out.
    pub(super) fn to_json(&self) -> Result<Value, Refusal> {
        serde_json::to_value(&self.0)
            .map_err(|e| Refusal::Internal { text: format!("the answer has no JSON: {e}") })
    }
}

/// Encodes any message, decodes one type.
struct Dynamics {
    answer: MessageDescriptor,
}

impl Codec for Dynamics {
    type Encode = Dynamic;
    type Decode = Dynamic;
    type Encoder = Out;
    type Decoder = In;

    fn encoder(&mut self) -> Out {
        Out
    }

    fn decoder(&mut self) -> In {
        In(self.answer.clone())
    }
}

struct Out;

impl Encoder for Out {
    type Item = Dynamic;
    type Error = Status;

    fn encode(&mut self, item: Dynamic, buf: &mut EncodeBuf<'_>) -> Result<(), Status> {
        item.0.encode(buf).map_err(|e| Status::internal(e.to_string()))
    }
}

struct In(MessageDescriptor);

impl Decoder for In {
    type Item = Dynamic;
    type Error = Status;

    fn decode(&mut self, buf: &mut DecodeBuf<'_>) -> Result<Option<Dynamic>, Status> {
        let message = DynamicMessage::decode(self.0.clone(), buf);
        message.map(|m| Some(Dynamic(m))).map_err(|e| Status::internal(e.to_string()))
    }
}
