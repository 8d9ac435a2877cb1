//! A connection replaced under a component that uses it.

use std::time::Instant;

use trocar::model::{ConnectOptions, Execution, ExecutionModel};

use crate::lab::{Lab, model};
use crate::table::{Goal, Table, median};

const TIMES: usize = 200;

pub(crate) fn measure(table: &mut Table) {
    let lab = Lab::new();
    for name in ["a", "b"] {
        lab.create(name, "target", model(ExecutionModel::OnSignal));
    }
    lab.create("gauge", "gauge", Execution { period_ns: Some(1_000_000), ..Execution::default() });
    lab.connect("gauge/peer", "a/ctl");
    lab.start();
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    let (mut rebound, mut asked) = (Vec::new(), Vec::new());
    lab.block_on(async |host| {
        for i in 0..TIMES {
            let server = if i % 2 == 0 { "host/b/ctl" } else { "host/a/ctl" };
            let began = Instant::now();
            host.connect_with("host/gauge/peer", server, options.clone()).await?;
            rebound.push(began.elapsed().as_nanos() as f64);
            let began = Instant::now();
            host.detail("host/gauge").await?;
            asked.push(began.elapsed().as_nanos() as f64);
        }
        Ok(())
    });
    table.title("Rewiring");
    let beside = "asking for the component's figures";
    table.row(
        "connection of a running component replaced",
        median(rebound),
        Goal::Ns(50e3),
        beside,
        median(asked),
    );
}
