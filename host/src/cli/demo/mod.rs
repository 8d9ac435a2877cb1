//! `trocar demo`: the shipped system on simulated devices and real images, with a live table.
//!
//! Invariant: it is an ordinary system file through ordinary plugins; nothing in the program knows what they do.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use serde::Serialize;

use super::failure::{Done, Exit, Failure};
use super::figures::{Reading, Stepper, Steps, Watched, Wire, table};
use super::session::Session;
use super::{hosting, logging, out, run, session, style};
use crate::host::{Host, StopRequest};
use crate::system_file::SystemFile;

/// The shipped system file.
const SYSTEM: &str = include_str!("../../../demo.json");
/// Images it plays, from the root of the repository.
const IMAGES: &str = "tests/data/chessboard";
const ROBOT: &str = "host/robot";
const SOURCE: &str = "host/source";
/// The component whose configuration takes the image directory.
const IMAGE_KEY: &str = "host/source.directory";
/// The last connection of the video chain: what arrives here went all the way.
const CHAIN_END: &str = "host/display/image";
const TRY: &str = "host/robot/arm/measured_js";
/// Threads, caches and the robot's first motion settle before figures are taken.
const SETTLE: Duration = Duration::from_millis(500);

const EXAMPLES: &str = "\
While it runs, in another terminal:
  trocar ls
  trocar describe host/robot
  trocar call host/robot/arm/measured_js";

/// Runs a small surgical system: a simulated robot at 1 kHz and stereo video of real images, with a live table.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct DemoArgs {
    /// End after measuring for this many seconds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: Option<u64>,
    /// Directory of left*/right* images [default: tests/data/chessboard of the sources].
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Plugin directory; may be given several times [default: where this program lies].
    #[arg(long, value_name = "DIR")]
    plugins: Vec<PathBuf>,
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
}

/// What `--json` prints at the end.
#[derive(Clone, Debug, Serialize)]
struct Report {
    seconds: f64,
    robot: Steps,
    video: Video,
}

#[derive(Clone, Debug, Serialize)]
struct Video {
    /// Stereo pairs that reached the end of the chain.
    pairs: u64,
    rate_hz: f64,
    /// Lost on any connection of the chain, and frames the source left out.
    drops: u64,
    latency_p50_ns: u64,
    latency_p99_ns: u64,
}

pub(super) async fn run(args: DemoArgs, session: &Session) -> Done {
    if session.explicit_gcm().is_some() {
        return Err(Failure::usage(
            "`trocar demo` has a GCM of its own",
            "leave --gcm out; --listen sets its address",
        ));
    }
    logging::install(log::LevelFilter::Warn);
    let images = images(args.data.as_deref())?;
    let mut file = SystemFile::parse("demo.json", SYSTEM.to_owned())?;
    file.set(&format!("{IMAGE_KEY}={}", serde_json::Value::from(images.to_string_lossy())))?;
    let plugins = if args.plugins.is_empty() { own_directory() } else { args.plugins };
    let config = run::config(&file, Path::new(""), plugins, args.listen)?;
    let mut stop = StopRequest::listen();
    let host = config.start().await?;
    logging::to_readers(host.own_lines());
    let done = match run::bring_up(&host, &file, &mut stop).await {
        Ok(true) => show(&host, args.seconds, session, &mut stop).await,
        Ok(false) => Ok(Exit::Interrupted),
        Err(failure) => Err(built(failure)),
    };
    host.shutdown().await;
    done
}

async fn show(host: &Host, seconds: Option<u64>, session: &Session, stop: &mut StopRequest) -> Done {
    let Some(watched) = watched(host) else { return Ok(Exit::Ok) };
    if !session.json() {
        out::line(&format!("trocar demo is running; listening on {}", hosting::address(host)));
        out::text(&run::hints(&hosting::address(host), Some(TRY)));
        out::line("");
    } else if seconds.is_none() {
        out::line(&serde_json::json!({ "listening": hosting::address(host) }).to_string());
    }
    let measured = measure(watched.clone(), seconds);
    let mut screen = Screen::new(watched, session);
    tokio::select! {
        () = stop.asked() => {}
        never = screen.keep() => match never {},
        Some(report) = measured => {
            if session.json() {
                return session.print_json(&report);
            }
            out::text(&summary(&report));
        }
    }
    Ok(Exit::Ok)
}

/// Measures for exactly `seconds`, on a thread of its own; for ever without them.
async fn measure(watched: Watched, seconds: Option<u64>) -> Option<Report> {
    let Some(seconds) = seconds else { return std::future::pending().await };
    let window = Duration::from_secs(seconds);
    tokio::time::sleep(SETTLE).await;
    let runtime = tokio::runtime::Handle::current();
    let measuring = tokio::task::spawn_blocking(move || {
        let robot = watched.components.iter().position(|c| c.id.to_string() == ROBOT).unwrap_or_default();
        let a = watched.read_after_step(robot, &runtime);
        std::thread::sleep((a.at + window).saturating_duration_since(Instant::now()));
        let b = watched.read_after_step(robot, &runtime);
        report(&watched, &a, &b, window)
    });
    measuring.await.ok()
}

fn report(watched: &Watched, a: &Reading, b: &Reading, window: Duration) -> Report {
    let late = (b.at - a.at).saturating_sub(window);
    let steps = |name: &str| {
        let at = watched.components.iter().position(|c| c.id.to_string() == name);
        at.map(|i| Steps::between(a, b, i, watched.components[i].period_ns, late)).unwrap_or_default()
    };
    // The robot's connection carries commands, the others frames.
    let video = |name: &str| !name.starts_with(ROBOT);
    let lost = |r: &Reading| -> u64 {
        watched.wires.iter().zip(&r.links).filter(|(w, _)| video(&w.name)).map(|(_, l)| l.dropped).sum()
    };
    let end = watched.wires.iter().position(|w| w.name.ends_with(CHAIN_END));
    let passed = |r: &Reading| end.map_or(0, |i| r.links[i].passed);
    let pairs = passed(b).saturating_sub(passed(a));
    let seconds = (b.at - a.at).as_secs_f64();
    let last = end.map(|i| b.links[i].clone()).unwrap_or_default();
    Report {
        seconds,
        robot: steps(ROBOT),
        video: Video {
            pairs,
            rate_hz: pairs as f64 / seconds,
            drops: lost(b).saturating_sub(lost(a)) + steps(SOURCE).skipped,
            latency_p50_ns: last.latency_p50_ns,
            latency_p99_ns: last.latency_p99_ns,
        },
    }
}

fn summary(report: &Report) -> String {
    let (robot, video) = (&report.robot, &report.video);
    format!(
        "in {:.1} s: robot {} steps, {} skipped, {} overruns, late p99 {}; video {} pairs ({}), {} dropped, latency p99 {}\n",
        report.seconds,
        robot.executed,
        robot.skipped,
        robot.overruns,
        super::units::time(robot.lateness_p99_ns),
        video.pairs,
        super::units::rate(video.rate_hz),
        video.drops,
        super::units::time(video.latency_p99_ns)
    )
}

/// Everything the host's own graph has.
fn watched(host: &Host) -> Option<Watched> {
    let graph = host.gcm()?.graph();
    Some(Watched {
        lcm: host.lcm()?.clone(),
        components: graph
            .components
            .iter()
            .map(|(id, c)| Stepper { id: id.clone(), period_ns: c.execution.period_ns.unwrap_or(0) })
            .collect(),
        wires: graph
            .connections
            .values()
            .map(|c| Wire { id: c.id.0, name: format!("{} → {}", c.server, c.client) })
            .collect(),
    })
}

/// The live table: redrawn in place on a terminal, one table below the other elsewhere, nothing beside `--json`.
struct Screen {
    watched: Watched,
    drawn_lines: usize,
    silent: bool,
}

impl Screen {
    fn new(watched: Watched, session: &Session) -> Self {
        Self { watched, drawn_lines: 0, silent: session.json() }
    }

    /// Draws each second, for ever.
    async fn keep(&mut self) -> std::convert::Infallible {
        let mut before = self.watched.read().await;
        let mut second = tokio::time::interval(Duration::from_secs(1));
        second.tick().await;
        loop {
            second.tick().await;
            if self.silent {
                continue;
            }
            let now = self.watched.read().await;
            let text = table(&self.watched, &before, &now, style::stdout());
            let up = match (self.drawn_lines, style::interactive()) {
                (0, _) => String::new(),
                (lines, true) => format!("\x1b[{lines}A\x1b[J"),
                (_, false) => "\n".to_owned(),
            };
            out::text(&format!("{up}{text}"));
            self.drawn_lines = text.lines().count();
            before = now;
        }
    }
}

/// The image directory: what was named, or the repository's, looked for above the working directory and the program.
fn images(named: Option<&Path>) -> Result<PathBuf, Failure> {
    if let Some(dir) = named {
        return match dir.canonicalize() {
            Ok(dir) if dir.is_dir() => Ok(dir),
            Ok(dir) => Err(no_images(&format!("{} is not a directory", dir.display()))),
            Err(e) => Err(no_images(&format!("{}: {e}", dir.display()))),
        };
    }
    let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    let above = starts.iter().flatten().flat_map(|start| start.ancestors());
    let found = above.map(|dir| dir.join(IMAGES)).find(|dir| dir.is_dir());
    found.ok_or_else(|| no_images(&format!("there is no {IMAGES} above this directory or the program")))
}

fn no_images(why: &str) -> Failure {
    Failure::local(
        "NO_IMAGES",
        format!("the demo has no images: {why}"),
        "name a directory of left*/right* image pairs: --data DIR",
    )
}

fn own_directory() -> Vec<PathBuf> {
    let own = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_owned));
    own.into_iter().collect()
}

/// A missing class means here that the plugins are not built.
fn built(mut failure: Failure) -> Failure {
    if failure.reason == "CLASS_NOT_FOUND" {
        failure.help = "build the plugins beside this program (`cargo build --release`), or name their directory: --plugins DIR".to_owned();
    }
    failure
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_shipped_file_is_a_system_file_of_one_process_with_the_parts_the_figures_need() {
        let mut file = SystemFile::parse("demo.json", SYSTEM.to_owned()).unwrap();
        file.single_process().unwrap();
        file.set(&format!("{IMAGE_KEY}=x")).unwrap();
        let has = |name: &str| file.components.iter().any(|c| c.id.to_string() == name);
        assert!(has(ROBOT) && has(SOURCE), "robot or source is missing");
        assert!(
            file.connections.iter().any(|c| c.client.to_string() == CHAIN_END),
            "nothing ends at {CHAIN_END}"
        );
    }

    #[test]
    fn the_repositorys_images_are_found_from_anywhere_in_it() {
        assert!(images(None).unwrap().ends_with(IMAGES));
    }

    #[test]
    fn a_missing_image_directory_says_how_to_name_one() {
        let refused = images(Some(Path::new("/nowhere/at/all"))).unwrap_err();
        assert!(
            refused.message.contains("/nowhere/at/all") && refused.help.contains("--data"),
            "{refused:?}"
        );
    }
}
