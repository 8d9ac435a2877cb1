//! Two hosts as processes of their own, `near` and `far`, whose GCM is in the benchmark.

use serde_json::Value;
use trocar::model::{Execution, ExecutionModel};
use trocar_tests::HostProcess;

use crate::lab::{Lab, as_number};

pub(super) struct Site {
    _processes: [HostProcess; 2],
    pub(super) lab: Lab,
}

/// A process attached to this GCM that offers the gauge.
pub(super) fn process(lab: &Lab, name: &str) -> HostProcess {
    let process = HostProcess::start_with(lab.world(), name, &["--gcm", &lab.address()]);
    lab.await_gauge(&format!("{name}/"));
    process
}

impl Site {
    pub(super) fn new() -> Site {
        let lab = Lab::of_processes();
        Site { _processes: ["near", "far"].map(|name| process(&lab, name)), lab }
    }
}

pub(crate) fn periodic(period_ns: u64) -> Execution {
    Execution { period_ns: Some(period_ns), ..crate::lab::model(ExecutionModel::Periodic) }
}

/// p50 and p99 of the ways of the samples a sink has taken since it was cleared, ns.
pub(crate) fn ways(lab: &Lab, sink: &str, least: usize) -> (f64, f64) {
    let figures = lab.invoke(&format!("{sink}/time/ways"), Value::Null);
    let count = as_number(&figures["count"]);
    assert!(count >= least as f64, "{sink} took {count} samples, {least} at least were sent to it");
    (as_number(&figures["p50"]), as_number(&figures["p99"]))
}

/// p50 and p99 of the ways of so many samples from `far/sender`, which is started for them, to `near/sink`,
/// ns.
pub(crate) fn round(lab: &Lab, warm: usize, count: usize) -> (f64, f64) {
    lab.start_only("far/sender");
    // The first samples still met new memory.
    lab.wait("near/sink", "got", warm as f64);
    lab.invoke("near/sink/time/clear", Value::Null);
    lab.wait_until("near/sink", "got", count as f64);
    lab.stop("far/sender");
    ways(lab, "near/sink", count)
}
