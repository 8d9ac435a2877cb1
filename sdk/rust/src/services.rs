//! Dynamic component services: a component's requests to the system, and the answers.
//!
//! Invariant: asking never waits; the answer comes later, under the token that the request returned. Field
//! names are those of the messages in proto/trocar/v1.

use crate::host::Host;
use crate::outcome::Outcome;
use serde_json::{Map, Value as Json, json};

/// Asks for services; from [`Host::services`]. Each request returns the token of its [`ServiceReply`], or the
/// outcome why not: `WouldBlock` from `step`, `QueueFull` when too many are under way.
///
/// ```
/// use trocar_sdk::{ServiceReply, prelude::*, serde_json::json};
///
/// /// Makes a filter and starts it.
/// #[derive(Component)]
/// struct Builder {
///     #[host]
///     host: Host,
///     making: u64,
/// }
///
/// impl Component for Builder {
///     fn start(&mut self) -> Result {
///         let config = json!({"cutoff_hz": 20.0});
///         self.making = self.host.services().create("host/filter", "low_pass", config).unwrap_or(0);
///         Ok(())
///     }
///     fn answered(&mut self, reply: ServiceReply) -> Result {
///         if reply.token == self.making && reply.ok {
///             let _ = self.host.services().start("host/filter");
///         }
///         Ok(())
///     }
/// }
/// ```
#[derive(Clone, Copy)]
pub struct Services<'a> {
    host: &'a Host,
}

type Token = Result<u64, Outcome>;

impl Host {
    /// The dynamic component services: make, connect and start components, stop oneself. Any thread but from
    /// `step`.
    pub fn services(&self) -> Services<'_> {
        Services { host: self }
    }
}

impl Services<'_> {
    /// Any service by its verb, with the fields of its gRPC request.
    ///
    /// # Errors
    /// `InvalidArgument` when `fields` is no object; else the host's outcome.
    pub fn ask(&self, verb: &str, fields: Json) -> Token {
        let Json::Object(mut request) = fields else { return Err(Outcome::InvalidArgument) };
        request.insert("verb".to_string(), Json::from(verb));
        let token = self.host.next_token();
        let outcome = self.host.service(token, &Json::Object(request).to_string());
        if outcome.is_ok() { Ok(token) } else { Err(outcome) }
    }

    /// Makes a component of a class; `config` may be null for the defaults.
    ///
    /// # Errors
    /// The host's outcome.
    pub fn create(&self, path: &str, class: &str, config: Json) -> Token {
        let mut fields = json!({ "path": path, "class": class });
        if !config.is_null() {
            fields["config"] = config;
        }
        self.ask("Create", fields)
    }

    /// Merges `config` into the component's configuration (RFC 7396).
    ///
    /// # Errors
    /// The host's outcome.
    pub fn configure(&self, path: &str, config: Json) -> Token {
        self.ask("Configure", json!({ "path": path, "config": config }))
    }

    /// Joins a client end (required interface or input) to a server end (provided interface or output).
    ///
    /// # Errors
    /// The host's outcome.
    pub fn connect(&self, client: &str, server: &str) -> Token {
        self.ask("Connect", json!({ "client": client, "server": server }))
    }

    /// Takes the connection between a client end and a server end away.
    ///
    /// # Errors
    /// The host's outcome.
    pub fn disconnect(&self, client: &str, server: &str) -> Token {
        self.ask("Disconnect", json!({ "client": client, "server": server }))
    }

    /// The response lists processes, components and connections.
    ///
    /// # Errors
    /// The host's outcome.
    pub fn list(&self) -> Token {
        self.ask("List", json!({}))
    }

    /// Waits until the component is in one of `states` ("ACTIVE"), at most for `deadline_s` seconds.
    ///
    /// # Errors
    /// The host's outcome.
    pub fn wait_for(&self, path: &str, states: &[&str], deadline_s: f64) -> Token {
        let states: Vec<String> = states.iter().map(|s| format!("COMPONENT_STATE_{s}")).collect();
        self.ask(
            "WaitFor",
            json!({ "path": path, "states": states, "deadline": format!("{deadline_s:.3}s") }),
        )
    }
}

macro_rules! of_one_path {
    ($($(#[$doc:meta])* $name:ident = $verb:literal;)*) => {
        impl Services<'_> {$(
            $(#[$doc])*
            ///
            /// # Errors
            /// The host's outcome.
            pub fn $name(&self, path: &str) -> Token {
                self.ask($verb, json!({ "path": path }))
            }
        )*}
    };
}
of_one_path! {
    /// Starts the component.
    start = "Start";
    /// Stops the component, also the one that asks.
    stop = "Stop";
    /// Lets a stopped component go on.
    resume = "Resume";
    /// Makes the component new, with its configuration.
    reset = "Reset";
    /// Takes the component away.
    remove = "Remove";
    /// The response has the component's state and health.
    get_state = "GetState";
    /// The response has the component's ports and their types.
    describe = "Describe";
}

/// The answer to a service asked for earlier.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ServiceReply {
    /// Token that the request returned.
    pub token: u64,
    /// The system did it; otherwise `reason`, `message` and `help` say why not.
    pub ok: bool,
    /// The gRPC response as JSON; null when refused.
    pub response: Json,
    /// The refusal's code: "WRONG_STATE", …
    pub reason: String,
    /// The refusal's sentence.
    pub message: String,
    /// The refusal's advice.
    pub help: String,
}

impl ServiceReply {
    /// Reads a host's reply; a reply that is not understood becomes a refusal that says so.
    pub fn parse(token: u64, reply: &str) -> ServiceReply {
        let mut object = match serde_json::from_str::<Map<String, Json>>(reply) {
            Ok(object) => object,
            Err(e) => {
                let message = format!("the host's reply is not understood: {e}");
                return ServiceReply {
                    token,
                    reason: "BAD_REPLY".into(),
                    message,
                    ..ServiceReply::default()
                };
            }
        };
        let text = |object: &Map<String, Json>, key: &str| {
            object.get(key).and_then(Json::as_str).unwrap_or_default().to_string()
        };
        ServiceReply {
            token,
            ok: object.get("ok").and_then(Json::as_bool).unwrap_or(false),
            response: object.remove("response").unwrap_or_default(),
            reason: text(&object, "reason"),
            message: text(&object, "message"),
            help: text(&object, "help"),
        }
    }
}
