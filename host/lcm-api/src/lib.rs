//! What a GCM can ask of a Local Component Manager, in its own process or through an Attach stream.
//!
//! Invariant: every call ends by its deadline, whatever a component does; a refused or failed change leaves nothing half made. Nothing here
//! does anything: whoever asks an LCM depends on this alone, and not on how one is made.
#![forbid(unsafe_code)]

use std::sync::Arc;
use std::time::Instant;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::{broadcast, mpsc};
use trocar_links::Card;
use trocar_model::{
    Change, ClassInfo, ComponentId, Connection, End, Health, MemberId, Phase, Ports, Proxy, Refusal, State,
    StepTimes, Warnings,
};

/// The owner of one process's components.
#[async_trait]
pub trait Lcm: Send + Sync {
    /// Carries out one change and answers how the component stands afterwards (for a connection: the client's).
    ///
    /// # Errors
    /// ComponentRefused, ComponentFault, the plugin refusals, LcmTimeout; the change is then undone as far as it got.
    async fn apply(&self, change: Change, deadline: Instant) -> Result<Report, Refusal>;

    /// Makes the half of a connection to another process; for a client, linked to the other one.
    ///
    /// # Errors
    /// Unreachable, with what keeps the two apart; then there is no half.
    async fn link(&self, end: FarEnd, deadline: Instant) -> Result<Report, Refusal>;

    /// Calls a command. Reads are answered from the published state row.
    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal>;

    /// Reads without a command: a state row of a component, or the newest sample of an output; with `frame` the bytes of
    /// a frame, too.
    async fn read(&self, path: String, when: When, frame: bool, deadline: Instant)
    -> Result<Sample, Refusal>;

    /// Follows events, component states and outputs until the receiver is dropped. Slow receivers lose items, counted
    /// in the next item's `skipped`.
    async fn subscribe(&self, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal>;

    /// Live figures of one component.
    async fn detail(&self, id: ComponentId) -> Result<Detail, Refusal>;

    /// Figures of every connection that ends in this process.
    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal>;

    /// Lets components whose phase nobody asked for step at these places in their periods, and others at 0;
    /// nothing: leaves them where they are. Answers what the steps of components take that have run long enough to
    /// tell. No component is waited for.
    async fn phases(
        &self,
        _given: Option<Vec<(ComponentId, Phase)>>,
        _deadline: Instant,
    ) -> Result<StepTimes, Refusal> {
        Ok(StepTimes::new())
    }

    /// The plugins its directories hold, refused ones too.
    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal>;

    /// Looks at plugin files again, those of this name or all and lists them. Where there are no plugin directories,
    /// nothing is looked at.
    async fn recheck(&self, name: &str, _deadline: Instant) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(self.plugins().await?.into_iter().filter(|plugin| plugin.is_called(name)).collect())
    }

    /// Everything it has: sent at registration and after a gap in the news.
    async fn inventory(&self) -> Result<Inventory, Refusal>;

    /// What changes by itself; a lagging receiver asks for the inventory again.
    fn news(&self) -> broadcast::Receiver<News>;
}

/// A connection of which one end is in this process, and what has to be known of the other one.
#[derive(Clone, Debug)]
pub struct FarEnd {
    pub connection: Connection,
    /// Ports of the component at the other end.
    pub ports: Arc<Ports>,
    pub class: ClassOf,
    /// Its process.
    pub card: Card,
}

/// The class of a component.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ClassOf {
    /// `plugin/class`; empty where nobody told it.
    pub name: String,
    /// Of the plugin file, as in [`trocar_model::ClassInfo`].
    pub hash: String,
}

/// How a component stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    pub id: ComponentId,
    /// Counts up within a run of the process: a higher one was looked up later. 0: nobody counted.
    pub number: u64,
    pub state: State,
    pub health: Health,
    /// Why it is in FAULT; empty otherwise.
    pub fault: String,
    /// Present when the ports may have changed.
    pub ports: Option<Arc<Ports>>,
    /// Connections the LCM cut because a port they ended in went, by number.
    pub lost_connections: Vec<u64>,
    /// Sentences for the caller, e.g. a real-time setting the machine refused; in the answer to a change only new ones.
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug)]
pub enum News {
    State(Report),
    /// The plugin directories offer this now.
    Catalog(Vec<Arc<ClassInfo>>),
    Log(LogLine),
    Half(HalfReport),
    /// The process itself is warned of this now, instead of what it was before.
    Warnings(Warnings),
}

/// How the half of a connection to another process stands.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfReport {
    pub connection: u64,
    pub end: End,
    /// `None`: it is gone.
    pub proxy: Option<Proxy>,
}

#[derive(Clone, Debug, Default)]
pub struct Inventory {
    /// How other processes reach this one; `None`: not at all.
    pub card: Option<Card>,
    pub components: Vec<Report>,
    pub classes: Vec<Arc<ClassInfo>>,
    /// Halves of connections to other processes.
    pub halves: Vec<HalfReport>,
    pub warnings: Warnings,
}

/// One line a component or the host logged.
#[derive(Clone, Debug)]
pub struct LogLine {
    /// Ns since the Unix epoch.
    pub wall_ns: u64,
    /// 1 error … 5 trace.
    pub level: u32,
    /// The component's path, or the process name.
    pub path: String,
    pub target: String,
    pub message: String,
}

#[derive(Clone, Debug)]
pub struct Invoke {
    pub member: MemberId,
    pub arg: Payload,
    /// Return as soon as it is queued.
    pub send: bool,
    /// Relative, ns.
    pub deadline_ns: u64,
}

#[derive(Clone, Debug, Default)]
pub enum Payload {
    #[default]
    None,
    Json(Value),
    /// Exact bytes of the described type.
    Encoded(Vec<u8>),
}

#[derive(Clone, Debug)]
pub struct Reply {
    /// False: queued only.
    pub executed: bool,
    pub value: Option<Value>,
    pub encoded: Vec<u8>,
    /// Stamp of the state row a read was answered from, ns; 0 otherwise.
    pub stamp_ns: u64,
    pub age_ns: u64,
    /// Unit of the value, "" = none.
    pub unit: String,
}

/// Which row of a state table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum When {
    #[default]
    Newest,
    /// The values at a stamp, ns; between two rows they are interpolated.
    Time(u64),
    /// The row nearest to a stamp, ns.
    Nearest(u64),
    Tick(u64),
    /// That many rows before the newest.
    Delayed(u64),
}

#[derive(Clone, Debug, Default)]
pub struct Sample {
    pub value: Value,
    pub encoded: Vec<u8>,
    pub stamp_ns: u64,
    pub age_ns: u64,
    pub seq: u64,
    /// Bytes of the frame behind the header; 0 for plain samples.
    pub frame_bytes: u64,
    /// Those bytes, where they were asked for.
    pub frame: Vec<u8>,
}

/// One thing to follow: `process/component` (its state), `…/interface/event`, or `…/output`.
#[derive(Clone, Debug)]
pub struct Selection {
    pub path: String,
    /// Most items per second of an output; 0 = 30.
    pub max_rate_hz: f64,
    /// Frames that are images as JPEG of this width, pixels; 0 = header only.
    pub thumbnail_width: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ItemKind {
    State,
    Event,
    Stream,
}

#[derive(Clone, Debug)]
pub struct Item {
    pub path: String,
    pub kind: ItemKind,
    pub value: Value,
    pub stamp_ns: u64,
    pub seq: u64,
    /// Items lost on the way to this receiver since the previous one.
    pub skipped: u64,
    /// The frame as JPEG, where a width was asked for and it is an image.
    pub jpeg: Vec<u8>,
}

/// A figure's distribution, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    pub avg_ns: f64,
    pub std_ns: f64,
    pub min_ns: u64,
    pub max_ns: u64,
}

/// The system interface's `period_statistics` and counters.
#[derive(Clone, Debug, Default)]
pub struct Detail {
    pub period: Spread,
    pub compute: Spread,
    pub lateness_p50_ns: u64,
    pub lateness_p99_ns: u64,
    pub lateness_max_ns: u64,
    pub executed: u64,
    pub skipped: u64,
    pub overruns: u64,
    /// Compute time over period, 0–1.
    pub load: f64,
    pub commands: u64,
    /// Commands lost: not taken by a full queue, given up for newer ones, or only sent and not run before their connection
    /// was cut.
    pub commands_rejected: u64,
    /// Events lost in its handlers' full queues.
    pub events_dropped: u64,
    /// Where it runs: "own thread", "stream of host/source", "callers' threads".
    pub thread: String,
    /// True when SCHED_FIFO was granted.
    pub realtime: bool,
    pub warnings: Vec<String>,
    /// Offset of its grid from the multiples of the period, ns; `None` without a grid of its own.
    pub phase_ns: Option<u64>,
    /// Nobody asked for that phase.
    pub phase_auto: bool,
}

#[derive(Clone, Debug, Default)]
pub struct LinkDetail {
    pub connection: u64,
    /// "inline", "heap", "memfd".
    pub carrier: String,
    /// How each end is told that something has come for it, "signal" or "poll"; empty where nobody is.
    pub client_wake: &'static str,
    pub server_wake: &'static str,
    pub passed: u64,
    /// Lost in a full queue or for lack of frames; those in `rejected` too.
    pub dropped: u64,
    /// Samples a newer one took the place of where only the newest is taken, and commands that a newer one of
    /// their kind superseded: no loss, and none of `dropped`.
    pub skipped: u64,
    /// Commands and events a full queue did not take.
    pub rejected: u64,
    /// Samples, or commands and as many events, that may wait.
    pub depth: u64,
    /// The most commands or events that ever waited at once.
    pub high_water: u64,
    /// Commands that were only sent, ran and failed.
    pub failed: u64,
    /// Commands that were only sent, and events, that were taken and never ran: Stop, Disconnect, Remove.
    pub unexecuted: u64,
    pub bytes: u64,
    /// Age of a sample when the client took it.
    pub latency_p50_ns: u64,
    pub latency_p99_ns: u64,
    /// Of a connection to another process: the half these are the figures of, or both once they are merged.
    pub halves: Vec<(End, Proxy)>,
}

impl LinkDetail {
    /// The figures of one connection over two links, one after the other.
    pub fn followed_by(self, later: &LinkDetail) -> LinkDetail {
        let newest = |before: u64, now: u64| if now == 0 { before } else { now };
        LinkDetail {
            passed: self.passed + later.passed,
            dropped: self.dropped + later.dropped,
            skipped: self.skipped + later.skipped,
            rejected: self.rejected + later.rejected,
            depth: newest(self.depth, later.depth),
            high_water: self.high_water.max(later.high_water),
            failed: self.failed + later.failed,
            unexecuted: self.unexecuted + later.unexecuted,
            bytes: self.bytes + later.bytes,
            latency_p50_ns: newest(self.latency_p50_ns, later.latency_p50_ns),
            latency_p99_ns: newest(self.latency_p99_ns, later.latency_p99_ns),
            ..self
        }
    }

    /// What the halves of a connection between processes know of it together. What both see (the queues they share) counts once;
    /// commands and events that never ran wait at different ends.
    pub fn merged(mut self, other: LinkDetail) -> LinkDetail {
        self.halves.extend(other.halves);
        self.halves.sort_by_key(|(end, _)| *end);
        // Each half has read both at one time: of the later one, so that they belong together.
        let (bytes, passed) = (self.bytes, self.passed).max((other.bytes, other.passed));
        LinkDetail {
            connection: self.connection,
            carrier: if self.carrier.is_empty() { other.carrier } else { self.carrier },
            client_wake: if self.client_wake.is_empty() { other.client_wake } else { self.client_wake },
            server_wake: if self.server_wake.is_empty() { other.server_wake } else { self.server_wake },
            passed,
            dropped: self.dropped.max(other.dropped),
            skipped: self.skipped.max(other.skipped),
            rejected: self.rejected.max(other.rejected),
            depth: self.depth.max(other.depth),
            high_water: self.high_water.max(other.high_water),
            failed: self.failed.max(other.failed),
            unexecuted: self.unexecuted + other.unexecuted,
            bytes,
            latency_p50_ns: self.latency_p50_ns.max(other.latency_p50_ns),
            latency_p99_ns: self.latency_p99_ns.max(other.latency_p99_ns),
            halves: self.halves,
        }
    }
}

/// One file of a plugin directory.
#[derive(Clone, Debug, Default)]
pub struct PluginInfo {
    pub process: String,
    pub file: String,
    pub name: String,
    pub version: String,
    pub hash: String,
    pub abi: String,
    pub built_with: String,
    pub doc: String,
    pub classes: Vec<String>,
    pub loaded: bool,
    pub warnings: Vec<String>,
    /// Reason code and sentence when refused; empty otherwise.
    pub refused_reason: String,
    pub refused: String,
}

impl PluginInfo {
    /// It is the plugin, or the file, of this name; every one where the name is empty.
    pub fn is_called(&self, name: &str) -> bool {
        name.is_empty() || self.name == name || self.file.rsplit('/').next() == Some(name)
    }
}

#[cfg(test)]
mod tests {
    use super::LinkDetail;

    #[test]
    fn bytes_and_samples_of_a_connection_are_of_the_half_that_was_read_later() {
        let half = |passed: u64, each: u64| LinkDetail { passed, bytes: passed * each, ..Default::default() };
        for (client, server) in [(half(397, 16), half(396, 16)), (half(396, 16), half(397, 16))] {
            let both = client.merged(server);
            assert_eq!((both.passed, both.bytes), (397, 397 * 16));
        }
        // The client knows the headers of frames only.
        let both = half(61, 8).merged(half(60, 4096));
        assert_eq!((both.passed, both.bytes), (60, 60 * 4096));
    }
}
