//! `trocar info F`: the content of a recording, also of one that was cut off.
//!
//! Invariant: the counts are those of the messages that can be read, not what the file says of itself. Where
//! chunks cannot be read, they are what the file says, or not known, and the answer tells which.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use mcap::records::MessageHeader;
use serde::Serialize;
use serde_json::Value;

use super::fields::Statistics;
use super::read::{Channel, Takes, Whole};
use crate::failure::{Done, Exit, Failure};
use crate::session::Session;
use crate::table::Table;
use crate::{out, style, units};

/// s: two messages that come together have no rate.
const RATE_S: f64 = 0.01;

/// Shows what is in a recording: topics, rates, types, what was lost: `trocar info trial.mcap`.
#[derive(Args, Debug)]
pub(crate) struct InfoArgs {
    /// The recording.
    file: PathBuf,
}

#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct TopicView {
    pub(super) topic: String,
    schema: String,
    pub(super) messages: u64,
    bytes: u64,
    /// ns of the recorder's clock.
    first_ns: u64,
    last_ns: u64,
    /// Hz, over the time it came; 0 = not known, or too short a time to say.
    rate_hz: f64,
    /// Samples that are missing, as far as the recorder could write it down.
    lost: u64,
    /// Number of times that its source went away: the connection, or the process.
    interrupted: u64,
}

#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct InfoView {
    file: String,
    bytes: u64,
    profile: String,
    library: String,
    /// True: closed as it should be; else `wrong` says what is not.
    whole: bool,
    pub(super) wrong: String,
    #[serde(skip)]
    remains: &'static str,
    pub(super) messages: u64,
    pub(super) counted: Counted,
    lost: u64,
    /// True: a recorder told of losses; else `lost` is not known.
    loss_told: bool,
    /// Sum over all topics.
    interrupted: u64,
    duration_s: f64,
    /// Time of the first message, ns since the Unix epoch; 0 = not known.
    begin_unix_ns: i128,
    reason: String,
    pub(super) topics: Vec<TopicView>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

/// The way in which the messages were counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Counted {
    /// Each was read.
    #[default]
    Read,
    /// Chunks could not be read, and the file has counts of itself.
    Told,
    /// Chunks could not be read: there are more.
    Part,
}

/// Topic on which the recorder tells the losses so far.
const LOSS: &str = "/recorder/loss";

struct Counting {
    topics: BTreeMap<String, TopicView>,
    /// The last message of [`LOSS`].
    loss: Vec<u8>,
    bar: ProgressBar,
}

/// Losses as the recorder wrote them down: at the end, or last before the file was cut off.
#[derive(Debug, Default, PartialEq)]
struct Missing {
    lost: u64,
    interrupted: u64,
    lost_of: BTreeMap<String, u64>,
    interrupted_of: BTreeMap<String, u64>,
    /// Topics that were recorded, and gave nothing.
    silent: BTreeSet<String>,
}

impl Takes for Counting {
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure> {
        let topic = match self.topics.get_mut(&channel.topic) {
            Some(topic) => topic,
            None => self.topics.entry(channel.topic.clone()).or_insert_with(|| TopicView {
                topic: channel.topic.clone(),
                schema: channel.schema.name.clone(),
                first_ns: header.log_time,
                ..TopicView::default()
            }),
        };
        if channel.topic == LOSS {
            self.loss = data.to_vec();
        }
        topic.messages += 1;
        topic.bytes += data.len() as u64;
        topic.first_ns = topic.first_ns.min(header.log_time);
        topic.last_ns = topic.last_ns.max(header.log_time);
        Ok(())
    }

    fn progress(&mut self, bytes: u64) {
        self.bar.set_position(bytes);
    }
}

pub(crate) fn run(args: &InfoArgs, session: &Session) -> Done {
    let bar = super::reading_bar(&args.file, session.json());
    let view = look(&args.file, &bar);
    bar.finish_and_clear();
    let view = view?;
    if session.json() {
        session.print_json(&view)?;
    } else {
        show(&view);
    }
    Ok(if view.whole { Exit::Ok } else { Exit::Partial })
}

/// Reads all that is shown of a recording.
pub(super) fn look(file: &Path, bar: &ProgressBar) -> Result<InfoView, Failure> {
    let mut counting = Counting { topics: BTreeMap::new(), loss: Vec::new(), bar: bar.clone() };
    let whole = super::read_safely(file, &mut counting)?;
    let missing = if whole.told("trocar.end", "lost").is_some() {
        Missing::at_the_end(&whole)
    } else {
        Missing::so_far(&counting.loss)
    };
    let mut topics = every_topic(counting.topics, &whole, &missing);
    let came = || topics.values().filter(|t| t.messages > 0);
    let mut first = came().map(|t| t.first_ns).min().unwrap_or(0);
    let mut last = came().map(|t| t.last_ns).max().unwrap_or(0);
    let mut messages = topics.values().map(|t| t.messages).sum();
    let counted = match &whole.statistics {
        _ if whole.unread_chunks == 0 => Counted::Read,
        None => Counted::Part,
        Some(told) => {
            (first, last, messages) = (told.first_ns, told.last_ns, told.messages);
            told_by(&whole, told, &mut topics);
            Counted::Told
        }
    };
    let loss_told = whole.told("trocar.end", "lost").is_some() || topics.contains_key(LOSS);
    let offset: Option<i128> = whole.told("trocar.clock", "offset_to_unix_ns").and_then(|n| n.parse().ok());
    Ok(InfoView {
        file: file.display().to_string(),
        bytes: whole.bytes,
        profile: whole.profile.clone(),
        library: whole.library.clone(),
        whole: whole.closed && whole.wrong.is_empty(),
        wrong: whole.wrong.clone(),
        remains: whole.remains,
        messages,
        counted,
        lost: missing.lost,
        loss_told,
        interrupted: missing.interrupted,
        duration_s: last.saturating_sub(first) as f64 * 1e-9,
        begin_unix_ns: offset.map_or(0, |offset| offset.saturating_add(first.into())),
        reason: whole.told("trocar.end", "reason").unwrap_or_default().to_owned(),
        topics: topics.into_values().collect(),
        metadata: whole.metadata.into_iter().collect(),
    })
}

/// Completes the topics that brought messages by those that brought none, each with its losses and its rate.
fn every_topic(
    mut topics: BTreeMap<String, TopicView>,
    whole: &Whole,
    missing: &Missing,
) -> BTreeMap<String, TopicView> {
    for channel in whole.channels.values() {
        topics.entry(channel.topic.clone()).or_insert_with(|| TopicView {
            topic: channel.topic.clone(),
            schema: channel.schema.name.clone(),
            ..TopicView::default()
        });
    }
    // Losses of a tap or a pair of images are counted for the output, whose topics lie below it.
    for name in missing.lost_of.keys().chain(missing.interrupted_of.keys()).chain(&missing.silent) {
        let topic = || TopicView { topic: name.clone(), ..TopicView::default() };
        topics.entry(name.clone()).or_insert_with(topic);
    }
    for topic in topics.values_mut() {
        topic.lost = missing.lost_of.get(&topic.topic).copied().unwrap_or(0);
        topic.interrupted = missing.interrupted_of.get(&topic.topic).copied().unwrap_or(0);
        let span = topic.last_ns.saturating_sub(topic.first_ns) as f64 * 1e-9;
        topic.rate_hz = if span > RATE_S { topic.messages.saturating_sub(1) as f64 / span } else { 0.0 };
    }
    topics
}

/// Counts of topics as the file has them of itself; their rates are not known then.
fn told_by(whole: &Whole, told: &Statistics, topics: &mut BTreeMap<String, TopicView>) {
    for topic in topics.values_mut() {
        (topic.messages, topic.rate_hz) = (0, 0.0);
    }
    for (id, messages) in &told.of_channel {
        let topic = whole.channels.get(id).and_then(|channel| topics.get_mut(&channel.topic));
        if let Some(topic) = topic {
            topic.messages = topic.messages.saturating_add(*messages);
        }
    }
}

impl Missing {
    /// Reads the losses of a file that the recorder closed.
    fn at_the_end(whole: &Whole) -> Missing {
        let number = |value: &str| value.parse().unwrap_or(0);
        let sum = |key: &str| whole.told("trocar.end", key).map_or(0, number);
        let mut missing =
            Missing { lost: sum("lost"), interrupted: sum("interrupted"), ..Missing::default() };
        for (key, value) in whole.all("trocar.end") {
            let Some((what, topic)) = key.split_once(':') else { continue };
            let of = match what {
                "lost" => &mut missing.lost_of,
                "interrupted" => &mut missing.interrupted_of,
                "messages" if number(value) == 0 => {
                    missing.silent.insert(topic.to_owned());
                    continue;
                }
                _ => continue,
            };
            of.insert(topic.to_owned(), number(value));
        }
        missing
    }

    /// Reads the losses of a file that the recorder did not close, or has not yet, from the last
    /// message of [`LOSS`].
    fn so_far(message: &[u8]) -> Missing {
        let told: Value = serde_json::from_slice(message).unwrap_or_default();
        let of = |key: &str| -> BTreeMap<String, u64> {
            let all = told[key].as_object().into_iter().flatten();
            all.filter_map(|(topic, n)| Some((topic.clone(), n.as_u64()?))).collect()
        };
        let (lost_of, interrupted_of) = (of("topics"), of("interrupted"));
        let sum = |of: &BTreeMap<String, u64>| of.values().fold(0, |sum: u64, n| sum.saturating_add(*n));
        let silent = told["silent"].as_array().into_iter().flatten();
        let silent = silent.filter_map(|topic| topic.as_str().map(str::to_owned)).collect();
        Missing { lost: sum(&lost_of), interrupted: sum(&interrupted_of), lost_of, interrupted_of, silent }
    }
}

/// "1.03 MB".
pub(super) fn size(bytes: u64) -> String {
    let bytes = bytes as f64;
    match bytes {
        b if b >= 1e9 => format!("{:.2} GB", b / 1e9),
        b if b >= 1e6 => format!("{:.2} MB", b / 1e6),
        b if b >= 1e3 => format!("{:.1} kB", b / 1e3),
        b => format!("{b:.0} B"),
    }
}

/// Taps that had nothing to tell: every component has some, and a pattern for all of its outputs takes them
/// along.
fn is_idle_tap(view: &InfoView, topic: &TopicView) -> bool {
    view.counted == Counted::Read && topic.topic.contains("/tap_") && topic.messages == 0 && topic.lost == 0
}

fn show(view: &InfoView) {
    out::say(&format!(
        "{}: {}, {:.3} s, {}, {}{}",
        view.file,
        size(view.bytes),
        view.duration_s,
        match view.counted {
            Counted::Read => units::count(view.messages, "message"),
            Counted::Told => format!(
                "{} as the file says, not all of which can be read",
                units::count(view.messages, "message")
            ),
            Counted::Part if view.messages == 0 => "none of its messages can be read".to_owned(),
            Counted::Part => format!("at least {}", units::count(view.messages, "message")),
        },
        if view.loss_told { format!("{} lost", view.lost) } else { "losses are not told in it".to_owned() },
        if view.reason.is_empty() {
            String::new()
        } else {
            format!("; ended: {}", units::cut(&view.reason, 200))
        },
    ));
    let mut table = Table::new(&["TOPIC", "MESSAGES", "RATE", "BYTES", "LOST", "TYPE"]);
    let idle = view.topics.iter().filter(|topic| is_idle_tap(view, topic)).count();
    for topic in view.topics.iter().filter(|topic| !is_idle_tap(view, topic)) {
        table.row([
            units::cut(&topic.topic, 120),
            if view.counted == Counted::Part && topic.messages == 0 {
                "-".to_owned()
            } else {
                topic.messages.to_string()
            },
            if topic.rate_hz > 0.0 { units::rate(topic.rate_hz) } else { "-".to_owned() },
            size(topic.bytes),
            topic.lost.to_string(),
            units::cut(&topic.schema, 80),
        ]);
    }
    if !table.is_empty() {
        out::text(&table.render(2, style::stdout()));
    }
    if idle > 0 {
        let taps = units::count(idle as u64, "tap");
        out::say(&format!(
            "{taps} of commands, events and rows were recorded and brought nothing (--json lists them)"
        ));
    }
    for topic in view.topics.iter().filter(|t| t.interrupted > 0) {
        out::complain("warning", &super::interrupted(&topic.topic, topic.interrupted));
    }
    if !view.wrong.is_empty() {
        out::complain("warning", &format!("{}; {} is read", view.wrong, view.remains));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_in_a_file_that_was_cut_off_is_what_was_told_last() {
        let told = br#"{"lost": 7, "topics": {"/a": 3, "/b": 4, "/c": "x"}, "interrupted": {"/a": 2}, "silent": ["/d", 4]}"#;
        let missing = Missing::so_far(told);
        let of = |all: &[(&str, u64)]| all.iter().map(|(topic, n)| ((*topic).to_owned(), *n)).collect();
        let wanted = Missing {
            lost: 7,
            interrupted: 2,
            lost_of: of(&[("/a", 3), ("/b", 4)]),
            interrupted_of: of(&[("/a", 2)]),
            silent: ["/d".to_owned()].into(),
        };
        assert_eq!(missing, wanted);
        for hostile in [&b""[..], b"[]", b"{\"topics\": 1}", b"\xff"] {
            assert_eq!(Missing::so_far(hostile), Missing::default());
        }
    }
}
