//! Whether something makes a 1 kHz component miss cycles, judged against the same component in another
//! process at the same time, one on each processor.
//!
//! Invariant: counters only, no clock; all rounds count together, so that a good one excuses no bad one. What
//! the machine takes away it takes away from the control, too; what is missed beyond that is the host's
//! doing.

use std::thread;

use serde_json::json;

use crate::{Grpcurl, HostProcess, World, eventually, number};

/// Tries before the host is blamed.
const ROUNDS: usize = 5;
/// Periods of a round at least, 1 kHz.
const PERIODS: u64 = 1000;

/// A 1 kHz component beside which something else happens, and those of the control.
pub struct Bystander {
    grpc: Grpcurl,
    path: String,
    control: Grpcurl,
    controls: Vec<String>,
    _host: HostProcess,
    _world: World,
}

/// Periods elapsed, and those of them skipped.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    elapsed: u64,
    skipped: u64,
}

impl Count {
    fn of(grpc: &Grpcurl, path: &str) -> Count {
        let stats = grpc.component(path)["stats"].clone();
        let skipped = number(&stats["skipped"]);
        Count { elapsed: number(&stats["executed"]) + skipped, skipped }
    }

    fn since(self, before: Count) -> Count {
        Count { elapsed: self.elapsed - before.elapsed, skipped: self.skipped - before.skipped }
    }
}

impl Bystander {
    /// Creates and starts a `sine` as `host/NAME`, with a real-time priority where the machine grants one;
    /// and the control.
    #[must_use]
    pub fn start(grpc: &Grpcurl, name: &str) -> Self {
        let start = |grpc: &Grpcurl, path: &str, cpus: Vec<usize>| {
            grpc.await_class("host", "sine");
            let execution = json!({ "model": "periodic", "rate_hz": 1000, "priority": 80, "cpus": cpus });
            grpc.create_with(path, "sine", json!({}), execution);
            grpc.start(path);
            path.to_owned()
        };
        let world = World::with_plugins(&["sine"]);
        let host = HostProcess::start(&world);
        let control = host.grpcurl();
        let processors = thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let controls =
            (0..processors).map(|cpu| start(&control, &format!("host/control-{cpu}"), vec![cpu])).collect();
        let path = start(grpc, &format!("host/{name}"), Vec::new());
        Self { grpc: grpc.clone(), path, control, controls, _host: host, _world: world }
    }

    /// Does something, and again if need be, and checks that all in all no more cycles were missed meanwhile
    /// than on all processors together by the control, apart from one in a thousand.
    ///
    /// # Panics
    /// When that is so after no round, with the counts of all rounds.
    #[track_caller]
    pub fn undisturbed_by(&self, what: &str, mut doing: impl FnMut()) {
        let (mut ours, mut theirs) = (Count::default(), Count::default());
        let mut rounds = Vec::new();
        for _ in 0..ROUNDS {
            let (round, control) = self.round(&mut doing);
            for (sum, more) in [(&mut ours, round), (&mut theirs, control)] {
                sum.elapsed += more.elapsed;
                sum.skipped += more.skipped;
            }
            let allowed = theirs.skipped + ours.elapsed / 1000 + 1;
            rounds.push(format!(
                "{round:?}, control {control:?}; so far {} missed, {allowed} allowed",
                ours.skipped
            ));
            if ours.skipped <= allowed {
                return;
            }
        }
        panic!("{} misses cycles through {what}, in all rounds together:\n{}", self.path, rounds.join("\n"));
    }

    /// What was missed while it was done, and by the control around it.
    fn round(&self, doing: &mut impl FnMut()) -> (Count, Count) {
        let controls = || self.controls.iter().map(|path| Count::of(&self.control, path)).collect::<Vec<_>>();
        let (theirs, ours) = (controls(), Count::of(&self.grpc, &self.path));
        doing();
        let until = ours.elapsed + PERIODS;
        eventually(&format!("{} goes on", self.path), || match Count::of(&self.grpc, &self.path).elapsed {
            now if now >= until => Ok(()),
            now => Err(format!("{now} of {until}")),
        });
        let ours = Count::of(&self.grpc, &self.path).since(ours);
        assert_eq!(self.grpc.state(&self.path), "ACTIVE", "{} runs on", self.path);
        let mut sum = Count { elapsed: ours.elapsed, skipped: 0 };
        for (after, before) in controls().into_iter().zip(theirs) {
            sum.skipped += after.since(before).skipped;
        }
        (ours, sum)
    }
}
