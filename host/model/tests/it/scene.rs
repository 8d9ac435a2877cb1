//! A small operating theatre: classes and graphs for the tests.
//!
//! Invariant: every class here fits the others as its name says, so that a test only states what it changes.

use std::sync::Arc;

use serde_json::json;
use trocar_model::*;

pub(crate) fn name(text: &str) -> Name {
    Name::parse(text).unwrap()
}

pub(crate) fn id(text: &str) -> ComponentId {
    ComponentId::parse(text).unwrap()
}

pub(crate) fn port(text: &str) -> PortId {
    PortId::parse(text).unwrap()
}

pub(crate) fn target(text: &str) -> Target {
    Target::parse(text).unwrap()
}

pub(crate) fn f64_type() -> Type {
    Type::Prim(Prim::F64)
}

pub(crate) fn field(name: &str, at: usize, ty: Type, unit: &str) -> Field {
    Field { name: name.into(), at, ty, unit: unit.into(), doc: String::new(), frame: String::new() }
}

pub(crate) fn structure(name: &str, size: usize, fields: Vec<Field>) -> Type {
    Type::Struct(Arc::new(StructType { name: name.into(), doc: String::new(), size, align: 8, fields }))
}

/// A stamp and three components in `unit`.
pub(crate) fn force(unit: &str) -> Type {
    let f = Type::Array { item: Box::new(f64_type()), n: 3 };
    structure("Force", 32, vec![field("stamp", 0, Type::Prim(Prim::Stamp), "ns"), field("f", 8, f, unit)])
}

/// The same with the fields the other way round.
pub(crate) fn moved_force(unit: &str) -> Type {
    let f = Type::Array { item: Box::new(f64_type()), n: 3 };
    structure("Force", 32, vec![field("f", 0, f, unit), field("stamp", 24, Type::Prim(Prim::Stamp), "ns")])
}

pub(crate) fn frame(format: &str, max_bytes: usize) -> PortType {
    let header = structure("ImageHeader", 8, vec![field("width", 0, Type::Prim(Prim::U64), "px")]);
    PortType::Frame { header, format: format.into(), max_bytes }
}

pub(crate) fn input(name: &str, ty: PortType) -> Input {
    Input { name: name.into(), doc: String::new(), ty, tag: Tag::None, optional: false, fifo: 0 }
}

pub(crate) fn output(name: &str, ty: PortType) -> Output {
    Output { name: name.into(), doc: String::new(), ty, tag: Tag::None }
}

pub(crate) fn command(
    name: &str,
    kind: CommandKind,
    arg: Option<(Type, &str)>,
    ret: Option<Type>,
) -> Command {
    let arg = arg.map(|(ty, unit)| Arg {
        name: "value".into(),
        doc: String::new(),
        ty,
        unit: unit.into(),
        min: None,
        max: None,
    });
    Command {
        name: name.into(),
        doc: String::new(),
        kind,
        arg,
        ret,
        ret_unit: String::new(),
        overflow: Overflow::Reject,
    }
}

pub(crate) fn function(name: &str, arg: Option<Type>, ret: Option<Type>) -> Function {
    Function {
        name: name.into(),
        doc: String::new(),
        arg,
        ret,
        unit: String::new(),
        optional: false,
        any: false,
    }
}

pub(crate) fn required(name: &str, functions: Vec<Function>, handlers: Vec<Handler>) -> Required {
    Required { name: name.into(), doc: String::new(), optional: false, functions, handlers }
}

pub(crate) fn handler(name: &str, payload: Option<Type>) -> Handler {
    Handler { name: name.into(), doc: String::new(), payload, optional: false, direct: false }
}

pub(crate) fn provided(name: &str, commands: Vec<Command>, events: Vec<Event>) -> Provided {
    Provided { name: name.into(), doc: String::new(), tag: Tag::None, commands, events }
}

pub(crate) fn event(name: &str, payload: Option<Type>) -> Event {
    Event { name: name.into(), doc: String::new(), payload, unit: String::new() }
}

pub(crate) fn class(plugin: &str, name: &str, model: ExecutionModel, ports: Ports) -> ClassInfo {
    ClassInfo {
        plugin: plugin.into(),
        version: "1.0.0".into(),
        hash: String::new(),
        name: name.into(),
        doc: String::new(),
        safety: Safety::None,
        hardware: false,
        safe_from_any_thread: false,
        programs: Programs::None,
        execution: Execution {
            model: Some(model),
            period_ns: (model == ExecutionModel::Periodic).then_some(1_000_000),
            ..Execution::default()
        },
        limits: ExecutionLimits::default(),
        config_schema: json!({"type": "object", "additionalProperties": false, "properties": {}}),
        ports,
    }
}

/// Provided `arm`: hold (void), servo_jp (write, m), measured (read), solve (write-return); event `moved`.
fn arm(name: &str) -> Provided {
    provided(
        name,
        vec![
            command("hold", CommandKind::Void, None, None),
            command("servo_jp", CommandKind::Write, Some((f64_type(), "m")), None),
            command("measured", CommandKind::Read, None, Some(force("N"))),
            command("solve", CommandKind::WriteReturn, Some((f64_type(), "m")), Some(f64_type())),
        ],
        vec![event("moved", Some(f64_type()))],
    )
}

/// Periodic, 1 kHz; one needed setting `limit` has a default.
pub(crate) fn robot() -> ClassInfo {
    let ports = Ports {
        provided: vec![
            provided(
                "base",
                vec![command("park", CommandKind::Void, None, None)],
                vec![event("parked", None)],
            ),
            arm("arm"),
        ],
        outputs: vec![output("force", PortType::Plain(force("N")))],
        ..Ports::default()
    };
    let mut class = class("eyerobot", "eyerobot", ExecutionModel::Periodic, ports);
    class.config_schema = json!({"type": "object", "additionalProperties": false, "properties": {
        "limit": {"type": "number", "unit": "N", "minimum": 0, "maximum": 10, "default": 2, "live": true},
        "joints": {"type": "integer", "minimum": 1, "maximum": 7, "default": 5},
    }});
    class
}

/// Needs a provider of `arm`.
pub(crate) fn controller() -> ClassInfo {
    let functions = vec![function("hold", None, None), function("measured", None, Some(force("N")))];
    let ports = Ports {
        required: vec![required("robot", functions, vec![handler("moved", Some(f64_type()))])],
        ..Ports::default()
    };
    class("control", "controller", ExecutionModel::Periodic, ports)
}

/// `optional` input of force samples in N.
pub(crate) fn logger() -> ClassInfo {
    let mut any = input("force", PortType::Plain(force("N")));
    any.optional = true;
    let ports = Ports { inputs: vec![any], ..Ports::default() };
    class("log", "logger", ExecutionModel::OnSignal, ports)
}

/// Stream head without inputs that must be connected.
pub(crate) fn source() -> ClassInfo {
    let mut feedback = input("feedback", frame("image", 0));
    feedback.optional = true;
    let ports = Ports {
        inputs: vec![feedback],
        outputs: vec![output("image", frame("image", 0))],
        ..Ports::default()
    };
    class("stereo", "image_source", ExecutionModel::Stream, ports)
}

/// Image in, image out.
pub(crate) fn filter() -> ClassInfo {
    let ports = Ports {
        inputs: vec![input("raw", frame("image", 0))],
        outputs: vec![output("image", frame("image", 0))],
        ..Ports::default()
    };
    class("vision", "gray", ExecutionModel::Stream, ports)
}

/// Passive; its setting `port` must be given.
pub(crate) fn device() -> ClassInfo {
    let mut class = class("serial", "device", ExecutionModel::None, Ports::default());
    class.config_schema = json!({"type": "object", "additionalProperties": false, "required": ["port"], "properties": {
        "port": {"type": "string", "description": "Device file of the serial line"},
        "baud": {"type": "integer", "unit": "Bd", "minimum": 300, "maximum": 115200, "default": 9600},
    }});
    class
}

pub(crate) fn process(classes: Vec<ClassInfo>) -> Process {
    Process {
        epoch: 1,
        state: ProcessState::Attached,
        endpoint: String::new(),
        pid: 1,
        classes: classes.into_iter().map(Arc::new).collect(),
        last_exit: String::new(),
        restarts: 0,
        warnings: Warnings::default(),
        guest: String::new(),
    }
}

/// Process `host` with every class above and a second `gray`, process `gui` with logger only; no components.
pub(crate) fn empty() -> SystemGraph {
    let mut twin = filter();
    twin.plugin = "other".into();
    twin.name = "twin".into();
    let mut second = filter();
    second.plugin = "extra".into();
    let host = vec![robot(), controller(), logger(), source(), filter(), device(), twin, second];
    let processes = [(name("host"), process(host)), (name("gui"), process(vec![logger()]))];
    SystemGraph { processes: processes.into_iter().collect(), ..SystemGraph::default() }
}

pub(crate) fn create(path: &str, class: &str) -> Request {
    Request::Create { id: id(path), class: class.into(), config: None, execution: Execution::default() }
}

pub(crate) fn create_in(path: &str, class: &str, stream_of: &str) -> Request {
    let execution = Execution { stream_of: Some(stream_of.into()), ..Execution::default() };
    Request::Create { id: id(path), class: class.into(), config: None, execution }
}

pub(crate) fn connect(client: &str, server: &str) -> Request {
    Request::Connect { client: port(client), server: port(server), options: ConnectOptions::default() }
}

pub(crate) fn start(targets: &[&str]) -> Request {
    Request::Start { targets: targets.iter().map(|t| target(t)).collect() }
}

pub(crate) fn stop(targets: &[&str]) -> Request {
    Request::Stop { targets: targets.iter().map(|t| target(t)).collect() }
}

/// Does all of `requests`, one after the other.
pub(crate) fn done(graph: &mut SystemGraph, requests: &[Request]) {
    for request in requests {
        let plan = plan(graph, request).unwrap_or_else(|e| panic!("{request:?} was refused: {e}"));
        graph.apply(&plan);
    }
}

/// robot, controller ← robot/arm, log ← robot/force; all READY.
pub(crate) fn theatre() -> SystemGraph {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/robot", "eyerobot"),
            create("host/controller", "controller"),
            create("host/log", "logger"),
            connect("host/controller/robot", "host/robot/arm"),
            connect("host/log/force", "host/robot/force"),
        ],
    );
    graph
}

pub(crate) fn refused(graph: &SystemGraph, request: &Request) -> Refusal {
    match plan(graph, request) {
        Ok(plan) => panic!("{request:?} should be refused, but was planned as {plan:?}"),
        Err(refusal) => refusal,
    }
}

pub(crate) fn set_state(graph: &mut SystemGraph, path: &str, state: State) {
    graph.components.get_mut(&id(path)).unwrap().state = state;
}
