//! Decides, never does: names, types, the system graph, plans and refusals.
//!
//! Invariant: pure functions of their arguments. No I/O, clock, thread, randomness, unsafe or async;
//! sorted maps so that the same input gives the same output, in simulation as in production.
#![forbid(unsafe_code)]
// Refusals are rare and carry their values by design; boxing them would burden every match on them.
#![allow(clippy::result_large_err)]

mod change;
mod class;
mod config;
mod connect;
mod connection;
mod copies;
mod frame;
mod graph;
mod loose;
mod name;
mod nearest;
mod phases;
pub mod plain;
mod plan;
mod proxy;
mod refusal;
mod request;
mod state;
mod table;
mod types;
mod unit;
mod value;
mod violation;
mod wanted;

pub use change::{Change, Plan, Skipped, inverse};
pub use class::{
    Arg, ClassInfo, Command, CommandKind, Event, Execution, ExecutionLimits, ExecutionModel, Function,
    Handler, Input, OnFailure, Output, Overflow, PortType, Ports, Programs, Provided, Required, Safety, TAPS,
    Tag, Wake,
};
pub use config::{
    complete, defaults, difference, idle_limit, is_same, live_only, live_settings, merge, schema_fault,
    unknown_nulls, validate, without_defaults,
};
pub use connect::{Binding, Link, Port, bindings, idle_connection};
pub use connection::{ConnectOptions, Connection, ConnectionId, End, Queue};
pub use copies::{CopyRun, MAX_COPIES};
pub use graph::{Component, Process, ProcessState, SystemGraph, Touched, Warnings};
pub use name::{ComponentId, MemberId, Name, Pattern, PortId, Target};
pub use nearest::nearest;
pub use phases::{Phase, StepTimes, phases, steps_matter};
pub use plan::{
    Here, Planning, class_fault, default_max_age, host_of, least_execution, made_of, open_ends, period_fault,
    plan, plan_all, restore,
};
pub use proxy::Proxy;
pub use refusal::{Code, Refusal, brief, errors_markdown};
pub use request::{Request, Which};
pub use state::{Health, State, StopReason, Verb, allowed, transition};
pub use table::Table;
pub use types::{EnumType, Field, Prim, StructType, Type};
pub use unit::{Unit, UnitError};
pub use value::{ValueError, check_range, decode, encode, from_float, interpolate};
pub use violation::Violation;
pub use wanted::{Entry, Grant, Incarnation, Wanted, WantedComponent};
