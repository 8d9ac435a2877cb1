//! Values as the class declares them.
//!
//! Invariant: what another process of the built program answers comes as JSON, which has one kind of number;
//! read by its type it must be what a host in this program answers. Nothing else is changed.

use serde_json::Value;
use trocar::model::{Ports, Type, decode, encode};

use super::Lab;

impl Lab {
    /// A state row (`component`), a result or an event (`component/interface/member`), read by its type.
    ///
    /// # Panics
    /// It is not of that type.
    #[must_use]
    pub(super) fn as_declared(&self, path: &str, value: Value) -> Value {
        if self.spawned.is_empty() {
            return value;
        }
        let graph = self.graph();
        let ports = graph.components.get(&self.id(path)).map(|c| c.ports.clone());
        let Some(ty) = ports.as_ref().and_then(|ports| declared(ports, path)) else { return value };
        let read = encode(ty, &value).and_then(|bytes| decode(ty, &bytes));
        read.unwrap_or_else(|e| panic!("{path} is {value}, which is no {}: {e}", ty.title()))
    }
}

/// The type of what a path names; none where the ports have become others, or nothing comes of it.
fn declared<'p>(ports: &'p Ports, path: &str) -> Option<&'p Type> {
    let mut parts = path.split('/').skip(1);
    let Some(interface) = parts.next() else { return ports.state.as_ref() };
    let (interface, member) = (ports.provided.iter().find(|p| p.name == interface)?, parts.next()?);
    let command = interface.commands.iter().find(|c| c.name == member);
    let event = interface.events.iter().find(|e| e.name == member);
    command.map_or_else(|| event?.payload.as_ref(), |c| c.ret.as_ref())
}
