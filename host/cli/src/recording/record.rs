//! `trocar record PATTERN… -o F`: a recorder made for one recording, and taken away at its end.
//!
//! Invariant: whatever ends it (time, Ctrl-C, a closed terminal, a full disk, SIGKILL), the file is closed
//! first and no component stays behind.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::{Value, json};

use super::ends::Ends;
use super::info::size;
use super::patience::Patience;
use super::{listed, meant, select};
use crate::connect::ConnectArgs;
use crate::create::CreateArgs;
use crate::execution::ExecutionArgs;
use crate::failure::{Done, Exit, Failure};
use crate::mutation::MutationArgs;
use crate::session::Session;
use crate::session::holding::Holding;
use crate::session::recording::{Source, Sources};
use crate::states::Verb;
use crate::{out, style, units};

const CLASS: &str = "recorder/recorder";
/// Priority of the recorder's thread, above every thread without one: disk work that the kernel does for the
/// recorder may hold such threads up for 100 ms.
const PRIORITY: u8 = 1;
/// Pause between two looks at the recorder, after which the display is renewed.
const LOOK: Duration = Duration::from_millis(200);
/// Deadline of a question to the recorder, ns.
const ANSWER_NS: u64 = 5_000_000_000;
/// Time that the end of a file may take, on a slow disk.
const CLOSING: Duration = Duration::from_secs(60);
/// The recorder's reason for a recording whose time had not come.
const NOT_BEGUN: &str = "stopped before it began: there is no file";
/// Samples that may wait, at most, and bytes of them.
const DEEPEST: u32 = 4096;
const QUEUE_BYTES: u32 = 16 << 20;
/// Bytes per second that fill any disk, and s in which that is worth saying.
const MUCH: f64 = 100e6;
const LONG_S: f64 = 12.0 * 3600.0;
/// Advice for a recording with losses.
const LESS: &str = "fewer outputs and --max-rate-hz ask less of the machine, --video qoi and --video jpeg less of its disk and more of its \
    processors; --buffer-mb lasts while a disk stands still";
/// Frames that may wait: a queue leaves their pool enough for its owner, however deep it is.
const FRAMES: u32 = 64;

const EXAMPLES: &str = "\
Example:
  trocar record 'robot/**' oct/ascan/ascan -o trial.mcap --seconds 60
Ctrl-C ends it, with a whole file. A pattern is process/component/output; * stands for any part of a name, ** for any names.";

/// Records outputs to an MCAP file: `trocar record 'host/**' -o trial.mcap`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct RecordArgs {
    /// What is recorded: outputs, components, processes, or globs of them.
    #[arg(value_name = "PATTERN", required = true)]
    patterns: Vec<String>,
    /// The new file; it ends with .mcap.
    #[arg(long, short = 'o', value_name = "FILE")]
    output: PathBuf,
    /// End by itself after this many seconds.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// At most this many samples per second of each output, Hz [default: all].
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    max_rate_hz: Option<f64>,
    /// How video is kept: raw, qoi (smaller without loss) or jpeg.
    #[arg(long, default_value = "raw", value_name = "KIND", value_parser = ["raw", "qoi", "jpeg"])]
    video: String,
    /// The process that records [default: the one with most of it].
    #[arg(long = "in", value_name = "PROCESS")]
    within: Option<String>,
    /// CPUs its threads may run on, e.g. 1,2 [default: all]: away from those of short steps.
    #[arg(long, value_delimiter = ',', value_name = "N")]
    cpus: Vec<u32>,
    /// Memory for what waits for the disk, MB: what finds none is lost, frames before rows and events.
    #[arg(long, default_value_t = 256, value_name = "MB", value_parser = clap::value_parser!(u32).range(8..=65_536))]
    buffer_mb: u32,
}

#[derive(Debug, Default, Serialize)]
struct RecordedView {
    file: String,
    topics: usize,
    messages: u64,
    bytes: u64,
    lost: u64,
    /// Number of times that a connection, or the process of a source, went away meanwhile.
    interrupted: u64,
    whole: bool,
    reason: String,
    /// Outputs that could not be connected, and why.
    left_out: Vec<String>,
    /// Topics with losses.
    losses: Vec<(String, u64)>,
    /// Topics whose source went away, and how often.
    interruptions: Vec<(String, u64)>,
    /// Topics that were connected, and gave nothing.
    silent: Vec<String>,
}

pub(crate) async fn run(args: RecordArgs, session: &Session) -> Done {
    let place = place(&args)?;
    let there = session.sources(CLASS).await?;
    let wanted = chosen(&args.patterns, &there)?;
    let process = process(&args, &there, &wanted)?;
    let path = format!("{process}/rec-{}", std::process::id());
    let topics: Vec<String> = (0..wanted.len()).map(|n| format!("t{n}")).collect();
    let rate = args.max_rate_hz.unwrap_or(0.0);
    let config = json!({
        "directory": place.directory,
        "topics": topics,
        "sources": wanted.iter().map(|s| s.path.clone()).collect::<Vec<_>>(),
        "max_rate_hz": vec![rate; wanted.len()],
        "video": args.video,
        "buffer_mb": args.buffer_mb,
    });
    let create = CreateArgs {
        path: path.clone(),
        class: CLASS.to_owned(),
        config: Some(config),
        isolation: None,
        execution: ExecutionArgs {
            priority: Some(PRIORITY),
            cpus: args.cpus.clone(),
            ..ExecutionArgs::default()
        },
        mutation: MutationArgs::default(),
    };
    // Listens before there is anything to be left behind.
    let mut ends = Ends::listen();
    // Any end of this program, SIGKILL too, ends its recorder.
    let held = session.hold(&path).await?;
    let created = session.create(&create).await?;
    // The recorder's thread may not have been given what was asked for.
    created.warnings.iter().for_each(|text| out::complain("warning", text));
    let mut left_out = Vec::new();
    let bar = bar(&args, session.json());
    // An interrupt before or while it records closes the file, which is then shown as usual.
    let ended = tokio::select! {
        ended = recording(&args, session, &path, &place, &wanted, &mut left_out, (&bar, &held)) => ended.map(|()| false),
        () = ends.come() => Ok(true),
    };
    bar.finish_and_clear();
    let mut patience = Patience::new(&held, None, Some(&mut ends));
    // A manager that was waited for already is not waited for again.
    patience.is_over = ended.as_ref().is_err_and(Patience::is_away);
    let recorded = match ended {
        Ok(asked) => closed(session, &path, asked, wanted.len(), &mut patience).await,
        Err(failure) => Err(failure),
    };
    let remove = async || session.remove(std::slice::from_ref(&path), true, &MutationArgs::default()).await;
    let removed = patience.wait(remove).await;
    let view = match recorded {
        Ok(view) => view,
        Err(failure) => return Err(cut_short(failure, &place, &path, removed.is_err())),
    };
    removed?;
    let topics = wanted.len() - left_out.len().min(wanted.len());
    shown(RecordedView { topics, left_out, ..view }, session)
}

/// Adds to a failure, when nothing answers for the recording any more, what is left of it and
/// of its recorder.
fn cut_short(mut failure: Failure, place: &Place, path: &str, stays: bool) -> Failure {
    let file = Path::new(&place.directory).join(&place.file);
    let Ok(there) = file.metadata() else { return failure };
    let file = file.display();
    failure.exit = Exit::Partial;
    failure.message =
        format!("the recording was cut short: {}", failure.message.trim_end_matches(['.', '\n']));
    failure.help =
        format!("{file} has what came before ({}): `trocar info {file}` shows it", size(there.len()));
    if stays {
        failure.help.push_str(&format!(
            "; {path} is left behind: `trocar rm --force {path}` once its process is back"
        ));
    }
    failure.metadata.insert("file".to_owned(), file.to_string());
    failure
}

struct Place {
    directory: String,
    file: String,
}

/// Returns the place of the file. Its directory is an absolute path, since the host may run elsewhere.
fn place(args: &RecordArgs) -> Result<Place, Failure> {
    let shown = args.output.display();
    let usage = |why: String, help: &str| Failure::usage(why, help);
    let file = args.output.file_name().and_then(|name| name.to_str());
    let Some(file) = file.filter(|_| !args.output.as_os_str().is_empty()) else {
        return Err(usage(format!("{shown} names no file"), "name one, such as -o trial.mcap"));
    };
    if args.output.extension().is_none_or(|end| !end.eq_ignore_ascii_case("mcap")) {
        return Err(usage(
            format!("{shown} does not end with .mcap, and MCAP is what is written"),
            "add the ending: -o trial.mcap",
        ));
    }
    if args.output.exists() {
        return Err(Failure::local(
            "EXISTS",
            format!("{shown} exists, and nothing is written over"),
            "choose another name, or remove it",
        ));
    }
    if args.seconds.is_some_and(|s| !s.is_finite() || s <= 0.0 || s > 86_400.0) {
        return Err(usage(
            "--seconds is above 0 and at most 86400".into(),
            "leave it out to record until Ctrl-C",
        ));
    }
    if args.max_rate_hz.is_some_and(|hz| !hz.is_finite() || !(1e-4..=1e6).contains(&hz)) {
        return Err(usage("--max-rate-hz is 0.0001 Hz to 1000000 Hz".into(), "leave it out to record all"));
    }
    let parent = args.output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let directory = parent.canonicalize().map_err(|e| {
        Failure::local(
            "IO",
            format!("{}: {e}", parent.display()),
            "make the directory first, or choose another",
        )
    })?;
    let directory = directory.to_str().ok_or_else(|| {
        usage(format!("{} is no text", parent.display()), "choose a directory with a name in UTF-8")
    })?;
    Ok(Place { directory: directory.to_owned(), file: file.to_owned() })
}

/// Suggests what could have been meant: similar names, and the outputs there are, the nearest first.
fn instead(pattern: &str, there: &Sources) -> String {
    if there.all.is_empty() {
        return "there is no output yet: create a component".to_owned();
    }
    let common = |path: &str| path.split('/').zip(pattern.split('/')).take_while(|(a, b)| a == b).count();
    let mut all: Vec<&str> = there.all.iter().map(|source| source.path.as_str()).collect();
    all.sort_by_key(|path| std::cmp::Reverse(common(path)));
    format!("{}there are: {}", meant([pattern], &all), listed(&all))
}

/// Returns the outputs that the patterns mean; each pattern has to mean one.
fn chosen(patterns: &[String], there: &Sources) -> Result<Vec<Source>, Failure> {
    for pattern in patterns {
        if !there.all.iter().any(|source| select::matches(pattern, &source.path)) {
            let why = format!("no output is meant by {pattern:?}");
            return Err(Failure::refused("NO_MATCH", why, instead(pattern, there)));
        }
    }
    let meant = |source: &&Source| patterns.iter().any(|pattern| select::matches(pattern, &source.path));
    Ok(there.all.iter().filter(meant).cloned().collect())
}

fn process(args: &RecordArgs, there: &Sources, wanted: &[Source]) -> Result<String, Failure> {
    let help =
        "put libtrocar_recorder.so into a plugin directory of it (`trocar plugin ls` shows what it has)";
    if let Some(named) = &args.within {
        return match there.recorders.contains(named) {
            true => Ok(named.clone()),
            false => Err(Failure::refused(
                "CLASS_NOT_FOUND",
                format!(
                    "process `{named}` has no class {CLASS}; processes with one: {}",
                    there.recorders.join(", ")
                ),
                help,
            )),
        };
    }
    let of = |process: &String| {
        wanted.iter().filter(|s| s.path.split('/').next() == Some(process.as_str())).count()
    };
    there
        .recorders
        .iter()
        .max_by_key(|process| of(process))
        .cloned()
        .ok_or_else(|| Failure::refused("CLASS_NOT_FOUND", format!("no process has the class {CLASS}"), help))
}

/// Records from the first connection until the recording ends by itself.
async fn recording(
    args: &RecordArgs,
    session: &Session,
    path: &str,
    place: &Place,
    wanted: &[Source],
    left_out: &mut Vec<String>,
    (bar, held): (&ProgressBar, &Holding),
) -> Result<(), Failure> {
    for (n, source) in wanted.iter().enumerate() {
        let fifo = if source.frames { FRAMES } else { (QUEUE_BYTES / source.size.max(1)).clamp(16, DEEPEST) };
        let connect = ConnectArgs {
            client: format!("{path}/t{n}"),
            server: source.path.clone(),
            fifo: Some(fifo),
            drop_oldest: false,
            latest: false,
            max_age: None,
            deadline: None,
            mailbox: None,
            adapt: false,
            delay: false,
            replace: false,
            carrier: None,
            mutation: MutationArgs::default(),
        };
        if let Err(failure) = session.connect(&connect).await {
            left_out.push(format!("{}: {}", source.path, failure.message));
        }
    }
    if left_out.len() == wanted.len() {
        let first = left_out.first().cloned().unwrap_or_default();
        return Err(Failure::refused("NOTHING_CONNECTED", format!("nothing can be recorded: {first}"), ""));
    }
    let paths = [path.to_owned()];
    session.verb(Verb::Start, &paths, &MutationArgs::default()).await?;
    let request = json!({ "path": place.file, "delay": 0.0, "duration": args.seconds.unwrap_or(0.0) });
    ask(session, path, "start", Some(&request)).await?;
    let (begun, mut warned) = (Instant::now(), false);
    let mut patience = Patience::new(held, Some(bar), None);
    loop {
        tokio::time::sleep(LOOK).await;
        let status = patience.wait(async || ask(session, path, "status", None).await).await?;
        let number = |key: &str| whole(&status[key]);
        let (bytes, elapsed) = (number("bytes"), status["elapsed"].as_f64().unwrap_or(0.0));
        let lasted = begun.elapsed().as_millis() as u64;
        bar.set_position(bar.length().map_or(lasted, |all| lasted.min(all)));
        bar.set_message(progress(&status, bytes, elapsed));
        if status["phase"] == "IDLE" {
            return Ok(());
        }
        if !warned && elapsed >= 1.0 {
            warned = true;
            let warning = too_much(bytes as f64 / elapsed, Path::new(&place.directory));
            warning.iter().for_each(|text| bar.suspend(|| out::complain("warning", text)));
        }
    }
}

fn progress(status: &Value, bytes: u64, elapsed: f64) -> String {
    let number = |key: &str| whole(&status[key]);
    let rate = units::bytes_per_s(if elapsed > 0.0 { bytes as f64 / elapsed } else { 0.0 });
    let interrupted = match number("interrupted") {
        0 => String::new(),
        n => format!(", {n} interrupted"),
    };
    let (messages, lost) = (number("messages"), number("lost"));
    format!("{}, {} ({rate}), {lost} lost{interrupted}", units::count(messages, "message"), size(bytes))
}

/// Warns of so many bytes per second: that they are many, and when the disk is full.
fn too_much(rate: f64, directory: &Path) -> Option<String> {
    if rate < MUCH {
        return None;
    }
    let free = rustix::fs::statvfs(directory).map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize));
    let full = free.ok().map(|free| free as f64 / rate).filter(|s| *s < LONG_S);
    let full = full.map(|s| format!(": its disk is full in {:.0} min {:.0} s", (s / 60.0).floor(), s % 60.0));
    Some(format!(
        "{} are written{}; fewer outputs, --max-rate-hz, --video qoi or --video jpeg make it less",
        units::bytes_per_s(rate),
        full.unwrap_or_default()
    ))
}

/// Large numbers travel as text.
fn whole(value: &Value) -> u64 {
    value.as_u64().or_else(|| value.as_str().and_then(|text| text.parse().ok())).unwrap_or(0)
}

async fn ask(session: &Session, path: &str, what: &str, arg: Option<&Value>) -> Result<Value, Failure> {
    let reply = session.invoke(&format!("{path}/ctl/{what}"), arg, ANSWER_NS, false).await?;
    Ok(reply.value.unwrap_or(Value::Null))
}

/// Waits until the file is closed, after asking for it where that is needed; `inputs` is the number of
/// inputs it recorded.
async fn closed(
    session: &Session,
    path: &str,
    asked: bool,
    inputs: usize,
    patience: &mut Patience<'_>,
) -> Result<RecordedView, Failure> {
    // The recording may just have ended by itself: then there is nothing to stop.
    let stopped = !asked || patience.wait(async || ask(session, path, "stop", None).await).await.is_ok();
    let begun = Instant::now();
    loop {
        let last = patience.wait(async || ask(session, path, "last", None).await).await?;
        let text = |key: &str| last[key].as_str().unwrap_or_default().to_owned();
        if text("reason") == NOT_BEGUN {
            return Err(not_begun());
        }
        if !text("reason").is_empty() {
            let mut view = RecordedView {
                file: text("path"),
                messages: whole(&last["messages"]),
                bytes: whole(&last["bytes"]),
                lost: whole(&last["lost"]),
                interrupted: whole(&last["interrupted"]),
                whole: last["whole"] == true,
                reason: text("reason"),
                ..RecordedView::default()
            };
            // The file is whole all the same.
            if let Err(failure) = missing(session, path, inputs, &mut view).await {
                out::complain(
                    "warning",
                    &format!("which topics miss something is not known: {}", failure.message),
                );
            }
            return Ok(view);
        }
        if !stopped {
            return Err(not_begun());
        }
        if begun.elapsed() > CLOSING {
            return Err(Failure::local(
                "IO",
                format!("{path} has not closed its file after {} s", CLOSING.as_secs()),
                "look at the disk; what was written before is in the file",
            ));
        }
        tokio::time::sleep(LOOK / 4).await;
    }
}

fn not_begun() -> Failure {
    Failure::local("INTERRUPTED", "it was ended before anything was recorded", "")
}

/// The topics that miss something, or gave nothing.
async fn missing(
    session: &Session,
    path: &str,
    inputs: usize,
    view: &mut RecordedView,
) -> Result<(), Failure> {
    for n in 0..inputs {
        let topic = ask(session, path, "topic", Some(&json!(n))).await?;
        let name = topic["topic"].as_str().unwrap_or_default();
        if ["kept", "left_out", "lost", "interrupted"].iter().all(|key| whole(&topic[key]) == 0) {
            view.silent.push(name.to_owned());
        }
        for (key, to) in [("lost", &mut view.losses), ("interrupted", &mut view.interruptions)] {
            let n = whole(&topic[key]);
            if n > 0 {
                to.push((name.to_owned(), n));
            }
        }
    }
    Ok(())
}

fn bar(args: &RecordArgs, json: bool) -> ProgressBar {
    if json || !style::interactive() {
        return ProgressBar::hidden();
    }
    let (bar, template) = match args.seconds {
        Some(s) => (ProgressBar::new((s * 1e3) as u64), "{bar:30} {percent:>3} % {msg}"),
        None => (ProgressBar::new_spinner(), "{elapsed} {msg}  (Ctrl-C ends it)"),
    };
    match ProgressStyle::with_template(template) {
        Ok(shown) => bar.with_style(shown),
        Err(_) => bar,
    }
}

fn shown(view: RecordedView, session: &Session) -> Done {
    let asked = matches!(view.reason.as_str(), "stopped as asked" | "its time was over");
    let good = view.whole && asked && view.lost + view.interrupted == 0 && view.left_out.is_empty();
    if session.json() {
        session.print_json(&view)?;
    } else {
        out::say(&format!(
            "{}: {} of {}, {}, {} lost",
            view.file,
            units::count(view.messages, "message"),
            units::count(view.topics as u64, "output"),
            size(view.bytes),
            view.lost
        ));
        for left in &view.left_out {
            out::complain("warning", &format!("not recorded: {left}"));
        }
        for (topic, lost) in &view.losses {
            out::complain("warning", &format!("{topic}: {lost} lost"));
        }
        if view.lost > 0 {
            out::complain("help", LESS);
        }
        for topic in &view.silent {
            out::complain("note", &format!("{topic}: it was recorded, and gave nothing"));
        }
        for (topic, n) in &view.interruptions {
            out::complain("warning", &super::interrupted(topic, *n));
        }
        if !asked || !view.whole {
            out::complain("warning", &format!("it ended by itself: {}", view.reason));
        }
    }
    Ok(if good { Exit::Ok } else { Exit::Partial })
}
