//! A recorder between Start and Stop: the way to its writer, what it tells of itself, and the recording that
//! is open or planned.
//!
//! Invariant: the writer counts channels as they are counted here, so each is added by [`Running::add`] and
//! nowhere else, and none is removed.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

use trocar_imaging::side;
use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::Value as Json;

use crate::asking::Asking;
use crate::block::Kind;
use crate::explain::Explaining;
use crate::foxglove;
use crate::orders::{Channel, Codec, Ended, Missing, OnItsWay, Opening, Order, Written};
use crate::settings::{RecorderConfig, seconds};
use crate::topic::{Topic, missing};
use crate::way::{Way, way};
use crate::writer::Writer;

/// Kinds of notes, at most: each is a channel of every file to come.
const KINDS: usize = 32;
/// Interval at which the missing samples are told, ns.
pub(crate) const SECOND_NS: u64 = 1_000_000_000;
/// The same while it grows: no more is untold when the process is killed than samples are.
const GROWING_NS: u64 = 20_000_000;
/// Longest delay after acquisition with which a sample is still recognised as late, ns.
const LATEST_NS: u64 = 5_000_000_000;

pub(crate) struct Running {
    pub(crate) way: Way,
    pub(crate) news: Receiver<Ended>,
    /// Progress of the last recording that was planned.
    pub(crate) written: Arc<Written>,
    thread: Option<JoinHandle<()>>,
    /// The writer's channels.
    channels: Vec<Channel>,
    pub(crate) asking: Arc<Asking>,
    pub(crate) explaining: Explaining,
    own: OwnChannels,
    pub(crate) codec: Codec,
    pub(crate) pre_trigger_ns: u64,
    pub(crate) plan: Option<Plan>,
    /// Acquisition time from which samples are in the recording that was begun last, ns.
    since_ns: u64,
    /// When the recording began; 0 = there is none.
    pub(crate) began_ns: u64,
    pub(crate) ends_ns: u64,
    pub(crate) pause_ns: u64,
    pub(crate) paused: bool,
    told_ns: u64,
    /// When progress was shown last, ns.
    pub(crate) shown_ns: u64,
    /// When the step before was; before the first one, when it was started.
    pub(crate) stepped_ns: u64,
    /// Missing samples when the file was told last: lost, interrupted.
    told: (u64, u64),
    /// The same, when the writer was told last for the end of the file.
    told_for_end: (u64, u64),
    /// Held by an `Order::Missing` until it has arrived at the writer.
    telling: OnItsWay,
    markers: u64,
}

/// A recording that begins later: its file is made already.
pub(crate) struct Plan {
    pub(crate) opening: Box<Opening>,
    pub(crate) at_ns: u64,
    pub(crate) duration_ns: u64,
}

/// Channels of what the recorder itself has to tell.
#[derive(Default)]
struct OwnChannels {
    loss: u32,
    markers: u32,
    notes: BTreeMap<String, u32>,
}

impl Running {
    /// With its writer's thread.
    ///
    /// # Errors
    /// There is no thread.
    pub(crate) fn start(host: &Host, cfg: &RecorderConfig) -> Result<Running> {
        let (way, orders, returns) = way(cfg.buffer_mb << 20);
        let (tell, news) = channel();
        let pre_trigger_ns = seconds("pre_trigger_s", cfg.pre_trigger_s)?;
        let hold = (pre_trigger_ns, cfg.pre_trigger_mb << 20);
        let writer = Writer::new(returns, tell, hold);
        let host_of_writer = host.clone();
        let name = host.instance_name().rsplit('/').next().unwrap_or_default().to_owned();
        let (asking, mut asked) = (Arc::new(Asking::default()), None);
        let asks = asking.clone();
        let thread = side::spawn_on_same(&format!("{name} mcap"), move || {
            writer.run(&orders, move || asks.look(&host_of_writer, &mut asked));
        })
        .map_err(|why| format!("no thread to write: {why}"))?;
        let mut run = Running {
            way,
            news,
            written: Arc::default(),
            thread: Some(thread),
            channels: Vec::new(),
            asking,
            explaining: Explaining::default(),
            own: OwnChannels::default(),
            codec: cfg.codec(),
            pre_trigger_ns,
            plan: None,
            since_ns: 0,
            began_ns: 0,
            ends_ns: 0,
            pause_ns: 0,
            paused: false,
            told_ns: 0,
            shown_ns: 0,
            stepped_ns: host.now().ns(),
            told: (0, 0),
            told_for_end: (0, 0),
            telling: OnItsWay::default(),
            markers: 0,
        };
        run.introduce(host, cfg);
        Ok(run)
    }

    /// The recorder's own channels, and what each file says of it.
    fn introduce(&mut self, host: &Host, cfg: &RecorderConfig) {
        let log = foxglove::log();
        self.own.loss = self.add(json_channel("/recorder/loss"));
        self.own.markers = self.add(Channel {
            topic: "/recorder/markers".into(),
            schema: log.name.into(),
            schema_encoding: "protobuf",
            schema_data: log.descriptors,
            encoding: "protobuf",
            metadata: BTreeMap::new(),
        });
        self.explaining.graph = self.add(json_channel("/recorder/graph"));
        self.explaining.config = self.add(json_channel("/recorder/config"));
        self.way.order(Order::Metadata("trocar.clock".into(), clock(host)));
        let recorder = BTreeMap::from([
            ("component".to_owned(), host.instance_name().to_owned()),
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("video".to_owned(), cfg.video.clone()),
        ]);
        self.way.order(Order::Metadata("trocar.recorder".into(), recorder));
    }

    /// Adds a channel to each file from now on and returns its number. One that is there already, as after a
    /// connection was made anew, stays the only one.
    pub(crate) fn add(&mut self, channel: Channel) -> u32 {
        let known = self.channels.iter().position(|old| *old == channel);
        let at = known.unwrap_or_else(|| {
            self.way.order(Order::Channel(Box::new(channel.clone())));
            self.channels.push(channel);
            self.channels.len() - 1
        });
        at as u32
    }

    /// Gives the topic's new name to samples that came before it was known and wait for a recording; in a
    /// recording that goes on, the topic keeps its name.
    pub(crate) fn rename(&mut self, before: &str, now: &str) {
        if before == now || self.began_ns != 0 {
            return;
        }
        for (at, channel) in self.channels.iter_mut().enumerate() {
            let below =
                channel.topic.strip_prefix(before).filter(|rest| rest.is_empty() || rest.starts_with('/'));
            if let Some(below) = below {
                channel.topic = format!("{now}{below}");
                self.way.order(Order::Renamed(at, channel.topic.clone()));
            }
        }
    }

    /// Tells whether the planned time has come, and the topics to be recorded are known.
    pub(crate) fn is_due(&mut self, now_ns: u64) -> bool {
        // Names of recorded topics are known once the graph was told.
        let explained = self.explaining.is_told(now_ns);
        explained && self.plan.as_ref().is_some_and(|plan| plan.at_ns <= now_ns)
    }

    /// From when on samples are in the recording that begins now, ns.
    pub(crate) fn reaches_back_to(&self, now_ns: u64) -> u64 {
        self.plan.as_ref().map_or(now_ns, |plan| plan.opening.since_ns)
    }

    /// Returns the acquisition times of samples that came too late for the last recording, ns.
    pub(crate) fn before(&self) -> Range<u64> {
        self.since_ns.saturating_sub(LATEST_NS)..self.since_ns
    }

    /// Begins the planned recording.
    pub(crate) fn begin(&mut self, host: &Host, now_ns: u64) {
        let Some(plan) = self.plan.take() else { return };
        (self.began_ns, self.since_ns) = (now_ns, plan.opening.since_ns);
        // If its time was since the step before, the duration counts from that time.
        let from_ns = plan.at_ns.max(self.stepped_ns);
        self.ends_ns = if plan.duration_ns == 0 { 0 } else { from_ns + plan.duration_ns };
        (self.pause_ns, self.paused) = (0, false);
        (self.told, self.told_for_end) = ((0, 0), (0, 0));
        (self.told_ns, self.shown_ns, self.markers) = (now_ns, now_ns, 0);
        self.explaining.begin(now_ns, &mut self.way);
        self.way.order(Order::Metadata("trocar.clock".into(), clock(host)));
        self.way.order(Order::Open(plan.opening));
        self.explaining.repeat(now_ns, &mut self.way);
    }

    /// A line at this time.
    ///
    /// # Errors
    /// There is no room for it.
    pub(crate) fn mark(&mut self, now_ns: u64, text: &str, who: &str) -> Result {
        let line = foxglove::log_line(now_ns, text, who);
        self.make_sure(line.len())?;
        self.markers += 1;
        let head = (self.own.markers, self.markers, now_ns, now_ns);
        self.way.block().push(head, Kind::Ready, |to| to.extend_from_slice(&line));
        Ok(())
    }

    /// Checks the room for so many bytes that a client gives the recorder to keep.
    fn make_sure(&self, bytes: usize) -> Result {
        if self.way.has_room(bytes) {
            return Ok(());
        }
        Err("the recorder's buffer is full, since the disk is too slow: say it again, or configure `buffer_mb`".into())
    }

    /// JSON at this time, to the topic of its kind.
    ///
    /// # Errors
    /// There are too many kinds, or there is no room for it.
    pub(crate) fn note(&mut self, now_ns: u64, kind: &str, json: &Json) -> Result {
        let text = json.to_string();
        self.make_sure(text.len())?;
        let channel = match self.own.notes.get(kind) {
            Some(channel) => *channel,
            None if self.own.notes.len() >= KINDS => {
                return Err(format!("kind: there are {KINDS} kinds already: use one of them").into());
            }
            None => {
                let channel = self.add(json_channel(&format!("/recorder/note_{kind}")));
                self.own.notes.insert(kind.to_owned(), channel);
                channel
            }
        };
        let head = (channel, 0, now_ns, now_ns);
        self.way.block().push(head, Kind::Ready, |to| to.extend_from_slice(text.as_bytes()));
        Ok(())
    }

    /// Tells the recording what is missing: each second, at once when a source went away, and more often
    /// while more is lost. Without room it is told as soon as there is room.
    pub(crate) fn watch_loss(&mut self, each: &[Topic], now: (u64, u64), now_ns: u64) {
        let since_ns = now_ns.saturating_sub(self.told_ns);
        let (grew, cut) = (now != self.told, now.1 != self.told.1);
        let due = cut || since_ns >= if grew { GROWING_NS } else { SECOND_NS };
        if due && self.tell_loss(each, now, now_ns) {
            return;
        }
        // The writer may have to close the file at any moment. It is told no faster than it hears, for its
        // disk may stand still.
        if now != self.told_for_end && self.telling.has_arrived() {
            self.tell_for_end(missing(each), now);
        }
    }

    /// Tells what is missing at the end of the recording: in the file if there is room, else for its end.
    pub(crate) fn end_loss(&mut self, each: &[Topic], now: (u64, u64), now_ns: u64) {
        if !self.tell_loss(each, now, now_ns) {
            self.tell_for_end(missing(each), now);
        }
    }

    /// Tells what is missing so far, in the recording and for its end. Returns whether there was room.
    fn tell_loss(&mut self, each: &[Topic], now: (u64, u64), now_ns: u64) -> bool {
        let missing = missing(each);
        let by_topic = |all: &[(String, u64)]| -> Json {
            all.iter().map(|(name, n)| (name.clone(), json!(n))).collect()
        };
        let (lost, interrupted) = (by_topic(&missing.lost), by_topic(&missing.interrupted));
        let total: u64 = missing.lost.iter().map(|(_, n)| n).sum();
        // With the clock on the wall, which may drift from that of the stamps while it records.
        let told = json!({
            "lost": total, "topics": lost, "interrupted": interrupted, "silent": missing.silent,
            "unix_ns": unix_ns() as u64,
        });
        let text = told.to_string();
        if !self.way.has_room(text.len()) {
            return false;
        }
        (self.told, self.told_ns) = (now, now_ns);
        let head = (self.own.loss, 0, now_ns, now_ns);
        self.way.block().push(head, Kind::Ready, |to| to.extend_from_slice(text.as_bytes()));
        self.tell_for_end(missing, now);
        true
    }

    fn tell_for_end(&mut self, missing: Missing, now: (u64, u64)) {
        self.told_for_end = now;
        self.way.order(Order::Missing(missing, self.telling.clone()));
    }

    /// Ends the writer, which closes an open file first; returns its messages that were not read yet.
    pub(crate) fn finish(mut self) -> Vec<Ended> {
        self.way.send();
        let Running { way, news, thread, .. } = self;
        // Without its orders the writer closes an open file and ends.
        drop(way);
        if let Some(thread) = thread {
            let _ = thread.join();
        }
        news.try_iter().collect()
    }
}

fn json_channel(topic: &str) -> Channel {
    Channel {
        topic: topic.to_owned(),
        schema: format!("trocar.json.{}", topic.rsplit('/').next().unwrap_or_default()),
        schema_encoding: "jsonschema",
        schema_data: br#"{"type":"object"}"#.to_vec(),
        encoding: "json",
        metadata: BTreeMap::new(),
    }
}

/// Returns the wall clock's time, ns since 1970.
fn unix_ns() -> i128 {
    let wall = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    wall.map_or(0, |t| t.as_nanos() as i128)
}

/// Returns the relation of the clock of all stamps to the wall clock: the offset between the two, with one
/// read between two readings of the other.
fn clock(host: &Host) -> BTreeMap<String, String> {
    let before = host.now().ns();
    let wall_ns = unix_ns();
    let after = host.now().ns();
    let monotonic_ns = before / 2 + after / 2;
    BTreeMap::from([
        ("clock".to_owned(), "CLOCK_MONOTONIC of the machine, ns; one for all of its processes".to_owned()),
        ("monotonic_ns".to_owned(), monotonic_ns.to_string()),
        ("unix_ns".to_owned(), wall_ns.to_string()),
        ("offset_to_unix_ns".to_owned(), (wall_ns - i128::from(monotonic_ns)).to_string()),
        ("uncertainty_ns".to_owned(), (after - before).to_string()),
    ])
}
