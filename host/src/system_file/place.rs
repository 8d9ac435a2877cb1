//! The place in the file of the thing that a refusal is about.
//!
//! Invariant: a refusal leads to the same place whether it comes from this process or over the wire, as
//! reason and values.

use std::collections::BTreeMap;

use trocar_model::{ComponentId, PortId, Refusal};

use super::SystemFile;
use super::problem::{Problem, join};

impl SystemFile {
    /// Returns the place in the file of the thing that a refusal is about.
    pub fn locate(&self, refusal: &Refusal) -> Option<Problem> {
        let pointer = self.pointer_of(refusal)?;
        let at = self.document.root.nearest_to(&pointer).at;
        let help = in_a_file(refusal.reason(), &pointer).map_or_else(|| refusal.help(), str::to_owned);
        Some(self.document.problem(at, &pointer, refusal.to_string(), help))
    }

    fn pointer_of(&self, refusal: &Refusal) -> Option<String> {
        let component = |id: &ComponentId| join("/components", &self.written(id).to_string());
        let pair = |client: &PortId, server: &PortId| {
            let at = self.connections.iter().position(|c| c.client == *client && c.server == *server)?;
            Some(format!("/connections/{at}"))
        };
        let port = |port: &PortId| {
            self.connections.iter().enumerate().find_map(|(at, c)| {
                let end = if c.client == *port { "client" } else { "server" };
                (c.client == *port || c.server == *port).then(|| format!("/connections/{at}/{end}"))
            })
        };
        match refusal {
            Refusal::ClassNotFound { class, .. } => {
                let spec = self.components.iter().find(|c| c.class == *class)?;
                Some(component(&spec.id) + "/class")
            }
            Refusal::ConfigInvalid { id, violations } => {
                let within = violations.first().map_or("", |v| v.pointer.as_str());
                Some(component(id) + "/config" + within)
            }
            Refusal::ComponentNotFound { id, .. } => {
                let at = self
                    .connections
                    .iter()
                    .position(|c| c.client.component == *id || c.server.component == *id)?;
                Some(format!("/connections/{at}"))
            }
            Refusal::ComponentExists { id }
            | Refusal::WrongState { id, .. }
            | Refusal::Unconnected { id, .. }
            | Refusal::ComponentRefused { id, .. }
            | Refusal::ComponentFault { id, .. }
            | Refusal::NoMemory { id, .. }
            | Refusal::NoThread { id, .. } => Some(component(id)),
            Refusal::InterfaceNotFound { port: asked, .. } => port(asked),
            Refusal::WrongDirection { client, server, .. }
            | Refusal::AlreadyConnected { client, server }
            | Refusal::ConnectionExists { client, server, .. }
            | Refusal::CommandMissing { client, server, .. }
            | Refusal::CommandKindMismatch { client, server, .. }
            | Refusal::TypeMismatch { client, server, .. }
            | Refusal::FormatMismatch { client, server, .. }
            | Refusal::TagMismatch { client, server, .. }
            | Refusal::TruthToActuator { client, server, .. }
            | Refusal::Unreachable { client, server, .. } => pair(client, server),
            Refusal::ArgumentInvalid { what, field, .. } => self.option(what, field),
            _ => None,
        }
    }

    /// The same for a refusal that came over the wire.
    pub fn locate_told(
        &self,
        reason: &str,
        message: &str,
        help: &str,
        values: &BTreeMap<String, String>,
    ) -> Option<Problem> {
        let pointer = self.pointer_told(reason, values)?;
        let at = self.document.root.nearest_to(&pointer).at;
        let help = in_a_file(reason, &pointer).unwrap_or(help);
        Some(self.document.problem(at, &pointer, message.to_owned(), help.to_owned()))
    }

    fn pointer_told(&self, reason: &str, values: &BTreeMap<String, String>) -> Option<String> {
        let value = |key: &str| values.get(key).map(String::as_str);
        let connection = |at: usize| format!("/connections/{at}");
        let id = value("component").and_then(|id| ComponentId::parse(id).ok());
        let component = |id: &ComponentId| join("/components", &self.written(id).to_string());
        let mut connections = self.connections.iter();
        match (reason, id) {
            ("ARGUMENT_INVALID", None) => self.option(value("what")?, value("field")?),
            ("CLASS_NOT_FOUND", _) => {
                let is_it = |p: &str, c: &str| value("process") == Some(p) && value("class") == Some(c);
                let spec = self.components.iter().find(|c| is_it(c.id.process.as_str(), &c.class))?;
                Some(component(&spec.id) + "/class")
            }
            ("CONFIG_INVALID", Some(id)) => Some(component(&id) + "/config"),
            (_, Some(id)) => Some(component(&id)),
            (_, None) => match (value("client"), value("server"), value("port")) {
                (Some(client), Some(server), _) => connections
                    .position(|c| c.client.to_string() == client && c.server.to_string() == server)
                    .map(connection),
                (.., Some(port)) => connections
                    .position(|c| c.client.to_string() == port || c.server.to_string() == port)
                    .map(connection),
                _ => None,
            },
        }
    }

    /// Returns the pointer to an option of a refused Connect, or to an execution setting of a refused Create.
    fn option(&self, what: &str, field: &str) -> Option<String> {
        if let (Some(id), Some(setting)) = (what.strip_prefix("Create "), field.strip_prefix("execution.")) {
            let id = ComponentId::parse(id).ok()?;
            let spec = self.components.iter().find(|c| c.id == id)?;
            return Some(join("/components", &spec.written.to_string()) + "/execution/" + setting);
        }
        let (client, option) = (what.strip_prefix("Connect ")?, field.strip_prefix("options.")?);
        let at = self.connections.iter().position(|c| c.client.to_string() == client)?;
        let unit = if matches!(option, "max_age" | "deadline") { "_ms" } else { "" };
        Some(format!("/connections/{at}/{option}{unit}"))
    }

    /// Returns the name of a component in the file.
    pub(super) fn written<'a>(&'a self, id: &'a ComponentId) -> &'a ComponentId {
        self.components.iter().find(|c| c.id == *id).map_or(id, |c| &c.written)
    }
}

/// The help of a refusal where a file says what is wanted: the file is changed, there is no request with
/// options.
fn in_a_file(reason: &str, pointer: &str) -> Option<&'static str> {
    match reason {
        "ALREADY_CONNECTED" => Some(
            "Leave one of the client's connections out, an input or required interface takes one server; of a system that is up \
             already, `trocar disconnect CLIENT` first.",
        ),
        "UNCONNECTED" => {
            Some("Write a connection for each of them, or declare the end optional in the class.")
        }
        "ARGUMENT_INVALID" if pointer.starts_with("/connections/") || pointer.contains("/execution") => {
            Some("Correct it in the file; `trocar schema system` prints what belongs in it.")
        }
        _ => None,
    }
}
