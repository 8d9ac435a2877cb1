//! How soon a connection between two processes stands, and how soon the loss of a process is told.

use std::time::Instant;

use serde_json::{Value, json};
use trocar::model::ExecutionModel;
use trocar_proto::v1;

use super::bare;
use super::site::{Site, periodic, process};
use crate::baseline::now_ns;
use crate::lab::{Lab, model};
use crate::table::{Goal, Table, median};

/// Repetitions; the median counts.
const TIMES: usize = 40;
const KILLS: usize = 9;
/// What a killed process holds beside itself.
const BALLAST_BYTES: u64 = 50_000_000;
const MS: f64 = 1e6;

pub(super) fn measure(table: &mut Table) {
    table.title("How soon connections between processes stand and are lost");
    connect(table);
    killed(table);
}

/// Connect over gRPC, and when the first sample is there.
fn connect(table: &mut Table) {
    let site = Site::new();
    let lab = &site.lab;
    lab.create("far/target", "target", model(ExecutionModel::OnSignal));
    lab.create("far/sender", "sender", periodic(250_000));
    lab.create("near/caller", "gauge", model(ExecutionModel::None));
    lab.create("near/sink", "sink", model(ExecutionModel::OnSignal));
    lab.start();
    let (mut answered, mut first, mut bare) = (Vec::new(), Vec::new(), Vec::new());
    let (mut client, runtime) = lab.client();
    let mut ask = |request: v1::ConnectRequest| {
        let began = Instant::now();
        runtime.block_on(client.connect(request.clone())).expect("Connect");
        let connected = began.elapsed().as_nanos() as f64;
        let began = Instant::now();
        let list = v1::ListRequest { brief: true, ..Default::default() };
        runtime.block_on(client.list(list)).expect("List");
        bare.push(began.elapsed().as_nanos() as f64);
        connected
    };
    let mut gone = lab.client();
    let mut disconnect = |request: v1::ConnectRequest| {
        let v1::ConnectRequest { client, server, .. } = request;
        let request = v1::DisconnectRequest { client, server, ..Default::default() };
        gone.1.block_on(gone.0.disconnect(request)).expect("Disconnect");
    };
    for _ in 0..TIMES {
        let calls = request("near/caller/peer", "far/target/ctl");
        answered.push(ask(calls.clone()));
        disconnect(calls);
        lab.invoke("near/sink/time/clear", Value::Null);
        let samples = request("near/sink/small", "far/sender/small");
        let began_ns = now_ns();
        ask(samples.clone());
        lab.wait_until("near/sink", "got", 1.0);
        first.push(lab.number("near/sink", "first_ns") - began_ns as f64);
        disconnect(samples);
    }
    let beside = "List over the same connection";
    let bare = median(bare);
    table.row("Connect over gRPC, until it is answered", median(answered), Goal::Ns(5.0 * MS), beside, bare);
    let what = "attach: from Connect to the first sample of 4000/s at the reader";
    table.row(what, median(first), Goal::Ns(10.0 * MS), beside, bare);
}

fn request(client: &str, server: &str) -> v1::ConnectRequest {
    v1::ConnectRequest { client: client.into(), server: server.into(), ..Default::default() }
}

/// kill -9 of a process, until a component it sent to is told.
fn killed(table: &mut Table) {
    let lab = Lab::of_processes();
    let near = process(&lab, "near");
    let mut told = Vec::new();
    let mut bare = Vec::new();
    for i in 0..KILLS {
        let name = format!("far{i}");
        let mut remote = process(&lab, &name);
        let config = json!({ "ballast_bytes": BALLAST_BYTES });
        lab.create_with(&format!("{name}/sender"), "sender", config, periodic(250_000));
        let sink = format!("near/sink{i}");
        lab.create(&sink, "sink", periodic(100_000));
        lab.connect(&format!("{sink}/small"), &format!("{name}/sender/small"));
        lab.start_only(&sink);
        lab.start_only(&format!("{name}/sender"));
        lab.wait_until(&sink, "got", 100.0);
        let began_ns = now_ns();
        remote.kill();
        lab.wait_until(&sink, "lost_ns", 1.0);
        told.push(lab.number(&sink, "lost_ns") - began_ns as f64);
        lab.stop(&sink);
        bare.push(bare::killed(BALLAST_BYTES as usize));
    }
    drop(near);
    let what =
        "kill -9 of a process of 50 MB, until a component it sent to, which looks each 0.1 ms, is told";
    table.row(what, median(told), Goal::Ns(3.0 * MS), "a bare one, until its pipe ends", median(bare));
}
