//! The component `recorder`: takes the samples of its inputs, and hands them to the thread that writes.
//!
//! Invariant: a source that is recorded pays one push into its queue, behind its steps; everything else
//! happens in this component's own thread and the writer's. Samples that are not kept are counted.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::Value as Json;

use crate::explain::{self, Connected, Explaining};
use crate::orders::{Ended, Opening, Order};
use crate::place;
use crate::running::{Plan, Running, SECOND_NS};
use crate::seen::Seen;
use crate::settings::{LONGEST_S, RecorderConfig, rate_limit, seconds};
use crate::topic::Topic;
use crate::words::{Note, Phase, Progress, RecordAt, StartRequest, Stopped, Thinning, TopicStatus};

/// Inputs that need no configuration.
const FIXED: usize = 8;
/// Samples of one input that are taken in one step, so that one flood does not hold up the others.
const AT_ONCE: usize = 8192;
/// Longest name of a file, bytes.
const NAME: usize = 1000;

/// Records what its inputs are connected to, samples and frames of any type and process, to MCAP files.
#[derive(Component)]
#[component(rate_hz = 100, provides("ctl"), max_step_ms = 5000)]
pub struct Recorder {
    /// The outputs to record
    #[input(name = "{}", fifo = 1024, optional)]
    topics: Many<AnyIn>,
    /// More outputs to record: inputs that are there without being configured, for system files
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
    /// State of each input; as many as inputs.
    each: Vec<Topic>,
    /// Their names.
    fitted: Vec<String>,
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
        self.catch_up();
        self.end("stopped as asked");
        Ok(())
    }

    /// Leaves out what comes from now on, until `resume`. That is no loss.
    #[command]
    fn pause(&mut self) -> Result {
        self.recording()?;
        self.catch_up();
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
        self.recording()?;
        self.catch_up();
        let run = self.recording()?;
        (run.paused, run.pause_ns) = (false, 0);
        Ok(())
    }

    /// Puts a line into the recording, at this time.
    #[command]
    fn marker(&mut self, text: &Text<1000>) -> Result {
        let (now_ns, who) = (self.host.now().ns(), self.host.instance_name().to_owned());
        let run = self.recording()?;
        run.mark(now_ns, text, &who)
    }

    /// Puts a note of any kind into the recording, at this time.
    #[command]
    fn annotate(&mut self, note: &Note) -> Result {
        let json: Json = trocar_sdk::serde_json::from_str(&note.json)
            .map_err(|e| format!("json: not valid JSON: {e}; give an object"))?;
        if !json.is_object() {
            return Err("json: is no object: put it into one, such as {\"value\": 1}".into());
        }
        let kind: String = note.kind.to_string();
        if kind.is_empty() || !kind.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
            return Err(format!("kind: {kind:?} is no name: letters, digits and _ are").into());
        }
        let now_ns = self.host.now().ns();
        self.recording()?.note(now_ns, &kind, &json)
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
        let rate = rate_limit("max_rate", *max_rate)?;
        if *every == 0 {
            return Err("every: 0 keeps nothing; 1 keeps all".into());
        }
        if let Some(topic) = self.each.get_mut(at) {
            (topic.every, topic.rate) = (*every, rate);
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
            interrupted: topic.interrupted,
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

/// Why a recording ended whose time had not come; `trocar record` knows these words.
const NOT_BEGUN: &str = "stopped before it began: there is no file";
const NOT_RUNNING: &str = "the recorder is not started: start the component first";

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
        run.written = Arc::default();
        let opening =
            Box::new(Opening { file, path, codec: run.codec, since_ns, written: run.written.clone() });
        run.plan = Some(Plan { opening, at_ns, duration_ns });
        self.status.phase = Phase::WAITING;
        Ok(())
    }

    /// Closes what is open; the writer tells when it is done.
    fn end(&mut self, why: &str) {
        let Some(run) = &mut self.run else { return };
        if let Some(plan) = run.plan.take() {
            // Nothing is in it: it does not stay.
            let path = plan.opening.path;
            let _ = std::fs::remove_file(&path);
            self.path = Text::default();
            self.last = Stopped {
                path: Text::new(&path.display().to_string()),
                reason: Text::new(NOT_BEGUN),
                ..Stopped::default()
            };
            self.stopped.emit(self.last);
        }
        let Some(run) = &mut self.run else { return };
        if run.began_ns != 0 {
            let now_ns = self.host.now().ns();
            let fixed = [
                &self.in_1, &self.in_2, &self.in_3, &self.in_4, &self.in_5, &self.in_6, &self.in_7,
                &self.in_8,
            ];
            let cut = self.topics.ports().chain(fixed).map(|input| input.type_json().is_none());
            let cut = self.each.iter_mut().zip(cut).filter(|(_, cut)| *cut);
            cut.for_each(|(topic, _)| topic.is_cut(now_ns));
            let sum = |count: fn(&Topic) -> u64| self.each.iter().map(count).sum();
            let missing = (sum(|topic| topic.lost), sum(|topic| topic.interrupted));
            run.end_loss(&self.each, missing, now_ns);
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
            let rate = self.cfg.max_rate_hz.get(at).and_then(|rate| rate_limit("", *rate).ok());
            topic.rate = rate.unwrap_or_default();
            self.each.push(topic);
        }
    }

    /// Handles what has come so far, before a command changes what happens to later samples.
    fn catch_up(&mut self) {
        let Some(run) = &self.run else { return };
        let (recording, before) = (run.began_ns != 0, run.before());
        self.drain(recording, &[before]);
    }

    /// Takes what came by the inputs since the last step, except for samples acquired at times `beside` the
    /// recording, ns.
    fn drain(&mut self, recording: bool, beside: &[Range<u64>]) {
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
                // Samples that wait for a recording to begin may wait for long.
                let seen = Seen::of(&view, recording);
                if !wanted || beside.iter().any(|times| times.contains(&seen.stamp_ns)) {
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
                let seen = Seen::copied(&value, &bytes, stamp_ns, seq);
                let codec = run.codec;
                topic.connected(source, &description, (codec, &seen), &mut |channel| run.add(channel));
                topic.take(&seen, self.host.now().ns(), &mut run.way);
            }
        }
    }

    /// Handles the messages of the writer.
    fn hear(&mut self) {
        let Some(run) = &mut self.run else { return };
        let all: Vec<Ended> = run.news.try_iter().collect();
        for ended in all {
            self.tell_end(&ended);
            let Some(run) = &mut self.run else { return };
            if run.plan.is_none() && self.path == self.last.path {
                // The recording ended by itself, or was ended: nothing is recorded until it is asked for.
                run.began_ns = 0;
                self.status.phase = Phase::IDLE;
                self.path = Text::default();
            }
        }
    }
}

impl Recorder {
    fn tell_end(&mut self, Ended { why, path, messages, bytes, lost, interrupted, whole }: &Ended) {
        if !whole || why == crate::writer::FULL {
            log::warn!("the recording {} has ended: {why}", path.display());
        }
        self.last = Stopped {
            path: Text::new(&path.display().to_string()),
            reason: Text::new(why),
            messages: *messages,
            bytes: *bytes,
            lost: *lost,
            whole: (*whole).into(),
            reserved: [0; 7],
            interrupted: *interrupted,
        };
        self.stopped.emit(self.last);
    }
}

impl Component for Recorder {
    fn configure(&mut self) -> Result {
        self.cfg.check()?;
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
        let run = Running::start(&self.host, &self.cfg)?;
        self.each.iter_mut().for_each(Topic::forget);
        self.run = Some(run);
        self.path = Text::default();
        self.status = Progress::default();
        if !self.cfg.path.is_empty() {
            let path = self.cfg.path.clone();
            let now_ns = self.host.now().ns();
            if let Err(why) = self.plan(&path, now_ns, 0) {
                // The recorder does not start: nothing of the run may stay.
                self.drain_and_end();
                return Err(why);
            }
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
        let told = reply.ok && reply.response["components"].is_array();
        if !told || !run.explaining.knows_classes(&reply.response) {
            run.asking.want_classes();
        }
        run.asking.answered(reply.response["etag"].as_str().unwrap_or_default());
        if !told || !run.explaining.is_news(&reply.response) {
            return Ok(());
        }
        let connected = Explaining::connected(&reply.response, &who);
        if Explaining::is_heard(&reply.response, &who) {
            let term = explain::revision(&reply.response).0;
            for (topic, input) in self.each.iter_mut().zip(&self.fitted) {
                let found = connected.iter().find(|connected| connected.input == *input);
                topic.link_is(found.and_then(|connected| connected.link), term, now_ns);
            }
        }
        for Connected { input, server, .. } in connected {
            let configured = self.cfg.topics.iter().position(|name| *name == input);
            let said = configured.and_then(|at| self.cfg.sources.get(at)).is_some_and(|s| !s.is_empty());
            let at = self.fitted.iter().position(|name| *name == input);
            if let Some(topic) = at.and_then(|at| self.each.get_mut(at))
                && !said
            {
                let name = format!("/{server}");
                if topic.name == format!("/{who}/{input}") {
                    run.rename(&topic.name, &name);
                }
                topic.rename(&name);
            }
        }
        run.explaining.graph_is(reply.response, now_ns, &mut run.way);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now_ns = tick.now().ns();
        self.hear();
        let Some(run) = &mut self.run else { return Ok(()) };
        // A step takes what came since the one before, and times that were asked for lie in between.
        if run.is_due(now_ns) {
            let since_ns = run.reaches_back_to(now_ns);
            self.each.iter_mut().for_each(|topic| topic.begin(since_ns));
            run.begin(&self.host, now_ns);
        }
        run.stepped_ns = now_ns;
        let recording = run.began_ns != 0;
        let is_due = |at_ns: u64| recording && at_ns != 0 && at_ns <= now_ns;
        let (pauses, is_over) = (is_due(run.pause_ns), is_due(run.ends_ns));
        let until_ns = [run.pause_ns, run.ends_ns].into_iter().filter(|at_ns| is_due(*at_ns)).min();
        // Late samples were acquired before the begin, and those that come while this step is held up, behind
        // the end. Stamps of another clock tell neither.
        let before = run.before();
        let behind = until_ns.map_or(0..0, |at_ns| at_ns..u64::MAX);
        self.drain(recording, &[before, behind]);
        let Some(run) = &mut self.run else { return Ok(()) };
        if pauses {
            (run.paused, run.pause_ns) = (true, 0);
        }
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
            interrupted: self.each.iter().map(|topic| topic.interrupted).sum(),
        };
        run.explaining.tell_what_waits(now_ns, &mut run.way);
        let missing = (self.status.lost, self.status.interrupted);
        if recording {
            run.watch_loss(&self.each, missing, now_ns);
        }
        if recording && now_ns.saturating_sub(run.shown_ns) >= SECOND_NS {
            run.shown_ns = now_ns;
            self.progress.emit(self.status);
        }
        if is_over {
            self.end("its time was over");
        }
        Ok(())
    }
}

impl Recorder {
    fn drain_and_end(&mut self) {
        self.catch_up();
        self.end("the recorder was stopped");
        let Some(run) = self.run.take() else { return };
        for ended in run.finish() {
            self.tell_end(&ended);
        }
        self.path = Text::default();
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.drain_and_end();
    }
}
