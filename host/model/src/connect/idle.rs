//! Members that a connection of interfaces was to bind and does not: all that is optional may be absent, and
//! no connection is refused.
//!
//! Invariant: tells only what the author of a typing error would want to know; one optional member of several
//! that is there shows that the interface is the right one.

use super::Port;
use crate::{PortId, Ports, nearest};

/// Returns a sentence for a connection of which no optional member is found, so that it does less than it
/// says, or nothing.
pub fn idle_connection(
    client: &Ports,
    client_port: &PortId,
    server: &Ports,
    server_port: &PortId,
) -> Option<String> {
    let ends = (client.find(client_port.port.as_str())?, server.find(server_port.port.as_str())?);
    let (Port::Required(_, wanted), Port::Provided(_, offered)) = ends else { return None };
    let commands = || offered.commands.iter().map(|c| c.name.as_str());
    let events = || offered.events.iter().map(|e| e.name.as_str());
    let functions = wanted.functions.iter().filter(|f| f.optional).map(|f| f.name.as_str());
    let handlers = wanted.handlers.iter().filter(|h| h.optional).map(|h| h.name.as_str());
    if functions.clone().any(|f| commands().any(|c| c == f))
        || handlers.clone().any(|h| events().any(|e| e == h))
    {
        return None;
    }
    let hint = |name: &str, there: Vec<&str>| match nearest(name, there) {
        Some(near) => format!("`{name}` (did you mean `{near}`?)"),
        None => format!("`{name}`"),
    };
    let absent: Vec<String> = functions
        .map(|f| hint(f, commands().collect()))
        .chain(handlers.map(|h| hint(h, events().collect())))
        .collect();
    if absent.is_empty() {
        return None;
    }
    let there: Vec<&str> = commands().chain(events()).collect();
    let there = match &there[..] {
        [] => "is nothing".to_owned(),
        [one] => format!("is {one}"),
        several => format!("are {}", several.join(", ")),
    };
    let all = wanted.functions.len() + wanted.handlers.len() == absent.len();
    let so = if all { ", so nothing passes through this connection" } else { "" };
    Some(format!(
        "`{client_port}` finds nothing optional of its own in `{server_port}`{so}: it looks for {}, and there {there}",
        absent.join(", ")
    ))
}
