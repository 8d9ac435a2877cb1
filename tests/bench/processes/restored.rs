//! A process that crashes under `trocar up`: how soon it is back and sends again.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually, number};

use crate::baseline::{now_ns, sleep_until};
use crate::lab::as_number;
use crate::table::{Goal, Table, median};

/// Repetitions; the median counts.
const CRASHES: usize = 9;

const FILE: &str = r#"{
  "version": 1,
  "processes": {
    "left": { "plugins": ["plugins"] },
    "right": { "plugins": ["plugins"], "restart": { "max": 1000, "backoff_ms": 1, "most_backoff_ms": 1 } }
  },
  "components": {
    "left/sink": { "class": "sink" },
    "right/sender": { "class": "sender", "execution": { "period_us": 250 } }
  },
  "connections": [ { "client": "left/sink/small", "server": "right/sender/small" } ]
}"#;

pub(super) fn measure(table: &mut Table) {
    let world = World::with_plugins(&["fixture_gauge"]);
    let file = world.write("system.json", FILE);
    let args = ["up".into(), file.into(), "--listen".into(), "127.0.0.1:0".into(), "--json".into()];
    let up = HostProcess::spawn(&world, "up", &args);
    let grpc = up.grpcurl();
    let mut times = Vec::new();
    for _ in 0..CRASHES {
        more(&grpc, 1000.0);
        grpc.invoke("left/sink/time/clear", Value::Null);
        more(&grpc, 1000.0);
        let right = pid(&grpc, "right");
        let began_ns = now_ns();
        crash(right);
        eventually("right is another process", || match pid(&grpc, "right") {
            now if now != 0 && now != right => Ok(()),
            now => Err(now),
        });
        more(&grpc, 1000.0);
        times.push(row(&grpc, "resumed_ns") - began_ns as f64);
    }
    let what = "SIGSEGV of a process under `trocar up` (pause before a restart 1 ms), until the reader of its 4000 samples/s \
                has one of its next incarnation";
    table.row(what, median(times), Goal::Ns(50e6), "`trocar host --help`, begin to end", program());
}

/// As if it had touched memory that is not there. The first signal only ends the handler that looks for
/// stacks that are full: a real fault comes again by itself.
fn crash(pid: u64) {
    let end = now_ns() + 1_000_000_000;
    // SAFETY: signals to a process that this benchmark's own child started and waits for.
    while unsafe { libc::kill(pid as i32, libc::SIGSEGV) } == 0 && now_ns() < end {
        sleep_until(now_ns() + 50_000);
    }
}

/// A process that does nothing, begin to end, ns.
fn program() -> f64 {
    crate::table::timed(|| {
        let mut command = std::process::Command::new(trocar_tests::Built::trocar());
        command.args(["host", "--help"]).stdout(std::process::Stdio::null());
        command.status().expect("it starts");
    })
}

fn row(grpc: &Grpcurl, field: &str) -> f64 {
    let answer = grpc.ok("InteractService/Read", json!({ "path": "left/sink" }));
    as_number(&answer["json"][field])
}

fn more(grpc: &Grpcurl, samples: f64) {
    let before = row(grpc, "got");
    eventually("the sink takes samples", || match row(grpc, "got") {
        now if now >= before + samples => Ok(()),
        now => Err(now),
    });
}

fn pid(grpc: &Grpcurl, name: &str) -> u64 {
    let list = grpc.ok("GcmService/List", json!({ "brief": true }));
    let all = list["processes"].as_array().cloned().unwrap_or_default();
    all.iter().find(|p| p["name"] == name).map_or(0, |p| number(&p["pid"]))
}
