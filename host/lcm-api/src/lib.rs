//! The calls a GCM makes to a Local Component Manager, in its own process or through an Attach stream.
//!
//! Invariant: every call ends by its deadline, whatever a component does; a refused or failed change leaves
//! nothing half made. This crate implements nothing: a caller of an LCM depends on this crate alone, not on
//! how an LCM is made.
#![forbid(unsafe_code)]

use std::sync::Arc;
use std::time::Instant;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::{broadcast, mpsc};
use trocar_links::Card;
use trocar_model::{
    Change, ClassInfo, ComponentId, Connection, End, Health, MemberId, Phase, Ports, Proxy, Refusal, State,
    StepTimes, Target, Warnings,
};

pub mod clock;
mod order;

pub use order::{Decision, Lease, Order};

/// The owner of one process's components.
#[async_trait]
pub trait Lcm: Send + Sync {
    /// Carries out one change and returns the resulting state of the component (for a connection: of the
    /// client).
    ///
    /// # Errors
    /// ComponentRefused, ComponentFault, the plugin refusals, LcmTimeout; the change is then undone as far as
    /// it got. WrongState for a Start or Resume that a Stop decided later holds off.
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal>;

    /// Stops all that the targets name. From the first moment on no Start or Resume that was decided earlier
    /// sets any of it in motion, also what is only being made: such a one takes itself back. Waits for no
    /// other order, and one component that cannot be stopped keeps no other from being stopped.
    ///
    /// # Errors
    /// The process cannot be told.
    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal>;

    /// Makes the half of a connection to another process; for a client, linked to the other one.
    ///
    /// # Errors
    /// Unreachable, with the reason; then there is no half.
    async fn link(&self, end: RemoteEnd, deadline: Instant) -> Result<Report, Refusal>;

    /// Calls a command. Reads are answered from the published state row.
    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal>;

    /// Reads without a command: a state row of a component, or the newest sample of an output; with `frame`
    /// the bytes of a frame, too.
    async fn read(&self, path: String, when: When, frame: bool, deadline: Instant)
    -> Result<Sample, Refusal>;

    /// Follows events, component states and outputs until the receiver is dropped. A slow receiver loses
    /// items, counted in the next item's `skipped`.
    async fn subscribe(&self, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal>;

    /// Live figures of components; those that are not there are left out.
    async fn details(&self, ids: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal>;

    /// Figures of every connection that ends in this process.
    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal>;

    /// Sets the phases of components whose phase was not asked for: to the given ones, of the others to 0;
    /// `None` leaves all as they are. Returns the step times of components that have run long enough to tell.
    /// Waits for no component.
    async fn phases(
        &self,
        _given: Option<Vec<(ComponentId, Phase)>>,
        _deadline: Instant,
    ) -> Result<StepTimes, Refusal> {
        Ok(StepTimes::new())
    }

    /// Lists the plugins in the directories of this process, refused ones too.
    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal>;

    /// Looks again at the plugin files of this name (empty: at all of them) and lists them. Without plugin
    /// directories, nothing is looked at.
    async fn recheck(&self, name: &str, _deadline: Instant) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(self.plugins().await?.into_iter().filter(|plugin| plugin.is_called(name)).collect())
    }

    /// Everything this process has: sent at registration and after a gap in the news.
    async fn inventory(&self) -> Result<Inventory, Refusal>;

    /// Changes that happen without a request; a lagging receiver asks for the inventory again.
    fn news(&self) -> broadcast::Receiver<News>;
}

/// A Stop of all that the targets name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stop {
    pub targets: Vec<Target>,
    /// Number of the last [`StoppedHere`] that the orderer knows of: from now on `Order::decision` holds off
    /// what that one held off.
    pub known_here: u64,
}

/// Stops that the process was asked for itself, past its GCM, which the GCM has not answered with a Stop of
/// its own yet. Until then nothing that they name is set in motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoppedHere {
    /// Counts up with each of them; 0: there is none.
    pub number: u64,
    /// Targets, each with the number of the last Stop that names it.
    pub targets: Vec<(Target, u64)>,
}

/// A component that a Stop named.
#[derive(Clone, Debug)]
pub struct Halted {
    pub id: ComponentId,
    /// Its state when the Stop came.
    pub was: State,
    pub done: Result<Report, Refusal>,
}

/// A connection with one end in this process, and the facts needed about the other end.
#[derive(Clone, Debug)]
pub struct RemoteEnd {
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
    /// `plugin/class`; empty where unknown.
    pub name: String,
    /// Hash of the plugin file, as in [`trocar_model::ClassInfo`].
    pub hash: String,
}

/// State of one component.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    pub id: ComponentId,
    /// Counts up within a run of the process: a higher number was looked up later. 0: not counted.
    pub number: u64,
    pub state: State,
    pub health: Health,
    /// Reason of the FAULT; empty otherwise.
    pub fault: String,
    /// Present when the ports may have changed.
    pub ports: Option<Arc<Ports>>,
    /// Numbers of connections the LCM cut because one of their ports is gone.
    pub lost_connections: Vec<u64>,
    /// Sentences for the caller, e.g. a real-time setting the machine refused; the answer to a change has
    /// only new ones.
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug)]
pub enum News {
    State(Report),
    /// The plugin directories offer this now.
    Catalog(Vec<Arc<ClassInfo>>),
    Log(LogLine),
    Half(HalfReport),
    /// Warnings of the process itself; they replace the earlier ones.
    Warnings(Warnings),
    StoppedHere(StoppedHere),
    /// A change of that decision was done after its orderer had given it up.
    Late(Box<Change>, Decision, Report),
}

/// State of the half of a connection to another process.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfReport {
    pub connection: u64,
    pub end: End,
    /// `None`: it is gone.
    pub proxy: Option<Proxy>,
}

#[derive(Clone, Debug, Default)]
pub struct Inventory {
    /// Way for other processes to reach this one; `None`: there is none.
    pub card: Option<Card>,
    pub components: Vec<Report>,
    pub classes: Vec<Arc<ClassInfo>>,
    /// Halves of connections to other processes.
    pub halves: Vec<HalfReport>,
    pub warnings: Warnings,
    /// The last decision of which it has an order: the GCM counts on from there.
    pub decision: Decision,
    pub stopped_here: StoppedHere,
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
    /// Bytes of the frame, if the caller asked for them.
    pub frame: Vec<u8>,
}

/// One thing to follow: `process/component` (its state), `…/interface/event`, or `…/output`.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    pub path: String,
    /// Most items per second of an output; 0 = 30.
    pub max_rate_hz: f64,
    /// Frames that are images as JPEG of this width, pixels; 0 = header only.
    pub thumbnail_width: u32,
    /// Image of a stereo pair that the JPEG shows.
    pub eye: Eye,
}

/// Images of a stereo pair; other frames have one image, which every eye sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Eye {
    #[default]
    Left,
    Right,
    /// Both side by side, each at half the width that was asked for.
    Both,
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
    /// Lost commands: refused by a full queue, given up for newer ones, or only sent and not run before their
    /// connection was cut.
    pub commands_rejected: u64,
    /// Events lost in its handlers' full queues.
    pub events_dropped: u64,
    /// Place where it runs: "own thread", "stream of host/source", "callers' threads".
    pub thread: String,
    /// True when SCHED_FIFO was granted.
    pub realtime: bool,
    pub warnings: Vec<String>,
    /// Offset of its grid from the multiples of the period, ns; `None` without a grid of its own.
    pub phase_ns: Option<u64>,
    /// True when that phase was not asked for.
    pub phase_auto: bool,
}

#[derive(Clone, Debug, Default)]
pub struct LinkDetail {
    pub connection: u64,
    /// "inline", "heap", "memfd", "net".
    pub carrier: String,
    /// Wake of each end when data or calls arrive: "signal" or "poll"; empty where no thread is woken.
    pub client_wake: &'static str,
    pub server_wake: &'static str,
    pub passed: u64,
    /// Lost in a full queue or for lack of frames; includes `rejected`.
    pub dropped: u64,
    /// Samples replaced by a newer one where only the newest is taken, and commands superseded by a newer one
    /// of their kind: no loss, and not part of `dropped`.
    pub skipped: u64,
    /// Commands and events a full queue did not take.
    pub rejected: u64,
    /// Samples, or commands and as many events, that may wait.
    pub depth: u64,
    /// The most commands or events that ever waited at once.
    pub high_water: u64,
    /// Commands that were only sent, ran and failed.
    pub failed: u64,
    /// Commands that were only sent, and events, that were taken and never ran because of Stop, Disconnect or
    /// Remove.
    pub unexecuted: u64,
    pub bytes: u64,
    /// Between machines: samples, answers, events and rows that the server's end sent, or has to send,
    /// and those that came to the client's end; the others are on their way.
    pub sent: u64,
    pub came: u64,
    /// Between machines: the quickest way there and back of late; 0: none is known.
    pub round_trip_ns: u64,
    /// Between machines: the server's clock less the client's, and the most by which that is wrong.
    pub clock_offset_ns: i64,
    pub clock_bound_ns: u64,
    /// Age of a sample when the client took it.
    pub latency_p50_ns: u64,
    pub latency_p99_ns: u64,
    /// For a connection to another process: the half these figures belong to, or both halves once they are
    /// merged.
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
            sent: self.sent + later.sent,
            came: self.came + later.came,
            round_trip_ns: newest(self.round_trip_ns, later.round_trip_ns),
            clock_offset_ns: if later.round_trip_ns == 0 {
                self.clock_offset_ns
            } else {
                later.clock_offset_ns
            },
            clock_bound_ns: newest(self.clock_bound_ns, later.clock_bound_ns),
            latency_p50_ns: newest(self.latency_p50_ns, later.latency_p50_ns),
            latency_p99_ns: newest(self.latency_p99_ns, later.latency_p99_ns),
            ..self
        }
    }

    /// Merges the figures of both halves of a connection between processes. Figures that both see (the queues
    /// they share) count once; commands and events that never ran wait at different ends.
    pub fn merged(mut self, other: LinkDetail) -> LinkDetail {
        self.halves.extend(other.halves);
        self.halves.sort_by_key(|(end, _)| *end);
        // Each half has read both figures at one time: take both from the later one, so that they belong
        // together.
        let (bytes, passed) = (self.bytes, self.passed).max((other.bytes, other.passed));
        // Between machines each half has a queue of its own.
        let apart = [&self.carrier, &other.carrier].iter().any(|carrier| *carrier == "net");
        let both = |a: u64, b: u64| if apart { a + b } else { a.max(b) };
        LinkDetail {
            connection: self.connection,
            carrier: if self.carrier.is_empty() { other.carrier } else { self.carrier },
            client_wake: if self.client_wake.is_empty() { other.client_wake } else { self.client_wake },
            server_wake: if self.server_wake.is_empty() { other.server_wake } else { self.server_wake },
            passed,
            dropped: both(self.dropped, other.dropped),
            skipped: both(self.skipped, other.skipped),
            rejected: both(self.rejected, other.rejected),
            sent: self.sent.max(other.sent),
            came: self.came.max(other.came),
            round_trip_ns: self.round_trip_ns.max(other.round_trip_ns),
            // The client's end alone tells of clocks.
            clock_offset_ns: self.clock_offset_ns + other.clock_offset_ns,
            clock_bound_ns: self.clock_bound_ns.max(other.clock_bound_ns),
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
    /// Tells whether this is the plugin, or the file, of this name; an empty name matches every plugin.
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
