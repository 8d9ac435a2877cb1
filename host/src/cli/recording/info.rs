//! `trocar info F`: what is in a recording, also in one that was cut off.
//!
//! Invariant: the counts are those of the messages that can be read, not what the file says of itself.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use mcap::records::MessageHeader;
use serde::Serialize;

use super::read::{self, Channel, Takes, Whole};
use crate::cli::failure::{Done, Exit, Failure};
use crate::cli::session::Session;
use crate::cli::table::Table;
use crate::cli::{out, style, units};

/// s: two messages that come together have no rate.
const RATE_S: f64 = 0.01;

/// Shows what is in a recording: topics, rates, types, what was lost: `trocar info trial.mcap`.
#[derive(Args, Debug)]
pub(in crate::cli) struct InfoArgs {
    /// The recording.
    file: PathBuf,
}

#[derive(Clone, Debug, Default, Serialize)]
struct TopicView {
    topic: String,
    schema: String,
    messages: u64,
    bytes: u64,
    /// ns of the recorder's clock.
    first_ns: u64,
    last_ns: u64,
    /// Hz, over the time it came; 0 = too short a time to say.
    rate_hz: f64,
    /// Samples that are missing, as far as the recorder could write it down.
    lost: u64,
    /// How often what it came from went away: its connection, or the process.
    interrupted: u64,
}

#[derive(Clone, Debug, Default, Serialize)]
struct InfoView {
    file: String,
    bytes: u64,
    profile: String,
    library: String,
    /// Closed as it should be; else `wrong` says what is not.
    whole: bool,
    wrong: String,
    messages: u64,
    lost: u64,
    /// Of all topics.
    interrupted: u64,
    duration_s: f64,
    /// Of the first message, ns since the Unix epoch; 0 = not known.
    begin_unix_ns: i128,
    reason: String,
    topics: Vec<TopicView>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

struct Counting {
    topics: BTreeMap<String, TopicView>,
    bar: ProgressBar,
}

impl Takes for Counting {
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure> {
        let topic = match self.topics.get_mut(&channel.topic) {
            Some(topic) => topic,
            None => self.topics.entry(channel.topic.clone()).or_insert_with(|| TopicView {
                topic: channel.topic.clone(),
                schema: channel.schema.clone(),
                first_ns: header.log_time,
                ..TopicView::default()
            }),
        };
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

pub(in crate::cli) fn run(args: &InfoArgs, session: &Session) -> Done {
    let bar = super::reading_bar(&args.file, session.json());
    let mut counting = Counting { topics: BTreeMap::new(), bar: bar.clone() };
    let whole = read::read(&args.file, &mut counting);
    bar.finish_and_clear();
    let whole = whole?;
    let mut topics = counting.topics;
    for channel in whole.channels.values() {
        topics.entry(channel.topic.clone()).or_insert_with(|| TopicView {
            topic: channel.topic.clone(),
            schema: channel.schema.clone(),
            ..TopicView::default()
        });
    }
    // What is lost of a tap or a pair of images is counted for the output, whose topics lie below it.
    for (key, _) in whole.all("trocar.end") {
        let Some((_, name)) = key.split_once(':') else { continue };
        let topic = || TopicView { topic: name.to_owned(), ..TopicView::default() };
        topics.entry(name.to_owned()).or_insert_with(topic);
    }
    for topic in topics.values_mut() {
        topic.lost = told(&whole, &format!("lost:{}", topic.topic));
        topic.interrupted = told(&whole, &format!("interrupted:{}", topic.topic));
        let span = topic.last_ns.saturating_sub(topic.first_ns) as f64 * 1e-9;
        topic.rate_hz = if span > RATE_S { topic.messages.saturating_sub(1) as f64 / span } else { 0.0 };
    }
    let came = || topics.values().filter(|t| t.messages > 0);
    let first = came().map(|t| t.first_ns).min().unwrap_or(0);
    let last = came().map(|t| t.last_ns).max().unwrap_or(0);
    let offset: Option<i128> = whole.told("trocar.clock", "offset_to_unix_ns").and_then(|n| n.parse().ok());
    let view = InfoView {
        file: args.file.display().to_string(),
        bytes: whole.bytes,
        profile: whole.profile.clone(),
        library: whole.library.clone(),
        whole: whole.closed && whole.wrong.is_empty(),
        wrong: whole.wrong.clone(),
        messages: topics.values().map(|t| t.messages).sum(),
        lost: told(&whole, "lost"),
        interrupted: told(&whole, "interrupted"),
        duration_s: last.saturating_sub(first) as f64 * 1e-9,
        begin_unix_ns: offset.map_or(0, |offset| offset.saturating_add(first.into())),
        reason: whole.told("trocar.end", "reason").unwrap_or_default().to_owned(),
        topics: topics.into_values().collect(),
        metadata: whole.metadata.into_iter().collect(),
    };
    if session.json() {
        session.print_json(&view)?;
    } else {
        show(&view);
    }
    Ok(if view.whole { Exit::Ok } else { Exit::Partial })
}

/// A number that the recorder wrote at the end.
fn told(whole: &Whole, key: &str) -> u64 {
    whole.told("trocar.end", key).and_then(|n| n.parse().ok()).unwrap_or(0)
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

fn show(view: &InfoView) {
    out::say(&format!(
        "{}: {}, {:.3} s, {} messages, {} lost{}",
        view.file,
        size(view.bytes),
        view.duration_s,
        view.messages,
        view.lost,
        if view.reason.is_empty() { String::new() } else { format!("; ended: {}", view.reason) },
    ));
    let mut table = Table::new(&["TOPIC", "MESSAGES", "RATE", "BYTES", "LOST", "TYPE"]);
    for topic in &view.topics {
        table.row([
            units::cut(&topic.topic, 120),
            topic.messages.to_string(),
            if topic.rate_hz > 0.0 { units::rate(topic.rate_hz) } else { "-".to_owned() },
            size(topic.bytes),
            topic.lost.to_string(),
            units::cut(&topic.schema, 80),
        ]);
    }
    if !table.is_empty() {
        out::text(&table.render(2, style::stdout()));
    }
    for topic in view.topics.iter().filter(|t| t.interrupted > 0) {
        out::complain("warning", &super::interrupted(&topic.topic, topic.interrupted));
    }
    if !view.wrong.is_empty() {
        out::complain("warning", &format!("{}; everything before that is read", view.wrong));
    }
}
