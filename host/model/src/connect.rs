//! Tells whether a required end fits a provided one, and what binds to what.
//!
//! Invariant: decided before anything runs and by values alone; the planner and the LCM use the same answer,
//! so every plan can be done.

mod idle;

pub use idle::idle_connection;

use crate::refusal::{ADAPTABLE, scattered};
use crate::{
    Command, CommandKind, ConnectOptions, Function, Handler, Input, Output, PortId, PortType, Ports,
    Provided, Refusal, Required, Type, Unit,
};

/// Match of two ports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Link {
    /// Positions in `Ports::inputs` of the client and `Ports::outputs` of the server.
    Stream {
        input: usize,
        output: usize,
        /// The layouts differ: samples are copied by name ([`Type::copy_plan`]).
        adapt: bool,
    },
    /// Positions in `Ports::required` of the client and `Ports::provided` of the server.
    Interface { required: usize, provided: usize, binding: Binding },
}

/// Bindings of a required interface's members. All numbers are ABI ids: positions over all interfaces of the
/// class. An optional function or handler without a counterpart is absent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Binding {
    /// (function of the client's class, command of the server's class), in the client's order.
    pub functions: Vec<(usize, usize)>,
    /// (handler of the client's class, event of the server's class), in the client's order.
    pub handlers: Vec<(usize, usize)>,
}

/// One of the four kinds of port, found by name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Port<'a> {
    Input(usize, &'a Input),
    Output(usize, &'a Output),
    Required(usize, &'a Required),
    Provided(usize, &'a Provided),
}

impl Port<'_> {
    /// Returns the word people use for it.
    pub fn kind(&self) -> &'static str {
        match self {
            Port::Input(..) => "an input",
            Port::Output(..) => "an output",
            Port::Required(..) => "a required interface",
            Port::Provided(..) => "a provided interface",
        }
    }
}

impl Ports {
    /// Inputs, outputs and interfaces share one namespace per component.
    pub fn find(&self, name: &str) -> Option<Port<'_>> {
        let input =
            || self.inputs.iter().enumerate().find(|(_, p)| p.name == name).map(|(i, p)| Port::Input(i, p));
        let output =
            || self.outputs.iter().enumerate().find(|(_, p)| p.name == name).map(|(i, p)| Port::Output(i, p));
        let required = || {
            self.required.iter().enumerate().find(|(_, p)| p.name == name).map(|(i, p)| Port::Required(i, p))
        };
        let provided = || {
            self.provided.iter().enumerate().find(|(_, p)| p.name == name).map(|(i, p)| Port::Provided(i, p))
        };
        input().or_else(output).or_else(required).or_else(provided)
    }

    /// Tells whether the component only looks at what comes by this input: it takes any type, and the
    /// component has neither outputs nor required interfaces.
    pub fn looks_on(&self, input: usize) -> bool {
        let any = self.inputs.get(input).is_some_and(|input| input.ty == PortType::Any);
        any && self.required.is_empty() && self.own_outputs().next().is_none()
    }

    /// Returns the outputs that are the class's own: all but the taps.
    pub fn own_outputs(&self) -> impl Iterator<Item = &Output> {
        self.outputs.iter().filter(|output| !output.is_tap())
    }

    /// Names of all ports but the taps: inputs, outputs, required, provided, each in the class's order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let inputs = self.inputs.iter().map(|p| p.name.as_str());
        let outputs = self.own_outputs().map(|p| p.name.as_str());
        let required = self.required.iter().map(|p| p.name.as_str());
        inputs.chain(outputs).chain(required).chain(self.provided.iter().map(|p| p.name.as_str()))
    }

    /// Tells whether the component cannot do without that input or required interface.
    pub fn requires(&self, name: &str) -> bool {
        match self.find(name) {
            Some(Port::Input(_, input)) => !input.optional,
            Some(Port::Required(_, required)) => !required.optional,
            _ => false,
        }
    }

    /// ABI id of the first command of provided interface `index`.
    pub fn first_command(&self, index: usize) -> usize {
        self.provided.iter().take(index).map(|p| p.commands.len()).sum()
    }

    /// ABI id of the first event of provided interface `index`.
    pub fn first_event(&self, index: usize) -> usize {
        self.provided.iter().take(index).map(|p| p.events.len()).sum()
    }

    /// ABI id of the first function of required interface `index`.
    pub fn first_function(&self, index: usize) -> usize {
        self.required.iter().take(index).map(|p| p.functions.len()).sum()
    }

    /// ABI id of the first handler of required interface `index`.
    pub fn first_handler(&self, index: usize) -> usize {
        self.required.iter().take(index).map(|p| p.handlers.len()).sum()
    }
}

impl CommandKind {
    /// Tells whether the command is answered from the published row; the others run inside the server.
    pub fn is_read(self) -> bool {
        matches!(self, CommandKind::Read | CommandKind::QualifiedRead)
    }

    pub fn name(self) -> &'static str {
        match self {
            CommandKind::Void => "void",
            CommandKind::Write => "write",
            CommandKind::Read => "read",
            CommandKind::QualifiedRead => "qualified read",
            CommandKind::VoidReturn => "void-return",
            CommandKind::WriteReturn => "write-return",
        }
    }
}

/// Binds `client_port` to `server_port`.
///
/// # Errors
/// In this order: INTERFACE_NOT_FOUND, WRONG_DIRECTION, COMMAND_MISSING, COMMAND_KIND_MISMATCH,
/// TYPE_MISMATCH, FORMAT_MISMATCH.
pub fn bindings(
    client: &Ports,
    client_port: &PortId,
    server: &Ports,
    server_port: &PortId,
    options: &ConnectOptions,
) -> Result<Link, Refusal> {
    let ends = Ends { client: client_port, server: server_port };
    match directions(client, client_port, server, server_port)? {
        (Port::Input(input, a), Port::Output(output, b)) => {
            let adapt = ends.stream(&a.ty, &b.ty, options.adapt)?;
            Ok(Link::Stream { input, output, adapt })
        }
        (Port::Required(required, a), Port::Provided(provided, b)) => {
            let mut binding = Binding::default();
            for (i, function) in a.functions.iter().enumerate() {
                if let Some(command) = ends.function(function, b)? {
                    binding.functions.push((
                        client.first_function(required) + i,
                        server.first_command(provided) + command,
                    ));
                }
            }
            for (i, handler) in a.handlers.iter().enumerate() {
                if let Some(event) = ends.handler(handler, b)? {
                    binding
                        .handlers
                        .push((client.first_handler(required) + i, server.first_event(provided) + event));
                }
            }
            Ok(Link::Interface { required, provided, binding })
        }
        (a, b) => Err(ends.wrong_direction(&a, &b)),
    }
}

/// Finds both ports and checks that the client is an input or required interface and the server its
/// counterpart.
pub(crate) fn directions<'a>(
    client: &'a Ports,
    client_port: &PortId,
    server: &'a Ports,
    server_port: &PortId,
) -> Result<(Port<'a>, Port<'a>), Refusal> {
    let find = |ports: &'a Ports, id: &PortId| {
        ports.find(id.port.as_str()).ok_or_else(|| Refusal::InterfaceNotFound {
            port: id.clone(),
            known: ports.names().map(str::to_owned).collect(),
        })
    };
    let (a, b) = (find(client, client_port)?, find(server, server_port)?);
    match (a, b) {
        (Port::Input(..), Port::Output(..)) | (Port::Required(..), Port::Provided(..)) => Ok((a, b)),
        _ => Err(Ends { client: client_port, server: server_port }.wrong_direction(&a, &b)),
    }
}

/// Both names, for refusals.
struct Ends<'a> {
    client: &'a PortId,
    server: &'a PortId,
}

impl Ends<'_> {
    fn wrong_direction(&self, client: &Port<'_>, server: &Port<'_>) -> Refusal {
        Refusal::WrongDirection {
            client: self.client.clone(),
            client_is: client.kind(),
            server: self.server.clone(),
            server_is: server.kind(),
        }
    }

    fn type_mismatch(&self, what: String, difference: String) -> Refusal {
        Refusal::TypeMismatch { client: self.client.clone(), server: self.server.clone(), what, difference }
    }

    /// Returns whether samples must be copied by name.
    fn stream(&self, client: &PortType, server: &PortType, adapt: bool) -> Result<bool, Refusal> {
        match (client, server) {
            (PortType::Any, _) | (_, PortType::Any) => Ok(false),
            (PortType::Plain(a), PortType::Plain(b)) => {
                if a.accepts(b) {
                    Ok(false)
                } else if adapt && a.can_adapt(b) {
                    Ok(true)
                } else {
                    let hint = match a.can_adapt(b) {
                        true => ADAPTABLE.to_owned(),
                        false if a.is_scattered(b) => scattered(),
                        false => String::new(),
                    };
                    self.same("samples".to_owned(), a, b, &hint).map(|()| false)
                }
            }
            (
                PortType::Frame { header: a, format, max_bytes },
                PortType::Frame { header: b, format: has, max_bytes: most },
            ) => {
                self.same("frame header".to_owned(), a, b, "")?;
                if format != has {
                    return Err(self.format(format!("frames of {format:?}"), format!("frames of {has:?}")));
                }
                // 0 = reserved at Configure, so nothing is known yet.
                if *max_bytes > 0 && most > max_bytes {
                    return Err(
                        self.format(format!("at most {max_bytes} bytes"), format!("up to {most} bytes"))
                    );
                }
                Ok(false)
            }
            (PortType::Plain(a), PortType::Frame { format, .. }) => {
                Err(self.format(format!("samples of {}", a.title()), format!("frames of {format:?}")))
            }
            (PortType::Frame { format, .. }, PortType::Plain(b)) => {
                Err(self.format(format!("frames of {format:?}"), format!("samples of {}", b.title())))
            }
        }
    }

    fn format(&self, wants: String, has: String) -> Refusal {
        Refusal::FormatMismatch { client: self.client.clone(), server: self.server.clone(), wants, has }
    }

    fn same(&self, what: String, client: &Type, server: &Type, hint: &str) -> Result<(), Refusal> {
        match client.first_difference(server) {
            None => Ok(()),
            Some(difference) => {
                // Names the two structs first, then the difference.
                let named = match (client, server) {
                    (Type::Struct(a), Type::Struct(b)) if a.name != b.name => {
                        format!("it is {} here and {} there: ", a.name, b.name)
                    }
                    (Type::Struct(a), Type::Struct(_)) => format!("both are {}, but ", a.name),
                    _ => String::new(),
                };
                Err(self.type_mismatch(what, format!("{named}{difference}{hint}")))
            }
        }
    }

    fn optional(
        &self,
        what: String,
        client: Option<&Type>,
        server: Option<&Type>,
        missing: impl Fn(&str, &str) -> Refusal,
    ) -> Result<(), Refusal> {
        match (client, server) {
            (None, None) => Ok(()),
            (Some(a), Some(b)) => self.same(what, a, b, ""),
            (Some(a), None) => Err(missing(&a.title(), "none")),
            (None, Some(b)) => Err(missing("none", &b.title())),
        }
    }

    /// Position of the command in `server`, or nothing for an optional function that is not offered.
    fn function(&self, function: &Function, server: &Provided) -> Result<Option<usize>, Refusal> {
        let Some(index) = server.commands.iter().position(|c| c.name == function.name) else {
            return self.absent(&function.name, function.optional, server.commands.iter().map(|c| &c.name));
        };
        let command = &server.commands[index];
        if function.any {
            return Ok(Some(index));
        }
        let kind_mismatch = || Refusal::CommandKindMismatch {
            client: self.client.clone(),
            server: self.server.clone(),
            function: function.name.clone(),
            wants: wanted(function),
            has: offered(command),
        };
        let arg = command.arg.as_ref().map(|a| &a.ty);
        if !kinds(function).contains(&command.kind) || function.arg.is_some() != arg.is_some() {
            return Err(kind_mismatch());
        }
        let name = &function.name;
        self.optional(format!("argument of `{name}`"), function.arg.as_ref(), arg, |_, _| kind_mismatch())?;
        self.optional(format!("result of `{name}`"), function.ret.as_ref(), command.ret.as_ref(), |_, _| {
            kind_mismatch()
        })?;
        match &command.arg {
            Some(arg) if !function.unit.is_empty() && !Unit::same(&function.unit, &arg.unit) => {
                let has =
                    if arg.unit.is_empty() { "no unit".to_owned() } else { format!("unit {}", arg.unit) };
                let difference = format!("it has unit {} here and {has} there", function.unit);
                Err(self.type_mismatch(format!("argument of `{name}`"), difference))
            }
            _ => Ok(Some(index)),
        }
    }

    fn handler(&self, handler: &Handler, server: &Provided) -> Result<Option<usize>, Refusal> {
        let Some(index) = server.events.iter().position(|e| e.name == handler.name) else {
            return self.absent(&handler.name, handler.optional, server.events.iter().map(|e| &e.name));
        };
        let what = format!("payload of event `{}`", handler.name);
        let payload = server.events[index].payload.as_ref();
        self.optional(what.clone(), handler.payload.as_ref(), payload, |here, there| {
            self.type_mismatch(what.clone(), format!("it is {here} here and {there} there"))
        })?;
        Ok(Some(index))
    }

    fn absent<'n>(
        &self,
        name: &str,
        optional: bool,
        known: impl Iterator<Item = &'n String>,
    ) -> Result<Option<usize>, Refusal> {
        if optional {
            return Ok(None);
        }
        Err(Refusal::CommandMissing {
            client: self.client.clone(),
            server: self.server.clone(),
            function: name.to_owned(),
            known: known.cloned().collect(),
        })
    }
}

/// Checks that an input takes the type an untyped output has got.
pub(crate) fn same_payload(
    client: &PortId,
    server: &PortId,
    wanted: &PortType,
    has: &PortType,
) -> Result<(), Refusal> {
    Ends { client, server }.stream(wanted, has, false).map(|_| ())
}

/// The kinds of command a function can call: without a result only those whose caller need not wait.
fn kinds(function: &Function) -> &'static [CommandKind] {
    match (&function.arg, &function.ret) {
        (None, None) => &[CommandKind::Void],
        (Some(_), None) => &[CommandKind::Write],
        (None, Some(_)) => &[CommandKind::Read, CommandKind::VoidReturn],
        (Some(_), Some(_)) => &[CommandKind::QualifiedRead, CommandKind::WriteReturn],
    }
}

fn wanted(function: &Function) -> String {
    let names: Vec<&str> = kinds(function).iter().map(|k| k.name()).collect();
    signature(&names.join(" or "), function.arg.as_ref(), function.ret.as_ref())
}

fn offered(command: &Command) -> String {
    signature(command.kind.name(), command.arg.as_ref().map(|a| &a.ty), command.ret.as_ref())
}

/// "write (f64)", "read → Pose".
fn signature(kind: &str, arg: Option<&Type>, ret: Option<&Type>) -> String {
    let arg = arg.map(|t| format!(" ({})", t.title())).unwrap_or_default();
    let ret = ret.map(|t| format!(" → {}", t.title())).unwrap_or_default();
    format!("{kind}{arg}{ret}")
}
