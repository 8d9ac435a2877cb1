//! The component `recorder`: takes what comes by its inputs, and hands it to the thread that writes.
//!
//! Invariant: what is recorded pays one push into its queue; everything else happens in this component's own thread and the
//! writer's. What is not kept is counted.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

use trocar_imaging::side;
use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::Value as Json;

use crate::block::{Kind, Way, way};
use crate::explain::Explaining;
use crate::foxglove;
use crate::orders::{Channel, Codec, News, Opening, Order};
use crate::place;
use crate::topic::{Seen, Topic};
use crate::writer::{Writer, Written};

/// Inputs that need no configuration.
const FIXED: usize = 8;
/// Inputs that are configured, at most.
const TOPICS: usize = 1024;
/// Samples of one input that are taken in one step, so that one flood does not hold up the others.
const AT_ONCE: usize = 8192;
/// Longest name of a file, bytes.
const NAME: usize = 1000;
/// Longest delay, pre-trigger time and duration, s.
const LONGEST_S: f64 = 86_400.0;

named_values! {
    /// What a recorder does.
    pub struct Phase: u32 {
        /// Nothing is recorded.
        IDLE = 0,
        /// A recording begins at a time that was asked for.
        WAITING = 1,
        RECORDING = 2,
        PAUSED = 3,
    }
}

/// What `start` is asked for.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct StartRequest {
    /// The new file, inside of the recorder's directory; it ends with .mcap.
    pub path: Text<1000>,
    /// From now until it begins.
    #[unit("s")]
    pub delay: f64,
    /// How long it records; 0: until it is stopped.
    #[unit("s")]
    pub duration: f64,
}

/// What `record_at` is asked for.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct RecordAt {
    /// As in `start`.
    pub path: Text<1000>,
    /// When it begins, on the host's clock.
    pub at: Stamp,
    /// How long it records; 0: until it is stopped.
    #[unit("s")]
    pub duration: f64,
}

/// Words about the graph, a setting, anything: what a recording is to be told.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Note {
    /// What it is about; becomes the topic /recorder/note/KIND.
    pub kind: Text<64>,
    /// JSON.
    pub json: Text<16000>,
}

/// How much of a topic is kept.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Thinning {
    /// The input.
    pub input: Text<64>,
    /// Each so many-th sample; 1: all.
    pub every: u64,
    /// At most so many per second; 0: all.
    #[unit("Hz")]
    pub max_rate: f64,
}

/// A recording in numbers.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Progress {
    pub phase: Phase,
    /// Inputs by which something came.
    pub topics: u32,
    /// In the file.
    pub messages: u64,
    /// Of the file.
    #[unit("B")]
    pub bytes: u64,
    /// Samples that should be in it and are not.
    pub lost: u64,
    /// Since it began.
    #[unit("s")]
    pub elapsed: f64,
}

/// The end of a recording.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Stopped {
    pub path: Text<1000>,
    /// Why.
    pub reason: Text<240>,
    pub messages: u64,
    #[unit("B")]
    pub bytes: u64,
    pub lost: u64,
    /// It has its index and its end.
    pub whole: Flag,
    pub reserved: [u8; 7],
}

/// One topic in numbers.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct TopicStatus {
    /// As in the file.
    pub topic: Text<240>,
    /// The input.
    pub input: Text<64>,
    pub kept: u64,
    /// Left out because less was asked for.
    pub left_out: u64,
    pub lost: u64,
    #[unit("B")]
    pub bytes: u64,
}

#[derive(Config)]
struct RecorderConfig {
    /// Where recordings are made; nothing outside of it is written
    #[config(default = ".")]
    directory: String,
    /// A file to record to as soon as it is started; "" waits for `start`
    #[config(default = "")]
    path: String,
    /// Names of the inputs; connect each to an output
    #[config(default = [])]
    topics: Vec<String>,
    /// What is connected to each of them, `process/component/port`: how its topic is called; nothing: the graph is asked
    #[config(default = [])]
    sources: Vec<String>,
    /// Of each input only every so many-th sample is kept; nothing: all
    #[config(default = [])]
    every: Vec<u64>,
    /// Of each input at most so many samples per second are kept; 0 or nothing: all
    #[config(default = [])]
    max_rate_hz: Vec<f64>,
    /// How video is kept: as it is, smaller without loss, or as JPEG
    #[config(default = "raw", one_of = ["raw", "qoi", "jpeg"])]
    video: String,
    /// Quality of JPEG, from 1 to 100
    #[config(min = 1, max = 100, default = 85)]
    jpeg_quality: u32,
    /// How much of the time before `start` is kept and recorded, too
    #[config(min = 0.0, max = 3600.0, unit = "s", default = 0.0)]
    pre_trigger_s: f64,
    /// Memory for what is kept before `start`; where it is not enough, the oldest gives way
    #[config(min = 1, max = 65536, unit = "MB", default = 512)]
    pre_trigger_mb: u64,
    /// Memory for what waits to be written; what finds none is lost, and counted
    #[config(min = 8, max = 65536, unit = "MB", default = 256)]
    buffer_mb: u64,
}

/// Records what its inputs are connected to, samples and frames of any type and process, to MCAP files.
#[derive(Component)]
#[component(rate_hz = 100, provides("ctl"), max_step_ms = 5000)]
pub struct Recorder {
    /// What is recorded
    #[input(name = "{}", fifo = 1024, optional)]
    topics: Many<AnyIn>,
    /// What is recorded, too: inputs that are there without being configured, for system files
    #[input(optional, fifo = 1024)]
    in_1: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_2: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_3: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_4: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_5: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_6: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_7: AnyIn,
    /// As `in_1`
    #[input(optional, fifo = 1024)]
    in_8: AnyIn,
    /// Once per second while it records.
    #[event("ctl")]
    progress: Event<Progress>,
    /// A recording has ended, by itself or because it was asked for.
    #[event("ctl")]
    stopped: Event<Stopped>,
    /// The recording in numbers.
    #[state]
    status: Progress,
    /// The recording's file; empty without one.
    #[state]
    path: Text<1000>,
    /// The last end of a recording.
    #[state]
    last: Stopped,
    #[config]
    cfg: RecorderConfig,
    #[host]
    host: Host,
    run: Option<Running>,
    /// What is known of each input; as many as inputs.
    each: Vec<Topic>,
    /// Their names.
    fitted: Vec<String>,
}

/// Between Start and Stop.
struct Running {
    way: Way,
    news: Receiver<News>,
    written: Arc<Written>,
    thread: Option<JoinHandle<()>>,
    /// Channels so far: the writer counts them alike.
    channels: u32,
    explaining: Explaining,
    own: OwnChannels,
    codec: Codec,
    pre_trigger_ns: u64,
    plan: Option<Plan>,
    /// When the recording began; 0 = there is none.
    began_ns: u64,
    ends_ns: u64,
    pause_ns: u64,
    paused: bool,
    told_ns: u64,
    markers: u64,
}

/// A recording that begins later: its file is made already.
struct Plan {
    opening: Box<Opening>,
    at_ns: u64,
    duration_ns: u64,
}

/// Channels of what the recorder itself has to tell.
struct OwnChannels {
    loss: u32,
    markers: u32,
    notes: BTreeMap<String, u32>,
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

fn add(way: &mut Way, channels: &mut u32, channel: Channel) -> u32 {
    way.order(Order::Channel(Box::new(channel)));
    *channels += 1;
    *channels - 1
}

fn seconds(what: &str, s: f64) -> Result<u64> {
    if s.is_finite() && (0.0..=LONGEST_S).contains(&s) {
        return Ok((s * 1e9) as u64);
    }
    Err(format!("{what}: {s} s is not between 0 s and {LONGEST_S} s").into())
}

#[provides("ctl")]
impl Recorder {
    /// Makes the file and begins to record, with what was kept from before.
    #[command(name = "start")]
    fn start_recording(&mut self, request: &StartRequest) -> Result {
        let delay = seconds("delay", request.delay)?;
        let duration = seconds("duration", request.duration)?;
        let now_ns = self.host.now().ns();
        self.plan(&request.path, now_ns + delay, duration)
    }

    /// Makes the file now, and begins to record at that time.
    #[command]
    fn record_at(&mut self, request: &RecordAt) -> Result {
        let duration = seconds("duration", request.duration)?;
        self.in_time("at", request.at)?;
        self.plan(&request.path, request.at.ns(), duration)
    }

    /// Ends the recording and closes its file.
    #[command(name = "stop")]
    fn stop_recording(&mut self) -> Result {
        let run = self.run.as_mut().ok_or(NOT_RUNNING)?;
        if run.began_ns == 0 && run.plan.is_none() {
            return Err("nothing is recorded: there is nothing to stop".into());
        }
        self.end("stopped as asked");
        Ok(())
    }

    /// Leaves out what comes from now on, until `resume`. That is no loss.
    #[command]
    fn pause(&mut self) -> Result {
        self.recording()?.paused = true;
        Ok(())
    }

    /// Pauses at that time.
    #[command]
    fn pause_at(&mut self, at: Stamp) -> Result {
        self.in_time("at", at)?;
        self.recording()?.pause_ns = at.ns();
        Ok(())
    }

    /// Goes on after a pause.
    #[command(name = "resume")]
    fn resume_recording(&mut self) -> Result {
        let run = self.recording()?;
        (run.paused, run.pause_ns) = (false, 0);
        Ok(())
    }

    /// Puts a line into the recording, at this time.
    #[command]
    fn marker(&mut self, text: &Text<1000>) -> Result {
        let (now_ns, who) = (self.host.now().ns(), self.host.instance_name().to_owned());
        let run = self.recording()?;
        run.markers += 1;
        let line = foxglove::log_line(now_ns, text, &who);
        let head = (run.own.markers, run.markers, now_ns, now_ns);
        run.way.block().push(head, Kind::Ready, |to| to.extend_from_slice(&line));
        Ok(())
    }

    /// Puts a note of any kind into this recording and those that follow.
    #[command]
    fn annotate(&mut self, note: &Note) -> Result {
        let json: Json = trocar_sdk::serde_json::from_str(&note.json)
            .map_err(|e| format!("json: is no JSON: {e}; give an object"))?;
        if !json.is_object() {
            return Err("json: is no object: put it into one, such as {\"value\": 1}".into());
        }
        let kind: String = note.kind.to_string();
        if kind.is_empty() || !kind.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(format!("kind: {kind:?} is no name: letters, digits and _ are").into());
        }
        let now_ns = self.host.now().ns();
        let run = self.run.as_mut().ok_or(NOT_RUNNING)?;
        if run.own.notes.len() >= 32 && !run.own.notes.contains_key(&kind) {
            return Err("kind: there are 32 kinds already: use one of them".into());
        }
        let Running { own, way, channels, .. } = run;
        let topic = format!("/recorder/note/{kind}");
        let channel = *own.notes.entry(kind).or_insert_with(|| add(way, channels, json_channel(&topic)));
        let text = json.to_string();
        way.block()
            .push((channel, 0, now_ns, now_ns), Kind::Ready, |to| to.extend_from_slice(text.as_bytes()));
        Ok(())
    }

    /// Keeps less, or again all, of one input.
    #[command]
    fn thin(&mut self, thinning: &Thinning) -> Result {
        let Thinning { input, every, max_rate } = thinning;
        let names = self.inputs();
        let Some(at) = names.iter().position(|name| **name == **input) else {
            let there = &names[..names.len().min(20)];
            return Err(format!(
                "input: there is no input {:?}; there is {}",
                input.to_string(),
                there.join(", ")
            )
            .into());
        };
        let gap_ns = gap("max_rate", *max_rate)?;
        if *every == 0 {
            return Err("every: 0 keeps nothing; 1 keeps all".into());
        }
        if let Some(topic) = self.each.get_mut(at) {
            (topic.every, topic.gap_ns) = (*every, gap_ns);
        }
        Ok(())
    }

    /// One input in numbers, counted from 0.
    #[command]
    fn topic(&mut self, at: u32) -> Result<TopicStatus> {
        let (Some(topic), Some(input)) = (self.each.get(at as usize), self.fitted.get(at as usize)) else {
            return Err(format!("at: there is no input {at}; there are {}", self.each.len()).into());
        };
        Ok(TopicStatus {
            topic: Text::new(&topic.name),
            input: Text::new(input),
            kept: topic.kept,
            left_out: topic.left_out,
            lost: topic.lost,
            bytes: topic.bytes,
        })
    }

    /// The recording in numbers.
    #[read]
    fn status(s: &RecorderState) -> Progress {
        s.status
    }

    /// The file that is written; empty without one.
    #[read]
    fn path(s: &RecorderState) -> Text<1000> {
        s.path
    }

    /// The last end of a recording.
    #[read]
    fn last(s: &RecorderState) -> Stopped {
        s.last
    }
}

const NOT_RUNNING: &str = "the recorder is not started: start the component first";

/// The least time between two samples at a rate.
fn gap(what: &str, rate_hz: f64) -> Result<u64> {
    if rate_hz == 0.0 {
        return Ok(0);
    }
    if rate_hz.is_finite() && (1e-4..=1e6).contains(&rate_hz) {
        // A grid that is as fast as asked for has a little jitter: half a per cent less is not too soon.
        return Ok((0.995e9 / rate_hz) as u64);
    }
    Err(format!("{what}: {rate_hz} Hz is no rate: give 0.0001 Hz to 1000000 Hz, or 0 for all").into())
}

impl Recorder {
    fn in_time(&self, what: &str, at: Stamp) -> Result {
        let now = self.host.now();
        let late = now.seconds_since(at);
        if !at.is_valid() || late > 0.0 {
            return Err(format!("{what}: is {late:.3} s ago: name a time to come").into());
        }
        if at.is_ahead_of(now, LONGEST_S) {
            return Err(
                format!("{what}: is further away than {LONGEST_S} s: name a time within a day").into()
            );
        }
        Ok(())
    }

    fn recording(&mut self) -> Result<&mut Running> {
        let run = self.run.as_mut().ok_or(NOT_RUNNING)?;
        if run.began_ns == 0 {
            return Err("nothing is recorded: `start` a recording first".into());
        }
        Ok(run)
    }

    fn plan(&mut self, path: &str, at_ns: u64, duration_ns: u64) -> Result {
        if path.len() >= NAME {
            return Err(format!("path: has {} bytes: {NAME} are too many", path.len()).into());
        }
        let run = self.run.as_mut().ok_or(NOT_RUNNING)?;
        if run.began_ns != 0 || run.plan.is_some() {
            let what = if run.began_ns != 0 { "is recorded" } else { "waits for its time" };
            return Err(format!("{:?} {what}: `stop` it first", self.path.to_string()).into());
        }
        let (file, path) = place::make(&self.cfg.directory, path)?;
        self.path = Text::new(&path.display().to_string());
        let since_ns = at_ns.saturating_sub(run.pre_trigger_ns);
        let opening = Box::new(Opening { file, path, codec: run.codec, since_ns });
        run.plan = Some(Plan { opening, at_ns, duration_ns });
        self.status.phase = Phase::WAITING;
        Ok(())
    }

    /// Closes what is open; the writer tells when it is done.
    fn end(&mut self, why: &str) {
        let Some(run) = &mut self.run else { return };
        if let Some(plan) = run.plan.take() {
            // Nothing is in it: it does not stay.
            let _ = std::fs::remove_file(&plan.opening.path);
            self.path = Text::default();
        }
        if run.began_ns != 0 {
            run.tell_loss(&self.each, self.host.now().ns());
            run.way.order(Order::Close(why.to_owned()));
        }
        (run.began_ns, run.ends_ns, run.pause_ns, run.paused) = (0, 0, 0, false);
        self.status.phase = Phase::IDLE;
    }

    /// The names of all inputs, the configured ones first.
    fn inputs(&self) -> Vec<String> {
        let fixed = (1..=FIXED).map(|n| format!("in_{n}"));
        self.topics.names().iter().map(str::to_owned).chain(fixed).collect()
    }

    /// Sees to it that there is one of `each` for each input, with the settings of now.
    fn fit(&mut self) {
        let names = self.inputs();
        let fitted = std::mem::replace(&mut self.fitted, names.clone());
        let mut old: BTreeMap<String, Topic> =
            fitted.into_iter().zip(std::mem::take(&mut self.each)).collect();
        let who = self.host.instance_name().to_owned();
        for name in names {
            let mut topic = old.remove(&name).unwrap_or_default();
            let at = self.cfg.topics.iter().position(|other| *other == name).unwrap_or(usize::MAX);
            match self.cfg.sources.get(at).filter(|source| !source.is_empty()) {
                Some(source) => topic.rename(&format!("/{}", source.trim_start_matches('/'))),
                None if topic.name.is_empty() => topic.rename(&format!("/{who}/{name}")),
                None => {}
            }
            topic.every = self.cfg.every.get(at).copied().unwrap_or(1).max(1);
            topic.gap_ns =
                self.cfg.max_rate_hz.get(at).and_then(|rate| gap("", *rate).ok()).unwrap_or_default();
            self.each.push(topic);
        }
    }

    fn check(&self) -> Result {
        let cfg = &self.cfg;
        if cfg.topics.len() > TOPICS {
            return Err(
                format!("topics: {} are too many, there is room for {TOPICS}", cfg.topics.len()).into()
            );
        }
        for (key, len) in [
            ("sources", cfg.sources.len()),
            ("every", cfg.every.len()),
            ("max_rate_hz", cfg.max_rate_hz.len()),
        ] {
            if len > cfg.topics.len() {
                let topics = cfg.topics.len();
                return Err(format!("{key}: {len} items for {topics} topics: give as many, or fewer").into());
            }
        }
        if let Some(at) = cfg.every.iter().position(|every| *every == 0) {
            return Err(format!("every[{at}]: 0 keeps nothing; 1 keeps all").into());
        }
        for (at, rate) in cfg.max_rate_hz.iter().enumerate() {
            gap(&format!("max_rate_hz[{at}]"), *rate)?;
        }
        Ok(())
    }

    /// What came by the inputs since the last step.
    fn drain(&mut self, recording: bool) {
        let Some(run) = &mut self.run else { return };
        let wanted = (recording && !run.paused) || (run.began_ns == 0 && run.pre_trigger_ns > 0);
        let fixed = [
            &mut self.in_1,
            &mut self.in_2,
            &mut self.in_3,
            &mut self.in_4,
            &mut self.in_5,
            &mut self.in_6,
            &mut self.in_7,
            &mut self.in_8,
        ];
        for (input, topic) in self.topics.ports_mut().chain(fixed).zip(&mut self.each) {
            for _ in 0..AT_ONCE {
                let Some(view) = input.next() else { break };
                let seen = Seen::of(&view);
                if !wanted {
                    topic.pass(&seen);
                    continue;
                }
                let source = view.source();
                if topic.is_known(source) {
                    topic.take(&seen, self.host.now().ns(), &mut run.way);
                    continue;
                }
                // The first of a connection: its type can be asked for only when the sample is put aside.
                let (value, bytes) = (seen.value.to_vec(), seen.bytes.to_vec());
                let (stamp_ns, seq) = (seen.stamp_ns, seen.seq);
                let description = input.type_json().unwrap_or_default();
                let seen = Seen { value: &value, bytes: &bytes, stamp_ns, seq };
                let Running { way, channels, codec, .. } = run;
                let mut adding = |channel| add(way, channels, channel);
                topic.connected(source, &description, (*codec, &seen), &mut adding);
                topic.take(&seen, self.host.now().ns(), &mut run.way);
            }
        }
    }

    /// What the writer has told.
    fn hear(&mut self) {
        let Some(run) = &mut self.run else { return };
        while let Ok(News::Ended { why, path, messages, bytes, whole }) = run.news.try_recv() {
            let lost = self.each.iter().map(|topic| topic.lost).sum();
            self.last = Stopped {
                path: Text::new(&path.display().to_string()),
                reason: Text::new(&why),
                messages,
                bytes,
                lost,
                whole: whole.into(),
                reserved: [0; 7],
            };
            if !whole || why == crate::writer::FULL {
                log::warn!("the recording {} has ended: {why}", path.display());
            }
            self.stopped.emit(self.last);
            if run.plan.is_none() && *self.path == *path.display().to_string() {
                // It ended by itself, or was ended: nothing is recorded until it is asked for.
                run.began_ns = 0;
                self.status.phase = Phase::IDLE;
                self.path = Text::default();
            }
        }
    }
}

impl Running {
    fn tell_loss(&mut self, each: &[Topic], now_ns: u64) {
        let lost: Vec<(String, u64)> =
            each.iter().filter(|t| t.lost > 0).map(|t| (t.name.clone(), t.lost)).collect();
        let by_topic: Json = lost.iter().map(|(name, n)| (name.clone(), json!(n))).collect();
        let total: u64 = lost.iter().map(|(_, n)| n).sum();
        let text = json!({ "lost": total, "topics": by_topic }).to_string();
        let head = (self.own.loss, 0, now_ns, now_ns);
        self.way.block().push(head, Kind::Ready, |to| to.extend_from_slice(text.as_bytes()));
        self.way.order(Order::Lost(lost));
    }
}

impl Component for Recorder {
    fn configure(&mut self) -> Result {
        self.check()?;
        self.topics.set(&self.cfg.topics)?;
        self.fit();
        Ok(())
    }

    fn ports_changed(&mut self) {
        self.fit();
    }

    fn start(&mut self) -> Result {
        self.run = None;
        self.fit();
        let codec = match self.cfg.video.as_str() {
            "qoi" => Codec::Qoi,
            "jpeg" => Codec::Jpeg(self.cfg.jpeg_quality.clamp(1, 100) as u8),
            _ => Codec::Raw,
        };
        let (way, orders, returns) = way(self.cfg.buffer_mb << 20);
        let (tell, news) = channel();
        let written = Arc::new(Written::default());
        let pre_trigger_ns = seconds("pre_trigger_s", self.cfg.pre_trigger_s)?;
        let hold = (pre_trigger_ns, self.cfg.pre_trigger_mb << 20);
        let writer = Writer::new(returns, tell, written.clone(), hold);
        let host = self.host.clone();
        let name = self.host.instance_name().rsplit('/').next().unwrap_or_default().to_owned();
        let mut looks = 0u32;
        let thread = side::spawn(&format!("{name} mcap"), move || {
            writer.run(&orders, move || {
                // What the graph is now; the step may not ask.
                if looks.is_multiple_of(10) {
                    let fields = json!({ "brief": true, "classes": looks == 0 });
                    // One that is not taken is asked again in a second.
                    let _ = host.services().ask("List", fields);
                }
                looks = looks.wrapping_add(1);
            });
        })
        .map_err(|why| format!("no thread to write: {why}"))?;
        let mut run = Running {
            way,
            news,
            written,
            thread: Some(thread),
            channels: 0,
            explaining: Explaining::default(),
            own: OwnChannels { loss: 0, markers: 0, notes: BTreeMap::new() },
            codec,
            pre_trigger_ns,
            plan: None,
            began_ns: 0,
            ends_ns: 0,
            pause_ns: 0,
            paused: false,
            told_ns: 0,
            markers: 0,
        };
        self.each.iter_mut().for_each(Topic::forget);
        let markers = foxglove::log();
        let Running { own, way, channels, explaining, .. } = &mut run;
        own.loss = add(way, channels, json_channel("/recorder/loss"));
        let markers = Channel {
            topic: "/recorder/markers".into(),
            schema: markers.name.into(),
            schema_encoding: "protobuf",
            schema_data: markers.descriptors,
            encoding: "protobuf",
            metadata: BTreeMap::new(),
        };
        own.markers = add(way, channels, markers);
        explaining.graph = add(way, channels, json_channel("/recorder/graph"));
        explaining.config = add(way, channels, json_channel("/recorder/config"));
        way.order(Order::Metadata("trocar.clock".into(), clock(&self.host)));
        way.order(Order::Metadata(
            "trocar.recorder".into(),
            BTreeMap::from([
                ("component".to_owned(), self.host.instance_name().to_owned()),
                ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
                ("video".to_owned(), self.cfg.video.clone()),
            ]),
        ));
        self.run = Some(run);
        self.path = Text::default();
        self.status = Progress::default();
        if !self.cfg.path.is_empty() {
            let path = self.cfg.path.clone();
            let now_ns = self.host.now().ns();
            self.plan(&path, now_ns, 0)?;
        }
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.drain_and_end();
        Ok(())
    }

    fn resume(&mut self) -> Result {
        Component::start(self)
    }

    fn answered(&mut self, reply: ServiceReply) -> Result {
        let now_ns = self.host.now().ns();
        let who = self.host.instance_name().to_owned();
        let Some(run) = &mut self.run else { return Ok(()) };
        if !reply.ok || !reply.response["components"].is_array() {
            return Ok(());
        }
        for (input, server) in run.explaining.connected(&reply.response, &who) {
            let configured = self.cfg.topics.iter().position(|name| *name == input);
            let said = configured.and_then(|at| self.cfg.sources.get(at)).is_some_and(|s| !s.is_empty());
            let at = self.fitted.iter().position(|name| *name == input);
            if let Some(topic) = at.and_then(|at| self.each.get_mut(at))
                && !said
            {
                topic.rename(&format!("/{server}"));
            }
        }
        run.explaining.graph_is(reply.response, now_ns, &mut run.way);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now_ns = tick.now().ns();
        self.hear();
        let Some(run) = &mut self.run else { return Ok(()) };
        // What is recorded is known by name once the graph was told; a second is enough to tell it.
        let explained = run.explaining.is_told(now_ns);
        if explained
            && run.plan.as_ref().is_some_and(|plan| plan.at_ns <= now_ns)
            && let Some(plan) = run.plan.take()
        {
            self.each.iter_mut().for_each(Topic::begin);
            run.began_ns = now_ns;
            run.ends_ns = if plan.duration_ns == 0 { 0 } else { now_ns + plan.duration_ns };
            (run.told_ns, run.markers) = (now_ns, 0);
            run.explaining.begin(now_ns, &mut run.way);
            run.way.order(Order::Metadata("trocar.clock".into(), clock(&self.host)));
            run.way.order(Order::Open(plan.opening));
            run.explaining.repeat(now_ns, &mut run.way);
        }
        if run.pause_ns != 0 && run.pause_ns <= now_ns {
            (run.paused, run.pause_ns) = (true, 0);
        }
        let recording = run.began_ns != 0;
        self.drain(recording);
        let Some(run) = &mut self.run else { return Ok(()) };
        run.way.send();
        self.status = Progress {
            phase: match (recording, run.paused, &run.plan) {
                (true, true, _) => Phase::PAUSED,
                (true, false, _) => Phase::RECORDING,
                (false, _, Some(_)) => Phase::WAITING,
                (false, _, None) => Phase::IDLE,
            },
            topics: self.each.iter().filter(|topic| topic.kept + topic.lost + topic.left_out > 0).count()
                as u32,
            messages: run.written.messages.load(Ordering::Relaxed),
            bytes: run.written.bytes.load(Ordering::Relaxed),
            lost: self.each.iter().map(|topic| topic.lost).sum(),
            elapsed: if recording { now_ns.saturating_sub(run.began_ns) as f64 * 1e-9 } else { 0.0 },
        };
        if recording && now_ns.saturating_sub(run.told_ns) >= 1_000_000_000 {
            run.told_ns = now_ns;
            run.tell_loss(&self.each, now_ns);
            self.progress.emit(self.status);
        }
        if recording && run.ends_ns != 0 && run.ends_ns <= now_ns {
            self.end("its time was over");
        }
        Ok(())
    }
}

impl Recorder {
    fn drain_and_end(&mut self) {
        let recording = self.run.as_ref().is_some_and(|run| run.began_ns != 0);
        if recording {
            self.drain(true);
        }
        self.end("the recorder was stopped");
        let Some(run) = &mut self.run else { return };
        run.way.send();
        let thread = run.thread.take();
        // Without its orders the writer closes what is open and ends.
        let Some(run) = self.run.take() else { return };
        drop(run.way);
        if let Some(thread) = thread {
            let _ = thread.join();
        }
        let ended = run.news.try_iter().last();
        if let Some(News::Ended { why, path, messages, bytes, whole }) = ended {
            self.last = Stopped {
                path: Text::new(&path.display().to_string()),
                reason: Text::new(&why),
                messages,
                bytes,
                lost: self.each.iter().map(|topic| topic.lost).sum(),
                whole: whole.into(),
                reserved: [0; 7],
            };
            self.stopped.emit(self.last);
        }
        self.path = Text::default();
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.drain_and_end();
    }
}

/// What the clock of all stamps is on the wall: the offset between the two, read between two readings.
fn clock(host: &Host) -> BTreeMap<String, String> {
    let before = host.now().ns();
    let wall = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let after = host.now().ns();
    let wall_ns = wall.map_or(0, |t| t.as_nanos() as i128);
    let monotonic_ns = before / 2 + after / 2;
    BTreeMap::from([
        ("clock".to_owned(), "CLOCK_MONOTONIC of the machine, ns; one for all of its processes".to_owned()),
        ("monotonic_ns".to_owned(), monotonic_ns.to_string()),
        ("unix_ns".to_owned(), wall_ns.to_string()),
        ("offset_to_unix_ns".to_owned(), (wall_ns - i128::from(monotonic_ns)).to_string()),
        ("uncertainty_ns".to_owned(), (after - before).to_string()),
    ])
}
