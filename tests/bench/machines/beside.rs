//! A stream of 1 kHz beside video on a link of 1 Gbit/s.
//!
//! Invariant: the link is a loopback of a network of its own, shaped by the kernel; nothing else is on it.

use std::process::{Command, Stdio};

use serde_json::json;
use trocar::model::ExecutionModel;
use trocar_proto::v1;

use super::site::Site;
use crate::lab::model;
use crate::processes::{periodic, ways};
use crate::table::{Goal, Table};

/// First argument of this program inside the network of its own.
pub(crate) const INSIDE: &str = "--inside";
const MISSING: &str = "needs root and `tc`, for a network of its own";
/// The link: as a network card of 1 Gbit/s, packets of Ethernet's length, in the queue of three ranks that
/// the kernel gives a card.
const LINK: &str = "ip link set lo mtu 1500 && ip link set lo up && \
                    tc qdisc add dev lo root handle 1: tbf rate 1gbit burst 64kb latency 20ms && \
                    tc qdisc add dev lo parent 1:1 pfifo_fast";
/// The rate of the video's lane: what fits on the link with its headers.
const MBPS: &str = "936";
/// Samples that are looked at.
const COUNT: usize = 10_000;
/// The video: 30 frames/s of 3.6 MB are 864 Mbit/s, and some 900 with what the protocols add.
const FRAME_BYTES: u64 = 3_600_000;
const FRAME_PERIOD_NS: u64 = 33_333_333;

pub(super) fn measure(table: &mut Table) {
    if !in_a_network_of_its_own(LINK, Stdio::null()) {
        return table.missing("a stream beside video on a link of 1 Gbit/s", "≤ 1.5 ×", MISSING);
    }
    let me = std::env::current_exe().expect("this program has a path");
    let script = format!("{LINK} && exec {} {INSIDE}", me.display());
    assert!(in_a_network_of_its_own(&script, Stdio::inherit()), "the run in a network of its own failed");
}

fn in_a_network_of_its_own(script: &str, told: Stdio) -> bool {
    let mut inside = Command::new("unshare");
    inside.args(["--net", "sh", "-c", script]).stdin(Stdio::null()).stderr(told);
    inside.status().is_ok_and(|status| status.success())
}

pub(super) fn run_inside(table: &mut Table) {
    let site = Site::new(&["--line-mbps", MBPS]);
    let lab = &site.lab;
    table.title("A stream of 1 kHz, 64 B, beside video on a link of 1 Gbit/s: one way");
    lab.create("far/sender", "sender", periodic(1_000_000));
    lab.create("near/sink", "sink", model(ExecutionModel::OnSignal));
    site.connect_every("near/sink/small", "far/sender/small", 64);
    lab.create_with("far/camera", "sender", json!({ "frame_bytes": FRAME_BYTES }), periodic(FRAME_PERIOD_NS));
    lab.create("near/screen", "sink", model(ExecutionModel::OnSignal));
    site.connect_every("near/screen/frame", "far/camera/frame", 4);
    lab.start_only("near/**");
    lab.start_only("far/sender");
    let look = || {
        lab.wait("near/sink", "got", 200.0);
        site.clear("near/sink");
        lab.wait_until("near/sink", "got", COUNT as f64);
        ways(lab, "near/sink", COUNT)
    };
    let idle = look();
    lab.start_only("far/camera");
    lab.wait("near/screen", "got", 30.0);
    site.clear("near/screen");
    let beside = look();
    let frames = lab.number("near/screen", "got");
    let frame_ways = ways(lab, "near/screen", 1);
    lab.stop("far/**");
    table.row("p50", beside.0, Goal::Times(1.5), "the same on an idle link", idle.0);
    table.row("p99", beside.1, Goal::Times(2.0), "the same on an idle link", idle.1);
    let period = FRAME_PERIOD_NS as f64;
    table.row("a frame of 3.6 MB, p50", frame_ways.0, Goal::None, "the time between two", period);
    table.row("a frame of 3.6 MB, p99", frame_ways.1, Goal::None, "the time between two", period);
    let expected = COUNT as f64 * 1_000_000.0 / period;
    let holds = frames >= expected.floor() - 1.0;
    table.count(
        "frames in the time of 10 000 samples",
        &format!("{frames}"),
        "all",
        holds,
        &format!("{expected:.0}"),
    );
    let (mut client, runtime) = lab.client();
    let list = runtime.block_on(client.list(v1::ListRequest::default())).expect("List").into_inner();
    for v1::Connection { server, dropped, .. } in &list.connections {
        table.count(&format!("lost of {server}"), &format!("{dropped}"), "0", *dropped == 0, "");
    }
}
