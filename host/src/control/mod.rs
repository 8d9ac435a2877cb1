//! The gRPC edge: one port, thin methods, the only place that knows wire types on the serving side.
//!
//! Invariant: every refusal leaves through `status.rs`, every name enters through `convert`; methods decide
//! nothing.

mod agents;
mod attach;
mod caller;
pub(crate) mod convert;
mod deadline;
mod dial;
mod doors;
mod incoming;
mod kind;
mod leader;
mod occupant;
mod seat;
mod serve;
mod server;
mod services;
mod status;
mod transport;
mod uplink;
mod web;

#[cfg(test)]
mod tests;

pub use agents::{Reach, Seen, ToKeep};
pub use attach::{AttachEdge, FeedOutbound, Outbound};
pub use caller::{PortRules, Tokened, Viewer};
pub use dial::{DialError, Dialler};
pub use leader::{Leader, addresses, find_leader};
pub use seat::Seat;
pub(crate) use serve::JOURNAL;
pub use serve::{Secured, ServeConfig, ServeError, Server};
pub use services::GcmServices;
pub use uplink::{
    Begin, FeedInbound, FeedOutgoing, Feeder, Inbound, Line, Refused, Uplink, UplinkError, Way,
};
