//! `trocar export F`: topics of a recording as CSV, NumPy arrays or pictures.
//!
//! Invariant: nothing that exists is written over; what does not fit into a table is counted and told.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::ProgressBar;
use mcap::records::MessageHeader;

use super::columns::{Cell, Reader};
use super::npz::{Item, Npz};
use super::planes::{Plane, Row};
use super::read::{self, Channel, Takes};
use super::sink::{ExportView, Message, Sink, free_name, new_file, wrote};
use super::tables::Tables;
use super::{listed, meant, pictures, select};
use crate::cli::failure::{Done, Exit, Failure};
use crate::cli::session::Session;
use crate::cli::{out, units};

/// Memory for arrays, bytes: `.npz` needs all of a column before it can be written.
const MOST: usize = 4 << 30;

/// Writes topics of a recording as tables or pictures: `trocar export trial.mcap --csv`.
#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("kind").required(true).args(["csv", "npz", "png"])))]
pub(in crate::cli) struct ExportArgs {
    /// The recording.
    file: PathBuf,
    /// One CSV file per topic.
    #[arg(long)]
    csv: bool,
    /// One NumPy file: arrays TOPIC/FIELD, TOPIC/log_time_ns, TOPIC/publish_time_ns; frames but pictures as TOPIC/data.
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
    /// Where to, a new directory, or with --npz a new file [default: the recording's name without .mcap, or with .npz].
    #[arg(long, short = 'o', value_name = "PATH")]
    output: Option<PathBuf>,
}

pub(in crate::cli) fn run(args: ExportArgs, session: &Session) -> Done {
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from >= to
    {
        return Err(Failure::usage("--from is not before --to", "swap them, or leave one out"));
    }
    let output = args.output.clone().unwrap_or_else(|| {
        if args.npz { args.file.with_extension("npz") } else { args.file.with_extension("") }
    });
    if output.exists() || output == args.file {
        return Err(Failure::local(
            "EXISTS",
            format!("{} exists, and nothing is written over", output.display()),
            "name another place: -o PATH, or remove it",
        ));
    }
    let bar = super::reading_bar(&args.file, session.json());
    let sink: Box<dyn Sink> = if args.npz {
        Box::new(Arrays::default())
    } else if args.csv {
        Box::new(Tables::new(output.clone()))
    } else {
        Box::new(Pictures { directory: output.clone(), topics: BTreeMap::new(), skipped: None })
    };
    let mut exporting = Exporting {
        from_ns: args.from.unwrap_or(0),
        to_ns: args.to.unwrap_or(u64::MAX),
        patterns: args.topic,
        begin_ns: None,
        end_ns: 0,
        meant: 0,
        within: 0,
        readers: BTreeMap::new(),
        sink,
        view: ExportView { output: output.display().to_string(), ..ExportView::default() },
        bar: bar.clone(),
    };
    let whole = read::read(&args.file, &mut exporting);
    bar.finish_and_clear();
    let whole = whole.map_err(|failure| incomplete(failure, &output))?;
    if exporting.view.messages == 0 {
        return Err(exporting.nothing(&args.file, args.png, &whole));
    }
    let Exporting { sink, mut view, .. } = exporting;
    view.files = sink.finish(&output, &mut view)?;
    view.wrong = whole.wrong;
    if session.json() {
        session.print_json(&view)?;
    } else {
        let (files, messages) = (units::count(view.files, "file"), units::count(view.messages, "message"));
        out::say(&format!("{}: {files} of {messages}", view.output));
        for (n, what) in [
            (view.unreadable, "messages could not be read and were left out"),
            (view.unplaced, "values do not fit to the first message of their topic and were left out"),
            (view.pictures, "pictures are not among the arrays: `--png` writes them"),
            (view.texts, "words are not among the arrays: `--csv` writes them"),
        ] {
            if n > 0 {
                out::complain("warning", &format!("{n} {what}"));
            }
        }
        if view.recorders > 0 && !args.png {
            let n = units::count(view.recorders, "message");
            out::complain(
                "note",
                &format!("{n} of the recorder itself left out: --topic '/recorder/*' names them"),
            );
        }
        if !view.wrong.is_empty() {
            out::complain("warning", &format!("{}; everything before that was written", view.wrong));
        }
    }
    let partial = view.unreadable + view.unplaced > 0 || !view.wrong.is_empty();
    Ok(if partial { Exit::Partial } else { Exit::Ok })
}

/// The failure, and what there is of the export all the same.
fn incomplete(failure: Failure, output: &Path) -> Failure {
    if !output.exists() {
        return failure;
    }
    let message = format!("{}; {} has what was written before that", failure.message, output.display());
    let help = format!("{}; remove {} before you export to it again", failure.help, output.display());
    Failure { message, help, ..failure }
}

struct Exporting {
    from_ns: u64,
    to_ns: u64,
    patterns: Vec<String>,
    begin_ns: Option<u64>,
    /// Of its last message.
    end_ns: u64,
    /// Messages that the patterns name, and of them those in that time.
    meant: u64,
    within: u64,
    readers: BTreeMap<u16, Reader>,
    sink: Box<dyn Sink>,
    view: ExportView,
    bar: ProgressBar,
}

impl Exporting {
    /// Why nothing was written, and what there is.
    fn nothing(&self, file: &Path, png: bool, whole: &read::Whole) -> Failure {
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
                _ => refused(format!("none of {within} of {wanted} can be read"), info),
            };
        }
        let names: BTreeSet<&str> = whole.channels.values().map(|c| c.topic.as_str()).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let close = meant(self.patterns.iter().map(String::as_str), &names);
        // What could not be read may have had it.
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
        // Without a pattern: what was recorded, not what the recorder says of itself.
        let wanted = match &self.patterns[..] {
            [] => !select::is_recorders(&channel.topic),
            all => all.iter().any(|pattern| select::matches(pattern, &channel.topic)),
        };
        self.view.recorders += u64::from(within && self.patterns.is_empty() && !wanted);
        self.meant += u64::from(wanted);
        if !wanted || !within {
            return Ok(());
        }
        self.within += 1;
        let reader = self.readers.entry(header.channel_id).or_insert_with(|| Reader::of(channel));
        self.sink.take(&Message { channel, reader, header, data }, &mut self.view)
    }

    fn progress(&mut self, bytes: u64) {
        self.bar.set_position(bytes);
    }
}

// ---- NumPy

#[derive(Default)]
struct Arrays {
    topics: BTreeMap<String, Columns>,
    bytes: usize,
}

/// The messages of one topic, by columns.
#[derive(Default)]
struct Columns {
    times: [Vec<u8>; 3],
    rows: usize,
    /// Items of 8 bytes.
    fields: BTreeMap<String, (Item, Vec<u8>)>,
    /// Bytes of frames, in rows of the first one's shape.
    planes: BTreeMap<String, Plane>,
}

impl Columns {
    /// Rows of a frame behind those before. One that is not of the first one's shape is as many rows of zeros: rows stay with their
    /// times. How many bytes, and whether it was as the first.
    fn add_plane(&mut self, name: String, plane: Plane) -> (usize, bool) {
        let first = self.planes.entry(name).or_insert_with(|| Plane {
            rows: 0,
            shape: plane.shape.clone(),
            bytes: Vec::new(),
            item: plane.item,
        });
        let fits = (first.item, &first.shape) == (plane.item, &plane.shape);
        // Not larger than bytes that were there once, each of both.
        let row = first.shape.iter().product::<usize>() * first.item.bytes();
        let more = if fits { plane.bytes.len() } else { row.saturating_mul(plane.rows) };
        if more <= MOST {
            first.bytes.extend_from_slice(if fits { &plane.bytes } else { &[] });
            first.bytes.resize(first.bytes.len() + if fits { 0 } else { more }, 0);
            first.rows += plane.rows;
        }
        (more, fits)
    }

    fn add(&mut self, name: String, item: Item, bits: [u8; 8], row: usize) -> usize {
        let (kind, values) = self.fields.entry(name).or_insert((item, Vec::new()));
        // A message without the field leaves a gap: not a number, or zero.
        let gap = if *kind == Item::F64 { f64::NAN.to_le_bytes() } else { [0; 8] };
        while values.len() < 8 * row {
            values.extend_from_slice(&gap);
        }
        if values.len() == 8 * row && *kind == item {
            values.extend_from_slice(&bits);
            return 8;
        }
        0
    }
}

impl Sink for Arrays {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure> {
        let Some(cells) = message.row(view) else { return Ok(()) };
        let Message { channel, header, .. } = *message;
        let columns = self.topics.entry(channel.topic.trim_matches('/').to_owned()).or_default();
        let row = columns.rows;
        columns.times[0].extend_from_slice(&header.log_time.to_le_bytes());
        columns.times[1].extend_from_slice(&header.publish_time.to_le_bytes());
        columns.times[2].extend_from_slice(&u64::from(header.sequence).to_le_bytes());
        columns.rows += 1;
        self.bytes += 24;
        let is_picture = pictures::is_one(&channel.schema, &Row(&cells));
        view.pictures += u64::from(is_picture);
        let planes = cells.iter().filter_map(|(name, cell)| match cell {
            Cell::Bytes(bytes) if !is_picture => Some((name.clone(), Plane::of(&Row(&cells), name, bytes))),
            _ => None,
        });
        for (name, plane) in planes.collect::<Vec<_>>() {
            let (taken, fits) = columns.add_plane(name, plane);
            view.unplaced += u64::from(!fits);
            self.bytes = self.bytes.saturating_add(taken);
        }
        for (name, cell) in cells {
            let (item, bits) = match cell {
                Cell::Float(n) => (Item::F64, n.to_le_bytes()),
                Cell::Whole(n) | Cell::Named(n, _) => (Item::I64, n.to_le_bytes()),
                Cell::Large(n) => (Item::U64, n.to_le_bytes()),
                Cell::Text(_) => {
                    view.texts += 1;
                    continue;
                }
                // They were placed.
                Cell::Bytes(_) => continue,
            };
            let taken = columns.add(name, item, bits, row);
            view.unplaced += u64::from(taken == 0);
            self.bytes += taken;
        }
        view.messages += 1;
        if self.bytes > MOST {
            return Err(Failure::local(
                "TOO_LARGE",
                format!("more than {} GB of numbers", MOST >> 30),
                "take less of it: --topic, --from, --to; or --csv",
            ));
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, output: &Path, _: &mut ExportView) -> Result<u64, Failure> {
        let mut npz = Npz::new(new_file(output)?);
        let failed = |e: std::io::Error| incomplete(wrote(output, &e), output);
        for (topic, columns) in &mut self.topics {
            let rows = columns.rows;
            let heads = ["log_time_ns", "publish_time_ns", "sequence"].into_iter().zip(&columns.times);
            // Where the type has a field of that name, it is that field.
            for (name, times) in heads.filter(|(name, _)| !columns.fields.contains_key(*name)) {
                npz.array(&format!("{topic}/{name}"), Item::U64, &[rows], times).map_err(failed)?;
            }
            for (name, plane) in &columns.planes {
                let shape: Vec<usize> = [plane.rows].into_iter().chain(plane.shape.iter().copied()).collect();
                npz.array(&format!("{topic}/{name}"), plane.item, &shape, &plane.bytes).map_err(failed)?;
            }
            let mut groups: BTreeMap<String, Vec<(usize, String)>> = BTreeMap::new();
            for name in columns.fields.keys() {
                let (base, index) = indexed(name);
                groups.entry(base).or_default().push((index.unwrap_or(0), name.clone()));
            }
            for (base, mut members) in groups {
                members.sort_unstable();
                let kinds: Vec<Item> =
                    members.iter().filter_map(|(_, n)| columns.fields.get(n).map(|f| f.0)).collect();
                let one_kind = kinds.windows(2).all(|pair| pair[0] == pair[1]);
                let (true, Some(kind)) = (one_kind, kinds.first().copied()) else { continue };
                let gap = if kind == Item::F64 { f64::NAN.to_le_bytes() } else { [0; 8] };
                let mut bytes = Vec::with_capacity(8 * rows * members.len());
                for row in 0..rows {
                    for (_, name) in &members {
                        let values = columns.fields.get(name).map_or(&[][..], |f| &f.1[..]);
                        bytes.extend_from_slice(values.get(8 * row..8 * row + 8).unwrap_or(&gap));
                    }
                }
                let shape = [rows, members.len()];
                let shape = if members.len() == 1 { &shape[..1] } else { &shape[..] };
                npz.array(&format!("{topic}/{base}"), kind, shape, &bytes).map_err(failed)?;
            }
        }
        npz.finish().map_err(failed)?;
        Ok(1)
    }
}

/// `position[2]` → `position` and 2; deeper indexes stay in the name.
fn indexed(name: &str) -> (String, Option<usize>) {
    let parts = name.strip_suffix(']').and_then(|rest| rest.rsplit_once('['));
    match parts.and_then(|(base, index)| Some((base, index.parse().ok()?))) {
        Some((base, index)) => (base.to_owned(), Some(index)),
        None => (name.to_owned(), None),
    }
}

// ---- pictures

struct Pictures {
    directory: PathBuf,
    /// The directory of each topic, and how many are in it.
    topics: BTreeMap<String, (String, u64)>,
    skipped: Option<&'static str>,
}

impl Sink for Pictures {
    fn take(&mut self, message: &Message<'_>, view: &mut ExportView) -> Result<(), Failure> {
        let Message { channel, reader, data, .. } = *message;
        if !channel.schema.ends_with("Image") {
            return Ok(());
        }
        let Some(found) = reader.decode(data).as_ref().and_then(pictures::find) else {
            view.unreadable += 1;
            return Ok(());
        };
        if !self.topics.contains_key(&channel.topic) {
            let name = free_name(&channel.topic, |name| self.topics.values().any(|(taken, _)| taken == name));
            self.topics.insert(channel.topic.clone(), (name, 0));
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
    fn a_topic_is_no_way_out_of_a_directory() {
        assert_eq!(file_name("/host/sine/value"), "host_sine_value");
        assert_eq!(file_name("/../../etc/passwd"), "______etc_passwd");
        assert_eq!(file_name("//"), "topic");
        assert!(file_name(&"x".repeat(10_000)).len() <= 200);
        let taken = ["a_b_c".to_owned(), "a_b_c_2".to_owned()];
        assert_eq!(free_name("/a/b/c", |name| taken[..1].iter().any(|t| t == name)), "a_b_c_2");
        assert_eq!(free_name("/a_b/c", |name| taken.iter().any(|t| t == name)), "a_b_c_3");
    }

    #[test]
    fn a_frame_of_another_shape_is_zeros_so_that_rows_stay_with_their_times() {
        let mut columns = Columns::default();
        let mut add = |rows: usize, side: usize| {
            let plane = Plane { item: Item::U16, rows, shape: vec![side], bytes: vec![7; 2 * rows * side] };
            columns.add_plane("data".into(), plane)
        };
        assert_eq!((add(3, 2), add(1, 5), add(2, 2)), ((12, true), (4, false), (8, true)));
        let data = &columns.planes["data"];
        assert_eq!((data.rows, &data.shape[..]), (6, &[2][..]));
        assert_eq!(data.bytes, [&[7; 12][..], &[0; 4], &[7; 8]].concat());
    }

    #[test]
    fn items_of_a_list_stand_side_by_side() {
        assert_eq!(indexed("pose.position[2]"), ("pose.position".to_owned(), Some(2)));
        assert_eq!(indexed("joints[1].effort"), ("joints[1].effort".to_owned(), None));
        assert_eq!(indexed("odd]"), ("odd]".to_owned(), None));
    }
}
