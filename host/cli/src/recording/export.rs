//! `trocar export F`: topics of a recording as CSV, NumPy arrays or pictures.
//!
//! Invariant: nothing that exists is written over; what does not fit into a table is counted and told.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use mcap::records::MessageHeader;

use super::arrays::Arrays;
use super::columns::Reader;
use super::read::{Channel, Takes, Whole};
use super::sink::{Bounds, ExportView, Message, Names, Sink, incomplete, new_file, wrote};
use super::tables::Tables;
use super::types::Types;
use super::{listed, meant, pictures, select};
use crate::failure::{Done, Exit, Failure};
use crate::session::Session;
use crate::{out, units};

/// Writes topics of a recording as tables or pictures: `trocar export trial.mcap --csv`.
#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("kind").required(true).args(["csv", "npz", "png"])))]
pub(crate) struct ExportArgs {
    /// The recording.
    file: PathBuf,
    /// One CSV file per topic.
    #[arg(long)]
    csv: bool,
    /// One NumPy file: arrays TOPIC/FIELD, TOPIC/log_time_ns, TOPIC/publish_time_ns; frames but pictures
    /// as TOPIC/data.
    #[arg(long)]
    npz: bool,
    /// One picture per image.
    #[arg(long)]
    png: bool,
    /// Only from this time after the begin, e.g. 2.5s.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time_or_zero)]
    from: Option<u64>,
    /// Only up to this time after the begin.
    #[arg(long, value_name = "TIME", value_parser = units::parse_time)]
    to: Option<u64>,
    /// Only these topics, e.g. 'host/**'; may be given several times.
    #[arg(long, value_name = "PATTERN")]
    topic: Vec<String>,
    /// A new directory, or with --npz a new file, to write to [default: NAME-csv, NAME-png or NAME.npz beside
    /// NAME.mcap].
    #[arg(long, short = 'o', value_name = "PATH")]
    output: Option<PathBuf>,
}

pub(crate) fn run(args: ExportArgs, session: &Session) -> Done {
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from >= to
    {
        return Err(Failure::usage("--from is not before --to", "swap them, or leave one out"));
    }
    let output = args.output.clone().unwrap_or_else(|| place(&args));
    if output.exists() || output == args.file {
        return Err(Failure::local(
            "EXISTS",
            format!("{} exists, and nothing is written over", output.display()),
            "name another place: -o PATH, or remove it",
        ));
    }
    let bar = super::reading_bar(&args.file, session.json());
    let view = export(&args, &output, &bar);
    bar.finish_and_clear();
    let view = view?;
    if session.json() {
        session.print_json(&view)?;
    } else {
        show(&view, args.png);
    }
    let partial = view.unreadable + view.unplaced > 0 || !view.wrong.is_empty();
    Ok(if partial { Exit::Partial } else { Exit::Ok })
}

/// The place of an export that was given none, beside its recording: `trial-csv`, `trial-png` or `trial.npz`.
/// A folder's name has its format, so that tables and pictures of one recording do not meet.
fn place(args: &ExportArgs) -> PathBuf {
    if args.npz {
        return args.file.with_extension("npz");
    }
    let mut name = args.file.with_extension("").into_os_string();
    name.push(if args.csv { "-csv" } else { "-png" });
    PathBuf::from(name)
}

/// Writes the export.
pub(super) fn export(args: &ExportArgs, output: &Path, bar: &ProgressBar) -> Result<ExportView, Failure> {
    let bounds = Bounds::of(std::fs::metadata(&args.file).map_or(0, |file| file.len()));
    let sink: Box<dyn Sink> = if args.npz {
        Box::new(Arrays::new(bounds))
    } else if args.csv {
        Box::new(Tables::new(output.to_owned(), bounds))
    } else {
        Box::new(Pictures::new(output.to_owned()))
    };
    let mut exporting = Exporting {
        from_ns: args.from.unwrap_or(0),
        to_ns: args.to.unwrap_or(u64::MAX),
        patterns: args.topic.clone(),
        begin_ns: None,
        end_ns: 0,
        meant: 0,
        within: 0,
        bounds,
        types: Types::default(),
        channels: BTreeMap::new(),
        sink,
        view: ExportView { output: output.display().to_string(), ..ExportView::default() },
        bar: bar.clone(),
    };
    let whole = super::read_safely(&args.file, &mut exporting);
    let whole = whole.map_err(|failure| incomplete(failure, output))?;
    if exporting.view.messages == 0 {
        return Err(exporting.nothing(&args.file, args.png, &whole));
    }
    let Exporting { sink, mut view, .. } = exporting;
    view.files = sink.finish(output, &mut view)?;
    (view.wrong, view.remains) = (whole.wrong, whole.remains);
    Ok(view)
}

fn show(view: &ExportView, png: bool) {
    let (files, messages) = (units::count(view.files, "file"), units::count(view.messages, "message"));
    out::say(&format!("{}: {files} of {messages}", view.output));
    if view.unreadable > 0 {
        let n = units::count(view.unreadable, "message");
        let why = if view.why.is_empty() { "not what their types say" } else { &view.why };
        out::complain("warning", &format!("{n} could not be read and are left out: {why}"));
    }
    for (n, what) in [
        (view.unplaced, "values have no place among those of the first message of their topic: left out"),
        (view.pictures, "pictures are not among the arrays: `--png` writes them"),
        (view.texts, "words are not among the arrays: `--csv` writes them"),
    ] {
        if n > 0 {
            out::complain("warning", &format!("{n} {what}"));
        }
    }
    if view.recorders > 0 && !png {
        let n = units::count(view.recorders, "message");
        let text = format!("{n} of the recorder itself left out: --topic '/recorder/*' names them");
        out::complain("note", &text);
    }
    if !view.wrong.is_empty() {
        out::complain("warning", &format!("{}; {} was written", view.wrong, view.remains));
    }
}

struct Exporting {
    from_ns: u64,
    to_ns: u64,
    patterns: Vec<String>,
    begin_ns: Option<u64>,
    /// Log time of its last message.
    end_ns: u64,
    /// Messages that the patterns name, and those of them in that time.
    meant: u64,
    within: u64,
    bounds: Bounds,
    types: Types,
    /// By channel number: whether the channel is meant, and its reader when one was needed.
    channels: BTreeMap<u16, (bool, Option<Reader>)>,
    sink: Box<dyn Sink>,
    view: ExportView,
    bar: ProgressBar,
}

impl Exporting {
    /// Tells why nothing was written, and what there is.
    fn nothing(&self, file: &Path, png: bool, whole: &Whole) -> Failure {
        let wanted = if self.patterns.is_empty() { "outputs".to_owned() } else { self.patterns.join(" ") };
        let lasts = units::time(self.end_ns.saturating_sub(self.begin_ns.unwrap_or(self.end_ns)));
        let within = units::count(self.within, "message");
        let refused = |why: String, help: String| {
            Failure::refused("NOTHING_THERE", format!("{}: {why}", file.display()), help)
        };
        if self.meant > 0 {
            let info = "`trocar info` shows what is in it".to_owned();
            return match (self.within, png) {
                (0, _) => refused(
                    format!("no message of {wanted} in that time: it lasts {lasts}"),
                    "--from and --to count from its first message".to_owned(),
                ),
                (_, true) => refused(format!("no picture among {within} of {wanted}"), info),
                _ if self.view.why.is_empty() => {
                    refused(format!("none of {within} of {wanted} can be read"), info)
                }
                _ => refused(format!("none of {within} of {wanted} can be read: {}", self.view.why), info),
            };
        }
        let names: BTreeSet<&str> = whole.channels.values().map(|c| c.topic.as_str()).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let close = meant(self.patterns.iter().map(String::as_str), &names);
        // The part that could not be read may have had such a message.
        let unread = match whole.wrong.as_str() {
            "" => String::new(),
            wrong => format!(", as far as it can be read: {wrong}"),
        };
        let topics = match names[..] {
            [] => "none is known".to_owned(),
            _ => listed(&names),
        };
        refused(
            format!("no message in it is of {wanted}{unread}"),
            format!("{close}topics in it: {topics}; `trocar info` shows them"),
        )
    }
}

impl Takes for Exporting {
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure> {
        let begin_ns = *self.begin_ns.get_or_insert(header.log_time);
        self.end_ns = self.end_ns.max(header.log_time);
        let after = header.log_time.saturating_sub(begin_ns);
        let within = (self.from_ns..=self.to_ns).contains(&after);
        let patterns = &self.patterns;
        let (wanted, reader) = self.channels.entry(header.channel_id).or_insert_with(|| {
            // Without a pattern: what was recorded, not what the recorder says of itself.
            let wanted = match &patterns[..] {
                [] => !select::is_recorders(&channel.topic),
                all => all.iter().any(|pattern| select::matches(pattern, &channel.topic)),
            };
            (wanted, None)
        });
        self.view.recorders += u64::from(within && self.patterns.is_empty() && !*wanted);
        self.meant += u64::from(*wanted);
        if !*wanted || !within {
            return Ok(());
        }
        self.within += 1;
        let reader = reader.get_or_insert_with(|| Reader::of(channel, &mut self.types));
        self.sink.take(&Message { channel, reader, header, data }, &mut self.view)?;
        self.bounds.steps(self.view.steps)
    }

    fn progress(&mut self, bytes: u64) {
        self.bar.set_position(bytes);
    }
}

// ---- pictures

struct Pictures {
    directory: PathBuf,
    /// The directory of each topic, and how many are in it.
    topics: BTreeMap<String, (String, u64)>,
    names: Names,
    skipped: Option<&'static str>,
}

impl Pictures {
    fn new(directory: PathBuf) -> Pictures {
        Pictures { directory, topics: BTreeMap::new(), names: Names::default(), skipped: None }
    }
}

impl Sink for Pictures {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure> {
        let Message { channel, reader, data, .. } = *message;
        if !channel.schema.name.ends_with("Image") {
            return Ok(());
        }
        let Some(found) = reader.decode(data).as_ref().and_then(pictures::find) else {
            view.unreadable(message);
            return Ok(());
        };
        if !self.topics.contains_key(&channel.topic) {
            self.topics.insert(channel.topic.clone(), (self.names.free(&channel.topic), 0));
        }
        let Some((name, count)) = self.topics.get_mut(&channel.topic) else { return Ok(()) };
        let directory = self.directory.join(name);
        let path = |end: &str| directory.join(format!("{count:06}.{end}"));
        match found {
            pictures::Found::Picture(picture) => {
                std::fs::create_dir_all(&directory).map_err(|e| wrote(&directory, &e))?;
                pictures::write(&path("png"), &picture).map_err(|e| wrote(&path("png"), &e))?;
            }
            pictures::Found::File(end, bytes) => {
                let path = path(end);
                new_file(&path)?.write_all(&bytes).map_err(|e| wrote(&path, &e))?;
            }
            pictures::Found::None(why) => {
                self.skipped = Some(why);
                view.unreadable += 1;
                return Ok(());
            }
        }
        *count += 1;
        view.messages += 1;
        Ok(())
    }

    fn finish(self: Box<Self>, _: &Path, _: &mut ExportView) -> Result<u64, Failure> {
        if let Some(why) = self.skipped {
            out::complain("warning", &format!("an image was left out: {why}"));
        }
        Ok(self.topics.values().map(|(_, count)| count).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::super::sink::file_name;
    use super::*;

    #[test]
    fn an_export_lies_beside_its_recording_under_a_name_with_its_format() {
        #[derive(clap::Parser)]
        struct Words {
            #[command(flatten)]
            args: ExportArgs,
        }
        for (how, file, wanted) in [
            ("--csv", "rec/trial.mcap", "rec/trial-csv"),
            ("--png", "trial.1.mcap", "trial.1-png"),
            ("--npz", "rec/trial.mcap", "rec/trial.npz"),
            ("--csv", "trial", "trial-csv"),
        ] {
            let args = <Words as clap::Parser>::try_parse_from(["export", file, how]).expect("words").args;
            assert_eq!(place(&args), Path::new(wanted));
        }
    }

    #[test]
    fn a_topic_is_no_way_out_of_a_directory() {
        assert_eq!(file_name("/host/sine/value"), "host_sine_value");
        assert_eq!(file_name("/../../etc/passwd"), "______etc_passwd");
        assert_eq!(file_name("//"), "topic");
        assert!(file_name(&"x".repeat(10_000)).len() <= 200);
        let mut names = Names::default();
        let free = ["/a/b_c_2", "/a/b/c", "/a_b/c", "/a/b_c"].map(|topic| names.free(topic));
        assert_eq!(free, ["a_b_c_2", "a_b_c", "a_b_c_3", "a_b_c_4"]);
    }
}
