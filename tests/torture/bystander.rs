//! A component at 1 kHz beside which something is done, and its like in a process of their own, one on each
//! processor.
//!
//! Invariant: counters only: what the machine takes away it takes from the others, too; what is missed beyond
//! that was done to it.

use serde_json::json;
use trocar_proto::v1::Execution;

use crate::book::{Book, Counts};
use crate::clock::eventually;
use crate::program::Program;
use crate::rpc::Rpc;
use crate::world::World;

const CLASS: &str = "fixture-chaos/late";
/// SCHED_FIFO, where the machine grants it.
pub(crate) const PRIORITY: u32 = 80;

pub(crate) struct Bystander {
    rpc: Rpc,
    path: String,
    control: Rpc,
    controls: Vec<String>,
    host: Program,
    /// Periods elapsed and skipped when it began: its own, and those of the control.
    before: (Count, Count),
}

#[derive(Clone, Copy, Default)]
struct Count {
    elapsed: u64,
    skipped: u64,
}

impl Count {
    fn of(rpc: &Rpc, path: &str) -> Result<Count, String> {
        let stats = rpc.stats(path)?;
        Ok(Count { elapsed: stats.executed + stats.skipped, skipped: stats.skipped })
    }
}

/// Makes one and starts it once its class is offered.
pub(crate) fn start_late(
    rpc: &Rpc,
    path: &str,
    config: serde_json::Value,
    execution: Execution,
) -> Result<(), String> {
    eventually(&format!("{path} is made"), || {
        Ok(rpc.create_with(path, CLASS, config.clone(), execution.clone())?)
    })?;
    Ok(rpc.start(path)?)
}

impl Bystander {
    /// Beside whatever runs in a process that has the plugin `fixture_chaos`.
    pub(crate) fn start(world: &World, rpc: &Rpc, path: &str) -> Result<Bystander, String> {
        let host = Program::host(world, "control", None)?;
        let control = Rpc::at(&host.address);
        let execution = |cpus| Execution {
            model: "periodic".into(),
            rate_hz: Some(1000.0),
            priority: Some(PRIORITY),
            cpus,
            ..Execution::default()
        };
        let processors = std::thread::available_parallelism().map_or(1, |n| n.get() as u32);
        let mut controls = Vec::new();
        for cpu in 0..processors {
            let path = format!("control/late-{cpu}");
            start_late(&control, &path, json!({}), execution(vec![cpu]))?;
            controls.push(path);
        }
        start_late(rpc, path, json!({}), execution(Vec::new()))?;
        let (rpc, path) = (rpc.clone(), path.to_owned());
        let mut all = Bystander { rpc, path, control, controls, host, before: Default::default() };
        all.before = all.now()?;
        Ok(all)
    }

    fn now(&self) -> Result<(Count, Count), String> {
        let mut sum = Count::default();
        for path in &self.controls {
            let one = Count::of(&self.control, path)?;
            sum = Count { elapsed: sum.elapsed.max(one.elapsed), skipped: sum.skipped + one.skipped };
        }
        Ok((Count::of(&self.rpc, &self.path)?, sum))
    }

    /// What it missed since it began; then the control ends.
    pub(crate) fn tell(mut self, book: &mut Book) -> Result<(), String> {
        let (ours, theirs) = self.now()?;
        let (before, theirs_before) = self.before;
        let elapsed = ours.elapsed - before.elapsed;
        let counts = Counts {
            seen: ours.skipped - before.skipped,
            control: theirs.skipped - theirs_before.skipped,
            // One in a thousand: neither sees the other's processor all the time.
            allowed: elapsed / 1000 + 1,
        };
        book.counts("periods of a bystander: missed (G4)", elapsed as usize, counts);
        self.host.terminate()
    }
}
