//! One connection with both ends in this process, whatever carries it.
//!
//! Invariant: `model::bindings` decides which members are bound; this file only carries it out. Every wire
//! can be cut at any moment: callers inside finish on the old binding, later ones see UNBOUND.

use std::sync::Arc;

use trocar_lcm_api::LinkDetail;
use trocar_model::{ComponentId, ConnectOptions, Connection, Link, Name, PortId, Refusal, bindings};

use super::carriers::{Both, Carriers};
use super::ends::{Here, Joined};
use super::instance::Instance;

/// One connection of this process.
pub(super) struct Wired {
    pub(super) id: u64,
    pub(super) client: Arc<Instance>,
    pub(super) client_port: Name,
    pub(super) server: Arc<Instance>,
    pub(super) server_port: Name,
    /// True when the client cannot do without it.
    pub(super) required: bool,
    options: ConnectOptions,
    joined: Box<dyn Joined>,
}

impl Wired {
    /// Wires up the connection as the plan decided.
    ///
    /// # Errors
    /// The mismatch refusals of `model::bindings`, should the ports have changed since the plan, and the
    /// refusals of its carrier.
    pub(super) fn connect(
        carriers: &Carriers,
        connection: &Connection,
        client: &Here,
        server: &Here,
    ) -> Result<Wired, Refusal> {
        let (from, to) = (server.instance.described.now(), client.instance.described.now());
        let link =
            bindings(&to.ports, &connection.client, &from.ports, &connection.server, &connection.options)?;
        let required = match &link {
            Link::Stream { input, .. } => !to.ports.inputs[*input].optional,
            Link::Interface { required, .. } => !to.ports.required[*required].optional,
        };
        let joined = carriers.join(&Both { connection, client, server, to, from, link })?;
        Ok(Wired {
            id: connection.id.0,
            client: client.instance.clone(),
            client_port: connection.client.port.clone(),
            server: server.instance.clone(),
            server_port: connection.server.port.clone(),
            required,
            options: connection.options.clone(),
            joined,
        })
    }

    /// True for interfaces whose present descriptions would be wired just as they are: same functions to same
    /// commands, same events to same handlers.
    pub(super) fn still_fits(&self) -> bool {
        let (from, to) = (self.server.described.now(), self.client.described.now());
        let end = |id: &ComponentId, port: &Name| PortId { component: id.clone(), port: port.clone() };
        let (client, server) =
            (end(&self.client.id, &self.client_port), end(&self.server.id, &self.server_port));
        match bindings(&to.ports, &client, &from.ports, &server, &self.options) {
            Ok(Link::Interface { binding, .. }) => self.joined.still_fits(&binding, (&to, &from)),
            _ => false,
        }
    }

    /// Cuts the wires; queued commands are answered PEER_LOST.
    pub(super) fn disconnect(&self) {
        self.joined.cut();
        if self.client.reclaim() + self.server.reclaim() > 0 {
            // A cycle under way may still look at the cut wires; they are dropped after it.
            self.client.look_at_ports();
        }
    }

    /// Tells whether it is a stream: an output joined to an input.
    pub(super) fn is_stream(&self) -> bool {
        self.joined.is_stream()
    }

    pub(super) fn detail(&self) -> LinkDetail {
        let mut detail = self.joined.detail();
        // A call in the same thread needs no wake.
        if detail.carrier != "inline" {
            detail.client_wake = self.client.wake_mode();
            detail.server_wake = if self.is_stream() { "" } else { self.server.wake_mode() };
        }
        detail
    }
}
