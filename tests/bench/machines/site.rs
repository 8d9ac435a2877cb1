//! Two hosts as processes of their own, `near` and `far`, that show each other certificates; their GCM is in
//! the benchmark.

use serde_json::Value;
use trocar::model::{ConnectOptions, Queue};
use trocar_net::Authority;
use trocar_tests::{HostProcess, issue_host};

use crate::lab::Lab;

pub(super) struct Site {
    _processes: [HostProcess; 2],
    pub(super) lab: Lab,
}

impl Site {
    /// Two processes, started with further arguments.
    pub(super) fn new(more: &[&str]) -> Site {
        let lab = Lab::of_processes();
        let mut authority = Authority::init(&lab.world().state().join("authority")).expect("an authority");
        let mut process = |name: &str| {
            let file = lab.world().state().join(format!("{name}.pem"));
            issue_host(&mut authority, name, &[name], &file);
            let (file, gcm) = (file.display().to_string(), lab.address());
            let args = ["--gcm", &gcm, "--identity", &file, "--listen-lines", "127.0.0.1:0"];
            let args = [&args, more].concat();
            let process = HostProcess::start_with(lab.world(), name, &args);
            lab.await_gauge(&format!("{name}/"));
            process
        };
        let processes = [process("near"), process("far")];
        Site { _processes: processes, lab }
    }

    /// Connects over a line.
    pub(super) fn connect(&self, client: &str, server: &str) {
        self.lab.connect_with(client, server, over_a_line());
    }

    /// As [`Site::connect`], with a queue that keeps every sample.
    pub(super) fn connect_every(&self, client: &str, server: &str, depth: usize) {
        let queue = Some(Queue::Fifo { depth, drop_oldest: true });
        self.lab.connect_with(client, server, ConnectOptions { queue, ..over_a_line() });
    }

    /// Forgets the samples that came so far.
    pub(super) fn clear(&self, sink: &str) {
        self.lab.invoke(&format!("{sink}/time/clear"), Value::Null);
    }
}

fn over_a_line() -> ConnectOptions {
    ConnectOptions { carrier: "net".into(), ..ConnectOptions::default() }
}
