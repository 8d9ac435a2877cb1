//! `trocar info F`: what is in a recording, also in one that was cut off.
//!
//! Invariant: the counts are those of the messages that can be read, not what the file says of itself.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use mcap::records::MessageHeader;
use serde::Serialize;
use serde_json::Value;

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

/// The topic on which the recorder tells what is missing so far.
const LOSS: &str = "/recorder/loss";

struct Counting {
    topics: BTreeMap<String, TopicView>,
    /// The last message of [`LOSS`].
    loss: Vec<u8>,
    bar: ProgressBar,
}

/// What is missing, as the recorder wrote it down: at the end, or last before the file was cut off.
#[derive(Debug, Default, PartialEq)]
struct Missing {
    lost: u64,
    interrupted: u64,
    lost_of: BTreeMap<String, u64>,
    interrupted_of: BTreeMap<String, u64>,
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

pub(in crate::cli) fn run(args: &InfoArgs, session: &Session) -> Done {
    let bar = super::reading_bar(&args.file, session.json());
    let mut counting = Counting { topics: BTreeMap::new(), loss: Vec::new(), bar: bar.clone() };
    let whole = read::read(&args.file, &mut counting);
    bar.finish_and_clear();
    let whole = whole?;
    let missing = if whole.told("trocar.end", "lost").is_some() {
        Missing::at_the_end(&whole)
    } else {
        Missing::so_far(&counting.loss)
    };
    let mut topics = counting.topics;
    for channel in whole.channels.values() {
        topics.entry(channel.topic.clone()).or_insert_with(|| TopicView {
            topic: channel.topic.clone(),
            schema: channel.schema.clone(),
            ..TopicView::default()
        });
    }
    // What is lost of a tap or a pair of images is counted for the output, whose topics lie below it.
    for name in missing.lost_of.keys().chain(missing.interrupted_of.keys()) {
        let topic = || TopicView { topic: name.clone(), ..TopicView::default() };
        topics.entry(name.clone()).or_insert_with(topic);
    }
    for topic in topics.values_mut() {
        topic.lost = missing.lost_of.get(&topic.topic).copied().unwrap_or(0);
        topic.interrupted = missing.interrupted_of.get(&topic.topic).copied().unwrap_or(0);
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
        lost: missing.lost,
        interrupted: missing.interrupted,
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

impl Missing {
    /// The recorder closed the file.
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
                _ => continue,
            };
            of.insert(topic.to_owned(), number(value));
        }
        missing
    }

    /// It did not, or has not yet: what its last message of [`LOSS`] says.
    fn so_far(message: &[u8]) -> Missing {
        let told: Value = serde_json::from_slice(message).unwrap_or_default();
        let of = |key: &str| -> BTreeMap<String, u64> {
            let all = told[key].as_object().into_iter().flatten();
            all.filter_map(|(topic, n)| Some((topic.clone(), n.as_u64()?))).collect()
        };
        let (lost_of, interrupted_of) = (of("topics"), of("interrupted"));
        let sum = |of: &BTreeMap<String, u64>| of.values().fold(0, |sum: u64, n| sum.saturating_add(*n));
        Missing { lost: sum(&lost_of), interrupted: sum(&interrupted_of), lost_of, interrupted_of }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_in_a_file_that_was_cut_off_is_what_was_told_last() {
        let told = br#"{"lost": 7, "topics": {"/a": 3, "/b": 4, "/c": "x"}, "interrupted": {"/a": 2}}"#;
        let missing = Missing::so_far(told);
        let of = |all: &[(&str, u64)]| all.iter().map(|(topic, n)| ((*topic).to_owned(), *n)).collect();
        let wanted = Missing {
            lost: 7,
            interrupted: 2,
            lost_of: of(&[("/a", 3), ("/b", 4)]),
            interrupted_of: of(&[("/a", 2)]),
        };
        assert_eq!(missing, wanted);
        for hostile in [&b""[..], b"[]", b"{\"topics\": 1}", b"\xff"] {
            assert_eq!(Missing::so_far(hostile), Missing::default());
        }
    }
}
