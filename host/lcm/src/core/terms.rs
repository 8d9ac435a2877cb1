//! The terms on which a component runs, by its execution and its thread.

use trocar_model::{Execution, ExecutionModel, OnFailure};
use trocar_rt::executor::Pace;

use super::super::thread::Thread;

/// Longest stay inside a component's code before it counts as unresponsive, ns; five periods when those are
/// longer.
const PATIENCE_NS: u64 = 50_000_000;

/// Terms on which a component runs.
pub(super) struct Terms {
    /// Period of its grid, ns; 0 without one.
    pub(super) period_ns: u64,
    pub(super) patience_ns: u64,
    /// True when it runs in its callers' threads.
    pub(super) passive: bool,
    /// True when it runs in threads of its device.
    pub(super) called_back: bool,
    /// True when its executor polls and needs no wake.
    pub(super) polled: bool,
    /// True when it steps with its polling thread, and only its steps take its samples.
    pub(super) looks: bool,
    /// True when frames pass it unchanged after its step has failed.
    pub(super) bypass: bool,
    /// True when it steps on another component's stream.
    pub(super) filter: bool,
    /// True when it moves something.
    pub(super) actuator: bool,
}

impl Terms {
    /// Terms of `execution` on a thread.
    pub(super) fn of(execution: &Execution, thread: &Thread, actuator: bool) -> Terms {
        // A filter steps when new data have come, not on its thread's grid.
        let period_ns = match thread.pace {
            Pace::Grid { period_ns, .. } if execution.stream_of.is_none() => period_ns,
            _ => 0,
        };
        let passive = execution.model == Some(ExecutionModel::None);
        let called_back = execution.model == Some(ExecutionModel::OnCallback);
        let filter = execution.stream_of.is_some();
        let bypass = execution.on_failure == Some(OnFailure::Bypass);
        Terms {
            period_ns,
            patience_ns: match period_ns {
                0 => execution.max_step_ns.unwrap_or(PATIENCE_NS),
                period => PATIENCE_NS.max(5 * period),
            },
            passive,
            called_back,
            polled: thread.polls,
            looks: thread.polls && !passive && !called_back && !filter && !bypass,
            bypass,
            filter,
            actuator,
        }
    }
}
