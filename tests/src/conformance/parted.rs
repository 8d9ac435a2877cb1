//! Client and server in two processes of one machine, by how each end is executed.
//!
//! Invariant: whatever the threads of the two are, commands between them wait in a queue, and nothing else
//! follows from it.

use trocar::model::{Execution, ExecutionModel};

use super::Deployment;
use super::way::model;

/// A grid whose thread looks at its queues in its cycles only, ns.
const FAST_NS: u64 = 5_000_000;
/// One whose thread is woken in between, ns.
const SLOW_NS: u64 = 25_000_000;

fn grid(period_ns: u64) -> Execution {
    Execution { period_ns: Some(period_ns), ..model(ExecutionModel::Periodic) }
}

/// One deployment each: client, server, whether the server has a step, and the carrier between them.
macro_rules! parted {
    ($($(#[doc = $doc:literal])+ $name:ident, $text:literal: $client:expr, $server:expr, $steps:literal $(, $carrier:literal)?;)+) => {$(
        $(#[doc = $doc])+
        pub struct $name;

        impl Deployment for $name {
            fn name(&self) -> &'static str {
                $text
            }
            fn inline(&self) -> bool {
                false
            }
            fn client(&self) -> Execution {
                $client
            }
            fn server(&self) -> Execution {
                $server
            }
            fn two_processes(&self) -> bool {
                true
            }
            fn server_steps(&self) -> bool {
                $steps
            }
            $(fn carrier(&self) -> &'static str {
                $carrier
            })?
        }
    )+};
}

parted! {
    /// As on two machines: an encrypted line is between them.
    OtherMachine, "other machine": model(ExecutionModel::OnSignal), model(ExecutionModel::OnSignal), true, "net";
    /// Each in a process of its own, asleep until something arrives.
    OtherProcess, "other process": model(ExecutionModel::OnSignal), model(ExecutionModel::OnSignal), true;
    /// The client on a grid that looks at its queues in its cycles, the server on one that is woken in
    /// between.
    OtherProcessOnGrids, "other process, on grids": grid(FAST_NS), grid(SLOW_NS), true;
    /// The other way round.
    OtherProcessOnTurnedGrids, "other process, on grids, turned": grid(SLOW_NS), grid(FAST_NS), true;
    /// The client's thread never sleeps.
    OtherProcessOfFreeClient, "other process, the client free running":
        model(ExecutionModel::Continuous), model(ExecutionModel::OnSignal), true;
    /// The server's thread never sleeps.
    OtherProcessOfFreeServer, "other process, the server free running":
        model(ExecutionModel::OnSignal), model(ExecutionModel::Continuous), true;
    /// The server has no thread for steps: commands of other processes are run by the one it rests on.
    OtherProcessOfPassive, "other process, the server passive":
        model(ExecutionModel::OnSignal), model(ExecutionModel::None), false;
    /// A thread of the server's own, as of a device, calls it in; what is queued is run by whoever comes out.
    OtherProcessOfCalledBack, "other process, the server called back":
        model(ExecutionModel::OnSignal), model(ExecutionModel::OnCallback), false;
}

/// Two processes of the built program, asked over gRPC only.
pub struct BuiltProcesses;

impl Deployment for BuiltProcesses {
    fn name(&self) -> &'static str {
        "two processes of the built program"
    }
    fn inline(&self) -> bool {
        false
    }
    fn client(&self) -> Execution {
        OtherProcess.client()
    }
    fn server(&self) -> Execution {
        OtherProcess.server()
    }
    fn two_processes(&self) -> bool {
        true
    }
    fn built_processes(&self) -> bool {
        true
    }
}
