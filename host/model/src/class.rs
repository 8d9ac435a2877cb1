//! Offers of a component class, as the graph knows them: the manifest's content in the model's own types.
//!
//! Invariant: order is the manifest's order; ids of commands, functions, events and handlers are positions
//! over all interfaces of the class, as in the plugin ABI.

use serde_json::Value;

use crate::{Queue, Type};

/// One class of one plugin.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassInfo {
    pub plugin: String,
    pub version: String,
    /// sha256 of the plugin file, hex; empty for classes linked into the host.
    pub hash: String,
    pub name: String,
    pub doc: String,
    pub safety: Safety,
    /// Opens a device.
    pub hardware: bool,
    pub safe_from_any_thread: bool,
    /// Tells whether it starts programs, and may.
    pub programs: Programs,
    /// Defaults; every field is set.
    pub execution: Execution,
    /// The executions it is made for.
    pub limits: ExecutionLimits,
    /// JSON Schema of the configuration, with the extra keywords `unit` and `live`.
    pub config_schema: Value,
    pub ports: Ports,
}

impl ClassInfo {
    /// `plugin/class`, the spelling that is always unique.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.plugin, self.name)
    }
}

/// Relation of a class's components to programs of the machine, started as the process's user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Programs {
    /// They start none.
    #[default]
    None,
    /// They do, and the process lets them.
    Allowed,
    /// They would, and the process does not let them: none is created.
    Refused,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Safety {
    #[default]
    None,
    Sensor,
    Actuator,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExecutionModel {
    Periodic,
    Continuous,
    OnSignal,
    OnCallback,
    /// Runs inside another component's step, before it.
    ExecIn,
    /// Runs inside another component's step, after it.
    ExecOut,
    /// Head of a stream chain; with `rate_hz` it steps on a grid.
    Stream,
    /// Passive: runs in its callers' threads.
    None,
}

/// Source and settings of a component's thread. In a request unset fields take the class's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Execution {
    pub model: Option<ExecutionModel>,
    pub period_ns: Option<u64>,
    /// Offset of the grid, ns.
    pub phase_ns: Option<u64>,
    /// Runs in the stream of this component (`process/component`), after it.
    pub stream_of: Option<String>,
    /// Runs inside the step of this component (`exec_in`).
    pub inside: Option<String>,
    /// SCHED_FIFO priority 1–99; unset = normal scheduling.
    pub priority: Option<u8>,
    pub cpus: Vec<usize>,
    /// Late periods of a grid that are made up for without pause, at most; 0 or unset = skipped and counted.
    pub catch_up: Option<u32>,
    /// Threads that share the work of a stream, its own included; unset = 1.
    pub threads: Option<u32>,
    /// Longest stay inside its own code before a component without a period counts as unresponsive, ns;
    /// unset = 50 ms.
    pub max_step_ns: Option<u64>,
    /// Rows its state table keeps, 3 to 65 536; unset = 256.
    pub history: Option<u32>,
    /// Behaviour of a stream's filter when its step fails.
    pub on_failure: Option<OnFailure>,
    /// Way its thread learns of new work; unset = by the length of its period, see [`Execution::polls`].
    pub wake: Option<Wake>,
}

/// The executions a class is made for. A controller that has to step on a grid within a range of rates says
/// so here, and a component of it is never made to run otherwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExecutionLimits {
    /// Empty = any.
    pub models: Vec<ExecutionModel>,
    /// Shortest and longest time between two steps, ns.
    pub min_period_ns: Option<u64>,
    pub max_period_ns: Option<u64>,
}

/// Way a thread learns that a sample, command or event has come for one of its components.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wake {
    /// The thread is woken, if it sleeps: the sender pays for that, and the work does not wait for the next
    /// period.
    Signal,
    /// The thread looks at each period: the sender pays nothing but the push.
    Poll,
}

/// Grids up to this period are looked at often enough by themselves, ns.
const OFTEN_NS: u64 = 10_000_000;

impl Wake {
    pub const ALL: [Wake; 2] = [Wake::Signal, Wake::Poll];

    pub fn name(self) -> &'static str {
        match self {
            Wake::Signal => "signal",
            Wake::Poll => "poll",
        }
    }
}

impl Execution {
    /// Tells whether a thread with these settings looks for new work by itself, at each period: as it was
    /// asked to, or because its period is 10 ms at most.
    pub fn polls(&self) -> bool {
        let grid = matches!(self.model, Some(ExecutionModel::Periodic | ExecutionModel::Stream));
        let period_ns = self.period_ns.filter(|_| grid);
        period_ns.is_some_and(|ns| self.wake.map_or(ns <= OFTEN_NS, |wake| wake == Wake::Poll))
    }
}

/// Fate of the frames of a stream behind a filter whose step failed. The filter is in FAULT either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnFailure {
    /// The branch behind it gets nothing more.
    #[default]
    StopBranch,
    /// Frames pass it unchanged, from its first input to its first output of the same type.
    Bypass,
}

impl ExecutionModel {
    pub const ALL: [ExecutionModel; 8] = [
        ExecutionModel::Periodic,
        ExecutionModel::Continuous,
        ExecutionModel::OnSignal,
        ExecutionModel::OnCallback,
        ExecutionModel::ExecIn,
        ExecutionModel::ExecOut,
        ExecutionModel::Stream,
        ExecutionModel::None,
    ];

    pub fn name(self) -> &'static str {
        match self {
            ExecutionModel::Periodic => "periodic",
            ExecutionModel::Continuous => "continuous",
            ExecutionModel::OnSignal => "on_signal",
            ExecutionModel::OnCallback => "on_callback",
            ExecutionModel::ExecIn => "exec_in",
            ExecutionModel::ExecOut => "exec_out",
            ExecutionModel::Stream => "stream",
            ExecutionModel::None => "none",
        }
    }
}

impl OnFailure {
    pub const ALL: [OnFailure; 2] = [OnFailure::StopBranch, OnFailure::Bypass];

    pub fn name(self) -> &'static str {
        match self {
            OnFailure::StopBranch => "stop_branch",
            OnFailure::Bypass => "bypass",
        }
    }
}

/// Everything that can be connected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ports {
    pub inputs: Vec<Input>,
    pub outputs: Vec<Output>,
    pub required: Vec<Required>,
    pub provided: Vec<Provided>,
    /// Type of one row of the state table.
    pub state: Option<Type>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum PortType {
    Plain(Type),
    Frame {
        header: Type,
        format: String,
        /// 0 = reserved at Configure.
        max_bytes: usize,
    },
    Any,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    pub name: String,
    pub doc: String,
    pub ty: PortType,
    pub tag: Tag,
    pub optional: bool,
    /// Default queue depth in samples; 0 = latest value.
    pub fifo: usize,
}

impl Input {
    /// Returns the queue of its samples where the connection does not say.
    pub fn default_queue(&self) -> Queue {
        if self.fifo > 0 { Queue::Fifo { depth: self.fifo, drop_oldest: true } } else { Queue::Latest }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    pub name: String,
    pub doc: String,
    pub ty: PortType,
    pub tag: Tag,
}

/// Outputs every component has without any code: its state rows, its events, its commands. No class may use
/// one of the names.
pub const TAPS: [&str; 3] = ["tap_rows", "tap_events", "tap_commands"];

impl Output {
    /// Tells whether the host fills this output, without the component's code: see [`TAPS`].
    pub fn is_tap(&self) -> bool {
        TAPS.contains(&self.name.as_str())
    }
}

/// Relation of a port to a simulation; decides which ports may be connected to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tag {
    #[default]
    None,
    /// Tells the true state of a simulated world: for recorders, plots and tests, never for the motion of an
    /// actuator.
    Truth,
    /// Joins simulated devices to each other, as the world joins real ones.
    Sim,
}

impl Tag {
    pub const ALL: [Tag; 3] = [Tag::None, Tag::Truth, Tag::Sim];

    /// As it is written; "" = no tag.
    pub fn name(self) -> &'static str {
        match self {
            Tag::None => "",
            Tag::Truth => "truth",
            Tag::Sim => "sim",
        }
    }

    /// The tag of that name.
    pub fn parse(text: &str) -> Option<Tag> {
        Tag::ALL.into_iter().find(|tag| tag.name() == text)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Provided {
    pub name: String,
    pub doc: String,
    pub tag: Tag,
    pub commands: Vec<Command>,
    pub events: Vec<Event>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandKind {
    Void,
    Write,
    Read,
    QualifiedRead,
    VoidReturn,
    WriteReturn,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overflow {
    #[default]
    Reject,
    LatestWins,
    DropOldest,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    pub name: String,
    pub doc: String,
    pub kind: CommandKind,
    pub arg: Option<Arg>,
    pub ret: Option<Type>,
    pub ret_unit: String,
    pub overflow: Overflow,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Arg {
    pub name: String,
    pub doc: String,
    pub ty: Type,
    pub unit: String,
    pub min: Option<f64>,
    pub max: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    pub name: String,
    pub doc: String,
    pub payload: Option<Type>,
    pub unit: String,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Required {
    pub name: String,
    pub doc: String,
    pub optional: bool,
    pub functions: Vec<Function>,
    pub handlers: Vec<Handler>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Function {
    pub name: String,
    pub doc: String,
    pub arg: Option<Type>,
    pub ret: Option<Type>,
    /// Unit the argument must have; "" = not checked.
    pub unit: String,
    pub optional: bool,
    pub any: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Handler {
    pub name: String,
    pub doc: String,
    pub payload: Option<Type>,
    pub optional: bool,
    /// Runs inside `emit` when both ends share an executor; otherwise, and by default, it is queued.
    pub direct: bool,
}
