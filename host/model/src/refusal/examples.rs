//! One example per refusal, and the page made of them.
//!
//! Invariant: every variant has an example (a test counts them), so that no refusal goes undocumented.

use std::fmt::Write as _;

use crate::{
    Arg, ComponentId, MemberId, Name, PortId, Prim, ProcessState, Refusal, State, StopReason, Tag, Type,
    Verb, Violation, check_range,
};

/// Names for examples; every literal below keeps to the grammar, which the tests check.
fn name(text: &str) -> Name {
    Name::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

fn id(text: &str) -> ComponentId {
    ComponentId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

fn port(text: &str) -> PortId {
    PortId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

fn member(text: &str) -> MemberId {
    MemberId::parse(text).unwrap_or_else(|e| panic!("{e}"))
}

fn texts(list: &[&str]) -> Vec<String> {
    list.iter().map(|&s| s.to_owned()).collect()
}

impl Refusal {
    /// One of each, in the order in which the checks are made.
    pub fn examples() -> Vec<Refusal> {
        let mut all = naming();
        all.extend(connecting());
        all.extend(changing());
        all.extend(calling());
        all
    }
}

fn naming() -> Vec<Refusal> {
    vec![
        Refusal::BadPath {
            text: "/host/robot".into(),
            why: "it begins with a slash; wanted process/component".into(),
        },
        Refusal::ProcessNotFound { process: name("hots"), known: vec![name("gui"), name("host")] },
        Refusal::ProcessLost {
            process: name("host"),
            state: ProcessState::Restarting,
            last_exit: "was killed by SIGSEGV (core dumped)".into(),
        },
        Refusal::NotSupervised { process: name("host"), known: vec![name("gui")] },
        Refusal::ProcessNotUp { process: name("host.robot"), why: "it was killed by SIGKILL".into() },
        Refusal::ProcessRuns { process: name("host"), state: ProcessState::Attached, pid: 4242 },
        Refusal::ProcessExists { process: name("host"), endpoint: "127.0.0.1:50551".into(), pid: 4242 },
        Refusal::ClassNotFound {
            process: name("host"),
            class: "eyerobt".into(),
            known: texts(&["eyerobot", "sine"]),
            elsewhere: vec![name("gui")],
            ambiguous: vec![],
        },
        Refusal::ComponentExists { id: id("host/robot") },
        Refusal::ComponentNotFound { id: id("host/robt"), known: vec![id("host/ascan"), id("host/robot")] },
        Refusal::NothingMatches { pattern: "gui/**".into(), known: vec![id("host/robot")] },
        Refusal::InterfaceNotFound { port: port("host/robot/amr"), known: texts(&["arm", "tip"]) },
        Refusal::MemberNotFound {
            member: member("host/robot/arm/servo_jo"),
            known: texts(&["hold", "measured_cp", "servo_jp"]),
        },
        Refusal::WrongKind {
            member: member("host/robot/arm/measured_cp"),
            is: "a read command".into(),
            wanted: "an event".into(),
        },
        Refusal::ManagedElsewhere { at: "127.0.0.1:50551".into() },
        Refusal::PluginNotFound { name: "eyerobt".into(), known: texts(&["eyerobot", "filters"]) },
        Refusal::ConnectionNotFound {
            asked: "7".into(),
            known: texts(&["3: host/robot/arm → host/bscan/robot"]),
        },
    ]
}

fn connecting() -> Vec<Refusal> {
    let (client, server) = (port("host/bscan/robot"), port("host/robot/arm"));
    let (input, output) = (port("host/log/force"), port("host/sensor/force"));
    vec![
        Refusal::WrongDirection {
            client: server.clone(),
            client_is: "a provided interface",
            server: client.clone(),
            server_is: "a required interface",
        },
        Refusal::AlreadyConnected { client: client.clone(), server: port("host/phantom/arm") },
        Refusal::ConnectionExists { id: 3, client: client.clone(), server: server.clone() },
        Refusal::CommandMissing {
            client: client.clone(),
            server: server.clone(),
            function: "servo_jq".into(),
            known: texts(&["hold", "measured_cp", "servo_jp"]),
        },
        Refusal::CommandKindMismatch {
            client: client.clone(),
            server: server.clone(),
            function: "hold".into(),
            wants: "write (f64)".into(),
            has: "void".into(),
        },
        Refusal::TypeMismatch {
            client: input.clone(),
            server: output.clone(),
            what: "samples".into(),
            difference: "field `f[…]` has unit N here and unit mN there".into(),
        },
        Refusal::FormatMismatch {
            client: input.clone(),
            server: output.clone(),
            wants: "frames of \"image\"".into(),
            has: "frames of \"spectra\"".into(),
        },
        Refusal::TagMismatch { client: input.clone(), server: output.clone(), has: Tag::None },
        Refusal::TruthToActuator {
            client: input,
            server: output,
            tag: Tag::Truth,
            path: vec![id("host/bscan"), id("host/robot")],
        },
        Refusal::SyncCycle { path: vec![id("host/gray"), id("host/resize"), id("host/gray")] },
    ]
}

fn changing() -> Vec<Refusal> {
    let robot = id("host/robot");
    let below = "cutoff_hz: 1000 Hz is above 400 Hz";
    vec![
        Refusal::WrongState {
            id: robot.clone(),
            state: State::Fault,
            verb: Verb::Start,
            allowed: crate::allowed(State::Fault),
            why: String::new(),
        },
        Refusal::Unconnected { id: id("host/bscan"), verb: Verb::Start, ports: texts(&["robot", "ascan"]) },
        Refusal::ConfigInvalid {
            id: id("host/filter"),
            violations: vec![Violation { pointer: "/cutoff_hz".into(), message: below.into() }],
        },
        Refusal::ComponentRefused {
            id: robot.clone(),
            entry: "configure",
            text: "port /dev/ttyUSB1 is busy".into(),
        },
        Refusal::ComponentFault { id: robot.clone(), text: "panic in step: index out of bounds".into() },
        Refusal::NoMemory {
            id: id("host/camera"),
            outputs: texts(&["left", "right"]),
            bytes: 17_179_869_184,
            why: "8392286208 bytes of memory are available, an eighth of which must stay free".into(),
        },
        Refusal::Unreachable {
            client: port("gui/viewer/image"),
            server: port("host/camera/frames"),
            why: "nobody answers at /run/trocar/host/links.sock".into(),
        },
        Refusal::NoThread { id: id("host/camera"), why: "Resource temporarily unavailable".into() },
        Refusal::InUse { id: robot, by: texts(&["connection 3 (host/robot/arm → host/bscan/robot)"]) },
        Refusal::PluginAbi {
            file: "libtrocar_old.so".into(),
            text: "it speaks ABI 2, this host speaks ABI 1".into(),
        },
        Refusal::PluginUntrusted {
            file: "libtrocar_sine.so".into(),
            text: "its hash is not on the allow-list".into(),
        },
        Refusal::PluginBadFile {
            file: "libtrocar_sine.so".into(),
            text: "it ends at byte 4096, but its header claims 548352 bytes".into(),
        },
        Refusal::RevisionConflict { expected: 41, actual: 42 },
        Refusal::NotReached {
            id: id("host/robot"),
            state: State::Ready,
            wanted: vec![State::Active],
            after_ns: 2_000_000_000,
        },
        Refusal::EventNotSeen {
            member: member("host/robot/arm/operating_state"),
            state: State::Active,
            after_ns: 2_000_000_000,
        },
        Refusal::NoSample { port: port("host/sensor/force"), state: State::Ready, after_ns: 2_000_000_000 },
        Refusal::LcmTimeout { process: name("host"), what: "Start host/robot".into() },
        Refusal::Busy { doing: "Start host/robot".into() },
    ]
}

fn calling() -> Vec<Refusal> {
    let call = member("host/robot/arm/servo_jp");
    let write = member("ProcessServer/Server/Provided/Write");
    let arg = Arg {
        name: "value".into(),
        doc: "set point".into(),
        ty: Type::Prim(Prim::I32),
        unit: "mm".into(),
        min: Some(0.0),
        max: Some(100.0),
    };
    let why = check_range(&arg, &300.into()).err().unwrap_or_default();
    vec![
        Refusal::ArgumentInvalid { what: write.to_string(), why, field: "json".into() },
        Refusal::Unbound { member: call.clone() },
        Refusal::Disabled { member: call.clone() },
        Refusal::NotActive { member: call.clone(), state: State::Stopped(StopReason::Restarted) },
        Refusal::WouldBlock { member: call.clone() },
        Refusal::CommandFailed {
            member: call.clone(),
            text: "joint 3 would leave its limit of 0.02 m".into(),
        },
        Refusal::Deadline { member: call.clone(), after_ns: 1_500_000_000, may_still_run: true },
        Refusal::PeerLost { member: call.clone() },
        Refusal::Replaced { member: call.clone() },
        Refusal::QueueFull { member: call, depth: 16 },
        Refusal::NotImplemented {
            what: "a connection between two processes".into(),
            hint: "Create both components in one process.".into(),
        },
        Refusal::ProgramsNotAllowed { process: name("host"), class: "stereo/pipe_source".into() },
        Refusal::Forbidden {
            what: "Remove".into(),
            caller: "user 65534 at 127.0.0.1:40404".into(),
            user: 1000,
        },
        Refusal::ReadOnly { what: "Remove".into() },
        Refusal::Internal { text: "the plan left a connection without a client".into() },
    ]
}

/// `docs/errors.md`.
pub fn errors_markdown() -> String {
    let mut out = String::from(
        "# Errors\n\n\
         Generated from the refusals of `trocar-model`; a test compares (`TROCAR_BLESS=1 cargo test -p trocar-model` \
         writes it anew).\n\n\
         Every refusal reaches the caller as a gRPC status with the code below. Its sentence says what was asked, what \
         is wrong and what exists. Its details are an `ErrorInfo` (reason, domain `trocar.v1`, the values as metadata) \
         and, where a field is to blame, a `BadRequest`.\n\n\
         | reason | code | metadata |\n|---|---|---|\n",
    );
    let all = Refusal::examples();
    for r in &all {
        let keys: Vec<String> = r.metadata().into_keys().map(|k| format!("`{k}`")).collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "| [{0}](#{1}) | {2} | {3} |",
            r.reason(),
            r.reason().to_lowercase(),
            r.code().name(),
            keys.join(" ")
        );
    }
    for r in &all {
        let _ = write!(out, "\n## {}\n\n> {r}\n\n{}\n", r.reason(), r.help());
    }
    out
}
