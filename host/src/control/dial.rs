//! The way to a port: by the socket beside it, else by TCP, with the token of the environment.
//!
//! Invariant: a socket is taken only from this user's own runtime directory, so nobody else can stand behind
//! it. A caller that asks by a door never waits for ever: a host that stands still (its kernel still takes
//! connections) is found out by pings it does not answer.

use std::time::Duration;

use tonic::transport::{Channel, Endpoint, Error};

use super::caller::{Tokened, with_token};
use crate::runtime_dir::{Door, RuntimeDir};

/// During a request, a host that is silent for this long is pinged.
const QUIET: Duration = Duration::from_secs(5);
/// The connection ends where it does not answer within that.
const ANSWERS: Duration = Duration::from_secs(5);

/// Connects to `http://HOST:PORT`: by the socket beside it if `door` names one that exists, else by TCP;
/// `within` bounds each attempt.
///
/// # Errors
/// No address, no listener there, or no answer in time.
pub async fn dial(uri: &str, door: Option<Door>, within: Duration) -> Result<Tokened, Error> {
    if let Some(door) = door
        && let Some(channel) = beside(uri, door, within).await
    {
        return Ok(with_token(channel));
    }
    let endpoint = Endpoint::from_shared(uri.to_owned())?.connect_timeout(within).tcp_nodelay(true);
    // An Attach has heartbeats of its own.
    let endpoint = if door.is_some() { pinged(endpoint) } else { endpoint };
    Ok(with_token(endpoint.connect().await?))
}

/// Connects by TCP to `http://HOST:PORT`, for a call that may be silent for long: a listener that stands
/// still is found out by pings.
///
/// # Errors
/// No address, no listener there, or no answer in time.
pub(super) async fn dial_pinged(uri: &str, within: Duration) -> Result<Tokened, Error> {
    let endpoint = Endpoint::from_shared(uri.to_owned())?.connect_timeout(within).tcp_nodelay(true);
    Ok(with_token(pinged(endpoint).connect().await?))
}

fn pinged(endpoint: Endpoint) -> Endpoint {
    endpoint.http2_keep_alive_interval(QUIET).keep_alive_timeout(ANSWERS)
}

async fn beside(uri: &str, door: Door, within: Duration) -> Option<Channel> {
    let addrs = tokio::net::lookup_host(uri.strip_prefix("http://")?).await.ok()?;
    let dir = RuntimeDir::of_user();
    dir.is_own().ok()?;
    for addr in addrs.filter(|addr| addr.ip().is_loopback()) {
        let path = dir.way(addr, door);
        let Ok(endpoint) = Endpoint::from_shared(format!("unix:{}", path.display())) else { continue };
        // A socket that a killed host left refuses at once.
        if let Ok(channel) = pinged(endpoint).connect_timeout(within).connect().await {
            return Some(channel);
        }
    }
    None
}
