//! Settings of the protocol for each connection of a port, and of the sockets beside it.

use std::time::Duration;

/// Streams one connection may have open at once.
const MAX_STREAMS: u32 = 256;
/// Time open calls get at shutdown.
pub(super) const GRACE: Duration = Duration::from_secs(1);

/// The protocol's settings for each connection.
pub(super) fn transport() -> tonic::transport::Server {
    tonic::transport::Server::builder()
        // Browsers speak it; `web` keeps foreign ones out.
        .accept_http1(true)
        .max_concurrent_streams(MAX_STREAMS)
        .http2_keepalive_interval(Some(Duration::from_secs(20)))
        .http2_keepalive_timeout(Some(Duration::from_secs(10)))
}

/// The same of an agent's port: a caller that a cut network keeps from answering has not hung up.
pub(super) fn patient() -> tonic::transport::Server {
    transport().http2_keepalive_interval(None)
}
