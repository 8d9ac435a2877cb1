//! `trocar record PATTERN… -o F`: a recorder made for one recording, and taken away at its end.
//!
//! Invariant: whatever ends it (time, Ctrl-C, a closed terminal, a full disk), the file is closed first and no component stays behind.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::{Value, json};
use tokio::signal::unix::{SignalKind, signal};

use super::info::size;
use super::select;
use crate::cli::connect::ConnectArgs;
use crate::cli::create::CreateArgs;
use crate::cli::execution::ExecutionArgs;
use crate::cli::failure::{Done, Exit, Failure};
use crate::cli::mutation::MutationArgs;
use crate::cli::session::Session;
use crate::cli::session::recording::{Source, Sources};
use crate::cli::states::Verb;
use crate::cli::{out, style};

const CLASS: &str = "recorder/recorder";
/// Of its thread, above everything without one: what the disk does for it in the kernel may hold such threads up for 100 ms.
const PRIORITY: u8 = 1;
/// How often it is looked at, and what is shown renewed.
const LOOK: Duration = Duration::from_millis(200);
/// A question to the recorder, ns.
const ANSWER_NS: u64 = 5_000_000_000;
/// How long the end of a file may take, on a disk that is slow.
const CLOSING: Duration = Duration::from_secs(60);
/// Samples that may wait, at most, and bytes of them.
const DEEPEST: u32 = 4096;
const QUEUE_BYTES: u32 = 16 << 20;
/// Frames that may wait: a queue leaves their pool enough for its owner, however deep it is.
const FRAMES: u32 = 64;

const EXAMPLES: &str = "\
Example:
  trocar record 'robot/**' oct/ascan/ascan -o trial.mcap --seconds 60
Ctrl-C ends it, with a whole file. A pattern is process/component/output; * stands for any part of a name, ** for any names.";

/// Records outputs to an MCAP file: `trocar record 'host/**' -o trial.mcap`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(in crate::cli) struct RecordArgs {
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
}

#[derive(Debug, Default, Serialize)]
struct RecordedView {
    file: String,
    topics: usize,
    messages: u64,
    bytes: u64,
    lost: u64,
    whole: bool,
    reason: String,
    /// What could not be connected, and why.
    left_out: Vec<String>,
    /// Topics with losses.
    losses: Vec<(String, u64)>,
}

pub(in crate::cli) async fn run(args: RecordArgs, session: &Session) -> Done {
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
    });
    let create = CreateArgs {
        path: path.clone(),
        class: CLASS.to_owned(),
        config: Some(config),
        isolation: None,
        execution: ExecutionArgs { priority: Some(PRIORITY), ..ExecutionArgs::default() },
        mutation: MutationArgs::default(),
    };
    session.create(&create).await?;
    let recorded = tokio::select! {
        recorded = recording(&args, session, &path, &place, &wanted) => recorded,
        () = interrupted() => Ok(None),
    };
    // Interrupted before or while it records: what is there is closed, and then shown as usual.
    let recorded = match recorded {
        Ok(None) => closed(session, &path, true).await,
        Ok(Some(view)) => Ok(view),
        Err(failure) => Err(failure),
    };
    let removed = session.remove(std::slice::from_ref(&path), true, &MutationArgs::default()).await;
    let mut view = recorded?;
    removed?;
    view.topics = wanted.len() - view.left_out.len().min(wanted.len());
    shown(view, session)
}

/// Ctrl-C, a closed terminal, or an end that was asked for: a recording without its program would go on for ever.
async fn interrupted() {
    let signals = [SignalKind::interrupt(), SignalKind::hangup(), SignalKind::terminate()].map(signal);
    let [Ok(mut interrupt), Ok(mut hangup), Ok(mut terminate)] = signals else {
        let _ = tokio::signal::ctrl_c().await;
        return;
    };
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = hangup.recv() => {}
        _ = terminate.recv() => {}
    }
}

struct Place {
    directory: String,
    file: String,
}

/// Where the file is to be: the host may run elsewhere, so its directory is said whole.
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

/// What the patterns mean; each has to mean something.
fn chosen(patterns: &[String], there: &Sources) -> Result<Vec<Source>, Failure> {
    let names = || {
        let all: Vec<&str> = there.all.iter().map(|s| s.path.as_str()).take(40).collect();
        let more = there.all.len().saturating_sub(all.len());
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        format!("there are: {}{more}", all.join(", "))
    };
    for pattern in patterns {
        if !there.all.iter().any(|source| select::matches(pattern, &source.path)) {
            let help = if there.all.is_empty() {
                "there is no output yet: create a component".to_owned()
            } else {
                names()
            };
            return Err(Failure::refused("NO_MATCH", format!("no output is meant by {pattern:?}"), help));
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

/// From the first connection to the end of the file; none where it is still to be closed.
async fn recording(
    args: &RecordArgs,
    session: &Session,
    path: &str,
    place: &Place,
    wanted: &[Source],
) -> Result<Option<RecordedView>, Failure> {
    let mut left_out = Vec::new();
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
    let bar = bar(args, session.json());
    let begun = Instant::now();
    loop {
        tokio::time::sleep(LOOK).await;
        let status = ask(session, path, "status", None).await?;
        let number = |key: &str| whole(&status[key]);
        bar.set_position(begun.elapsed().as_millis() as u64);
        bar.set_message(format!(
            "{} messages, {}, {} lost",
            number("messages"),
            size(number("bytes")),
            number("lost")
        ));
        if status["phase"] == "IDLE" {
            break;
        }
    }
    bar.finish_and_clear();
    let mut view = closed(session, path, false).await?;
    view.left_out = left_out;
    for n in 0..wanted.len() {
        if view.lost == 0 {
            break;
        }
        let topic = ask(session, path, "topic", Some(&json!(n))).await?;
        let lost = whole(&topic["lost"]);
        if lost > 0 {
            view.losses.push((topic["topic"].as_str().unwrap_or_default().to_owned(), lost));
        }
    }
    Ok(Some(view))
}

/// Large numbers travel as text.
fn whole(value: &Value) -> u64 {
    value.as_u64().or_else(|| value.as_str().and_then(|text| text.parse().ok())).unwrap_or(0)
}

async fn ask(session: &Session, path: &str, what: &str, arg: Option<&Value>) -> Result<Value, Failure> {
    let reply = session.invoke(&format!("{path}/ctl/{what}"), arg, ANSWER_NS, false).await?;
    Ok(reply.value.unwrap_or(Value::Null))
}

/// Waits until the file is closed, after asking for it where it has to be asked for.
async fn closed(session: &Session, path: &str, asked: bool) -> Result<RecordedView, Failure> {
    // It may just have ended by itself: then there is nothing to stop.
    let stopped = !asked || ask(session, path, "stop", None).await.is_ok();
    let begun = Instant::now();
    loop {
        let last = ask(session, path, "last", None).await?;
        let text = |key: &str| last[key].as_str().unwrap_or_default().to_owned();
        if !text("reason").is_empty() {
            return Ok(RecordedView {
                file: text("path"),
                messages: whole(&last["messages"]),
                bytes: whole(&last["bytes"]),
                lost: whole(&last["lost"]),
                whole: last["whole"] == true,
                reason: text("reason"),
                ..RecordedView::default()
            });
        }
        if !stopped {
            return Err(Failure::local("INTERRUPTED", "it was ended before anything was recorded", ""));
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
    let good = view.whole && asked && view.lost == 0 && view.left_out.is_empty();
    if session.json() {
        session.print_json(&view)?;
    } else {
        out::say(&format!(
            "{}: {} messages of {} outputs, {}, {} lost",
            view.file,
            view.messages,
            view.topics,
            size(view.bytes),
            view.lost
        ));
        for left in &view.left_out {
            out::complain("warning", &format!("not recorded: {left}"));
        }
        for (topic, lost) in &view.losses {
            out::complain("warning", &format!("{topic}: {lost} lost"));
        }
        if !asked || !view.whole {
            out::complain("warning", &format!("it ended by itself: {}", view.reason));
        }
    }
    Ok(if good { Exit::Ok } else { Exit::Partial })
}
