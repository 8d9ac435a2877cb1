//! Whether something makes a 1 kHz component miss cycles, judged against a control run on the same machine.
//!
//! Invariant: counters only, no clock; every round has its own control run, and one round within its bound is enough:
//! what the host itself takes away it takes away in every round, what the machine does it does in some.

use serde_json::json;

use crate::{Grpcurl, eventually, number};

/// Tries before the host is blamed.
const ROUNDS: usize = 5;
/// Periods of a control run, 1 kHz.
const CONTROL: u64 = 3000;

/// A 1 kHz component beside which something else happens.
pub struct Bystander {
    grpc: Grpcurl,
    path: String,
}

/// Periods elapsed, and those of them skipped.
#[derive(Clone, Copy, Debug)]
struct Count {
    elapsed: u64,
    skipped: u64,
}

impl Bystander {
    /// Creates and starts a `sine` as `host/NAME`, with a real-time priority where the machine grants one.
    #[must_use]
    pub fn start(grpc: &Grpcurl, name: &str) -> Self {
        grpc.await_class("host", "sine");
        let path = format!("host/{name}");
        let execution = json!({ "model": "periodic", "rate_hz": 1000, "priority": 80 });
        grpc.create_with(&path, "sine", json!({}), execution);
        grpc.start(&path);
        Self { grpc: grpc.clone(), path }
    }

    /// Does something up to a few times and checks that it misses no more cycles than a control run does, apart from one
    /// in a thousand.
    ///
    /// # Panics
    /// When every round missed more, with the counts of all rounds.
    #[track_caller]
    pub fn undisturbed_by(&self, what: &str, mut doing: impl FnMut()) {
        let mut rounds = Vec::new();
        for _ in 0..ROUNDS {
            let control = self.while_(|| self.lets_pass(CONTROL));
            let tried = self.while_(|| {
                doing();
                self.lets_pass(100);
            });
            let allowed = control.skipped * tried.elapsed / control.elapsed.max(1) + tried.elapsed / 1000 + 1;
            if tried.skipped <= allowed {
                return;
            }
            rounds.push(format!("{tried:?}, control {control:?}, {allowed} allowed"));
        }
        panic!("{} misses cycles through {what}, in every round:\n{}", self.path, rounds.join("\n"));
    }

    /// Waits until this many more periods were executed, asking as often as [`eventually`] does.
    fn lets_pass(&self, periods: u64) {
        let until = self.count().elapsed + periods;
        eventually(&format!("{} goes on for {periods} periods", self.path), || {
            let now = self.count().elapsed;
            if now >= until { Ok(()) } else { Err(format!("{now} of {until}")) }
        });
    }

    fn while_(&self, doing: impl FnOnce()) -> Count {
        let before = self.count();
        doing();
        let after = self.count();
        assert_eq!(self.grpc.state(&self.path), "ACTIVE", "{} runs on", self.path);
        Count { elapsed: after.elapsed - before.elapsed, skipped: after.skipped - before.skipped }
    }

    fn count(&self) -> Count {
        let stats = self.grpc.component(&self.path)["stats"].clone();
        let skipped = number(&stats["skipped"]);
        Count { elapsed: number(&stats["executed"]) + skipped, skipped }
    }
}
