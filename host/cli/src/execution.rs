//! Flags of the execution settings: the source of a component's thread, and the reaction when time runs out.
//!
//! Invariant: a setting that is not typed is not sent: Create takes the class's default, Configure
//! leaves it as it is.

use clap::{Args, ValueEnum};

use super::units;

/// Execution settings of a component, with the source of its thread.
#[derive(Args, Clone, Debug, Default, PartialEq)]
#[command(next_help_heading = "Execution")]
pub(super) struct ExecutionArgs {
    /// What makes it step.
    #[arg(long, value_enum)]
    pub(super) model: Option<Model>,
    /// Steps per second, Hz.
    #[arg(long, value_name = "HZ", value_parser = units::parse_rate, allow_negative_numbers = true)]
    pub(super) rate_hz: Option<f64>,
    /// Offset of its grid, e.g. 200us.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time_or_zero)]
    pub(super) phase: Option<u64>,
    /// Runs in the stream of this component.
    #[arg(long, value_name = "PATH", conflicts_with = "inside")]
    pub(super) stream_of: Option<String>,
    /// Runs inside the step of this component: before it, or after it with --model exec_out.
    #[arg(long, value_name = "PATH")]
    pub(super) inside: Option<String>,
    /// SCHED_FIFO priority, 1–99.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=99), allow_negative_numbers = true)]
    pub(super) priority: Option<u8>,
    /// CPUs it may run on, e.g. 1,2.
    #[arg(long, value_delimiter = ',', value_name = "N")]
    pub(super) cpus: Vec<u32>,
    /// Late periods that are made up for without pause, at most; 0 = they are skipped.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub(super) catch_up: Option<u32>,
    /// Threads that share the work of its stream, its own included, 1–64; where the stream begins.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(super) threads: Option<u32>,
    /// Longest stay in its own code before it is UNRESPONSIVE, for a component without a period, e.g. 50ms.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    pub(super) max_step: Option<u64>,
    /// Rows its state table keeps, 3–65536.
    #[arg(long, value_name = "ROWS", value_parser = clap::value_parser!(u32).range(3..=65_536))]
    pub(super) history: Option<u32>,
    /// What happens behind it in its stream when it fails.
    #[arg(long, value_enum)]
    pub(super) on_failure: Option<OnFailure>,
    /// How its thread is told that something has come; left out: poll up to a period of 10 ms, else signal.
    #[arg(long, value_enum)]
    pub(super) wake: Option<Wake>,
}

impl ExecutionArgs {
    /// Tells whether no setting was typed.
    pub(super) fn is_empty(&self) -> bool {
        *self == ExecutionArgs::default()
    }
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
    /// Inside another component's step, before it.
    ExecIn,
    /// Inside another component's step, after it.
    ExecOut,
    /// Head of a stream chain.
    Stream,
    /// Passive: in its callers' threads.
    None,
}

impl Model {
    /// Returns the spelling of the API and of the system file.
    pub(super) fn wire_name(self) -> &'static str {
        match self {
            Model::Periodic => "periodic",
            Model::Continuous => "continuous",
            Model::OnSignal => "on_signal",
            Model::OnCallback => "on_callback",
            Model::ExecIn => "exec_in",
            Model::ExecOut => "exec_out",
            Model::Stream => "stream",
            Model::None => "none",
        }
    }
}

/// Ways to tell a thread that something has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Wake {
    /// Woken, if it sleeps.
    Signal,
    /// Looks at each period.
    Poll,
}

impl Wake {
    /// Returns the spelling of the API and of the system file.
    pub(super) fn wire_name(self) -> &'static str {
        match self {
            Wake::Signal => "signal",
            Wake::Poll => "poll",
        }
    }
}

/// Behaviour of a stream behind a filter that failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum OnFailure {
    /// Nothing more comes.
    #[value(alias = "stop_branch")]
    StopBranch,
    /// Frames pass it unchanged.
    Bypass,
}

impl OnFailure {
    /// Returns the spelling of the API and of the system file.
    pub(super) fn wire_name(self) -> &'static str {
        match self {
            OnFailure::StopBranch => "stop_branch",
            OnFailure::Bypass => "bypass",
        }
    }
}
