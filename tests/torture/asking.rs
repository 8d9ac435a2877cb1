//! What only a few rows ask: plugins by name, and bytes that are no message.
//!
//! Invariant: as in `rpc`, every call has a deadline.

use std::future::poll_fn;
use std::pin::Pin;

use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, Request};
use tonic::codegen::{Body as _, Service};
use trocar_proto::v1::DescribePluginRequest;
use trocar_proto::v1::plugin_service_client::PluginServiceClient;

use crate::rpc::{Answer, PATIENCE, Rpc, done, runtime};

impl Rpc {
    /// Asks what a plugin of a process has.
    pub(crate) fn plugin(&self, process: &str, name: &str) -> Answer<()> {
        let request = DescribePluginRequest { process: process.into(), name: name.into() };
        done(async { PluginServiceClient::new(self.channel.clone()).describe_plugin(request).await })
            .map(drop)
    }

    /// Any body for a method; answers its gRPC status, as a number, and what is said of it.
    pub(crate) fn raw(&self, method: &str, body: String) -> Result<(String, String), String> {
        let request = Request::post(format!("http://{}{method}", self.address))
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(Body::new(body))
            .map_err(|e| e.to_string())?;
        let mut channel = self.channel.clone();
        let call = async {
            poll_fn(|cx| Service::poll_ready(&mut channel, cx)).await?;
            let answer = channel.call(request).await?;
            let (head, mut body) = answer.into_parts();
            let mut fields = head.headers;
            // The status is in the head when there is nothing else, or behind it.
            while let Some(frame) = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await {
                if let Ok(frame) = frame
                    && let Ok(trailers) = frame.into_trailers()
                {
                    fields.extend(trailers);
                }
            }
            Ok::<HeaderMap, tonic::transport::Error>(fields)
        };
        let fields = runtime()
            .block_on(async { tokio::time::timeout(PATIENCE, call).await })
            .map_err(|_| format!("no answer within {} s", PATIENCE.as_secs()))?
            .map_err(|e| format!("{e:?}"))?;
        let of = |name: &str| fields.get(name).map(|v| String::from_utf8_lossy(v.as_bytes()).into_owned());
        Ok((of("grpc-status").unwrap_or_default(), of("grpc-message").unwrap_or_default()))
    }
}
