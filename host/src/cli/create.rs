//! `trocar create host/robot eyerobot`.
//!
//! Invariant: what is not typed is not sent, so the class's defaults apply.

use clap::{Args, ValueEnum};
use serde_json::Value;

use super::failure::{Done, Failure};
use super::mutation::{MutationArgs, show};
use super::session::Session;
use super::units;

/// Creates a component: `trocar create host/robot eyerobot`.
#[derive(Args, Debug)]
pub(super) struct CreateArgs {
    /// Where: process/component.
    pub(super) path: String,
    /// Of what class: plugin/class, or the class alone where it is unique (`trocar ls` lists them).
    pub(super) class: String,
    /// Configuration, a JSON object; what is left out takes the class's default.
    #[arg(long, value_name = "JSON", value_parser = json_object)]
    pub(super) config: Option<Value>,
    #[command(flatten)]
    pub(super) execution: ExecutionArgs,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

/// Where the component's thread comes from; left out: the class's default.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Execution")]
pub(super) struct ExecutionArgs {
    /// What makes it step.
    #[arg(long, value_enum)]
    pub(super) model: Option<Model>,
    /// Steps per second, Hz.
    #[arg(long, value_name = "HZ", value_parser = units::parse_rate)]
    pub(super) rate_hz: Option<f64>,
    /// Offset of its grid, e.g. 200us.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    pub(super) phase: Option<u64>,
    /// Runs in the stream of this component.
    #[arg(long, value_name = "PATH", conflicts_with = "inside")]
    pub(super) stream_of: Option<String>,
    /// Runs inside the step of this component.
    #[arg(long, value_name = "PATH")]
    pub(super) inside: Option<String>,
    /// SCHED_FIFO priority, 1–99.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=99))]
    pub(super) priority: Option<u8>,
    /// CPUs it may run on, e.g. 1,2.
    #[arg(long, value_delimiter = ',', value_name = "N")]
    pub(super) cpus: Vec<u32>,
}

/// Execution models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum Model {
    /// On a fixed grid.
    Periodic,
    /// Again and again.
    Continuous,
    /// When a command, event or input arrives.
    OnSignal,
    /// When a device's own thread calls in.
    OnCallback,
    /// Head of a stream chain.
    Stream,
    /// Passive: in its callers' threads.
    None,
}

impl Model {
    /// The spelling of the API and of the system file.
    pub(super) fn wire_name(self) -> &'static str {
        match self {
            Model::Periodic => "periodic",
            Model::Continuous => "continuous",
            Model::OnSignal => "on_signal",
            Model::OnCallback => "on_callback",
            Model::Stream => "stream",
            Model::None => "none",
        }
    }
}

pub(super) async fn run(args: CreateArgs, session: &Session) -> Done {
    let outcome = session.create(&args).await?;
    let done = format!("created {}", args.path);
    show(session, &outcome, args.mutation.dry_run, &done)
}

/// clap's parser of a JSON object.
pub(super) fn json_object(text: &str) -> Result<Value, String> {
    match serde_json::from_str(text) {
        Ok(Value::Object(map)) => Ok(Value::Object(map)),
        Ok(other) => Err(format!("expected a JSON object like {{\"seed\": 7}}, found {other}")),
        Err(e) => Err(format!("not JSON ({e}); mind the shell: quote it as '{{\"seed\": 7}}'")),
    }
}

/// Reads a JSON argument that may be anything.
pub(super) fn json_value(text: &str) -> Result<Value, Failure> {
    serde_json::from_str(text).map_err(|e| {
        Failure::usage(
            format!("the argument {text:?} is not JSON: {e}"),
            "quote it for the shell: '{\"position\": [0, 0, 0.01, 0, 0]}', '30', '\"enable\"'",
        )
    })
}
