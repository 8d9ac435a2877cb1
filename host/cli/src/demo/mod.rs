//! `trocar demo`: a surgical system on simulated devices, in one process or several, with a live table.
//!
//! Invariant: it is an ordinary system file through ordinary plugins, and several processes are kept as
//! `trocar up` keeps them. Every call to it is one that any client could make.

mod acting;
mod behavior;
mod face;
mod head;
mod layout;
mod measure;

use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;

use self::acting::Acting;
use self::behavior::Behavior;
use self::face::Face;
use self::head::Head;
use self::layout::Layout;
use self::measure::{Parts, Reading, Report, Tally, measure};
use super::alike::folded;
use super::failure::{Done, Exit, Failure};
use super::logging::Diverted;
use super::screen::Screen;
use super::session::Session;
use super::up::programs::{self, Launch};
use super::up::{self, System};
use super::{hosting, logging, out, run, session, style};
use trocar::host::{HostConfig, StateChoice, StateDir, StopRequest};
use trocar::system_file::SystemFile;

/// The source of the video.
const SOURCE: &str = "host/camera";
/// The inputs of the video chain: frames that arrive at the last one went all the way.
const CHAIN: [&str; 3] = ["host/overlay/image", "host/pip/image", "host/display/image"];
/// Time that the component that commands the robot may take to stop.
const REST: Duration = Duration::from_secs(1);
/// Time for the way out: a robot takes less than this for 0.4 mm.
const WAY_OUT: Duration = Duration::from_millis(150);

const EXAMPLES: &str = "\
While it runs, in another terminal:
  trocar ls
  trocar top
  trocar call host/bscan/scan/progress

In several processes, host/robot is robot/robot. One that is killed comes back; its robot then waits:
  trocar resume robot/robot

Pictures of it, without a screen:
  trocar demo --behavior bscan --pictures pictures";

/// Runs a small surgical system: a simulated eye, robot, OCT and stereo microscope, real processing and
/// control, a live table.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct DemoArgs {
    /// What the surgeon does.
    #[arg(long, value_enum, default_value_t = Behavior::Bscan)]
    behavior: Behavior,
    /// End after measuring for this many seconds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: Option<u64>,
    /// In how many processes: with 2 the robot (or the hand) has one of its own, with 3 the OCT, too.
    #[arg(long, default_value = "1", value_name = "N", value_parser = processes)]
    processes: usize,
    /// Write pictures of what was done into this directory, and end when they are there, or after --seconds.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Plugin directory; may be given several times [default: where this program lies].
    #[arg(long, value_name = "DIR")]
    plugins: Vec<PathBuf>,
    /// Address to listen on; port 0 takes a free one.
    #[arg(long, default_value = session::DEFAULT_GCM, value_name = "ADDR")]
    listen: String,
    #[command(flatten)]
    port: hosting::PortArgs,
}

fn processes(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if (1..=layout::MOST).contains(&n) => Ok(n),
        _ => {
            Err("the demo runs in 1, 2 or 3 processes: all in one, the robot apart, or robot and OCT apart; \
                  `trocar up FILE` runs any system in any number"
                .to_owned())
        }
    }
}

pub(super) async fn run(args: DemoArgs, session: &Session) -> Done {
    if session.explicit_gcm().is_some() {
        return Err(Failure::usage(
            "`trocar demo` has a GCM of its own",
            "leave --gcm out; --listen sets its address",
        ));
    }
    logging::install(log::LevelFilter::Warn);
    let warnings = (Screen::is_possible() && !session.json()).then(Diverted::begin);
    let (behavior, layout) = (args.behavior, Layout::of(args.processes));
    let pictures = args.pictures.map(|dir| acting::directory(&dir, behavior, layout)).transpose()?;
    let file = layout.file("demo.json", behavior.system())?;
    let plugins = if args.plugins.is_empty() { own_directory() } else { args.plugins };
    let (seconds, port, warnings) = (args.seconds, args.port, Cell::new(warnings));
    let tally = RefCell::new(None);
    let show = Show { seconds, pictures, session, behavior, layout, port, warnings, tally };
    if layout.processes() == 1 {
        in_one(&file, plugins, args.listen, &show).await
    } else {
        in_several(&file, &plugins, &args.listen, &show).await
    }
}

async fn in_one(file: &SystemFile, plugins: Vec<PathBuf>, listen: String, show: &Show<'_>) -> Done {
    let config = run::config(file, Path::new(""), plugins, listen)?;
    let config = HostConfig { rules: show.port.rules(), ..config };
    let mut stop = StopRequest::listen();
    let host = config.start().await?;
    logging::to_readers(host.own_lines());
    let done = match run::bring_up(&host, file, &mut stop).await {
        Ok(true) => {
            let addr = hosting::address(&host);
            let head = show.begin(&format!(", listening on {addr}"), &addr);
            show.begin_count(&addr).await;
            let ended = tokio::select! {
                ended = show.run(&addr, &head) => ended,
                () = stop.asked() => Ok(None),
            };
            let done = show.over(ended, &addr).await;
            show.rest(&addr).await;
            done
        }
        Ok(false) => Ok(early()),
        Err(failure) => Err(built(failure)),
    };
    host.shutdown().await;
    done
}

async fn in_several(file: &SystemFile, plugins: &[PathBuf], listen: &str, show: &Show<'_>) -> Done {
    let mut stop = StopRequest::listen();
    let state = StateDir::open(&StateChoice::Ephemeral, false)?;
    let gcm = programs::gcm(listen, state.path(), show.port, None);
    let launch = Launch::new(file, Path::new("demo.json"), plugins, state.path(), show.port);
    let mut system = System::of_this_machine(up::Gcm::Own(Box::new(gcm)), launch)?;
    let came_up = tokio::select! {
        came_up = system.come_up(file) => Some(came_up),
        () = stop.asked() => None,
    };
    let done = match came_up {
        Some(Ok(up)) => {
            folded(up.warnings).iter().for_each(|warning| logging::warn(warning));
            let how = format!(" in {} processes, GCM {}", file.processes.len(), up.addr);
            let head = show.begin(&how, &up.addr);
            show.begin_count(&up.addr).await;
            // On a terminal the table says it.
            let voice = (!style::interactive()).then(|| up::voice("demo"));
            let ended = tokio::select! {
                never = system.keep(file, voice.as_ref()) => match never {},
                ended = show.run(&up.addr, &head) => ended,
                () = stop.asked() => Ok(None),
            };
            let done = show.over(ended, &up.addr).await;
            show.rest(&up.addr).await;
            done
        }
        Some(Err(failure)) => Err(built(failure)),
        None => Ok(early()),
    };
    system.take_down().await;
    done
}

/// Reports that the demo was asked to end before there was anything to summarize.
fn early() -> Exit {
    out::complain("note", "the demo was ended while it started, so there is no summary");
    Exit::Interrupted
}

/// Display of a running demo.
struct Show<'a> {
    seconds: Option<u64>,
    pictures: Option<PathBuf>,
    session: &'a Session,
    behavior: Behavior,
    layout: Layout,
    port: hosting::PortArgs,
    /// Set while a screen shows the warnings.
    warnings: Cell<Option<Diverted>>,
    /// Counts of the summary of a demo that the user ends, from when it came up.
    tally: RefCell<Option<Tally>>,
}

impl Show<'_> {
    /// The head: what there is to see and to try.
    fn begin(&self, how: &str, addr: &str) -> Head {
        if self.session.json() && self.seconds.is_none() && self.pictures.is_none() {
            out::line(&serde_json::json!({ "listening": addr, "viewer": hosting::viewer(addr) }).to_string());
        }
        Head {
            title: format!("trocar demo {} is running{how}", self.behavior.name()),
            addr: addr.to_owned(),
            command: format!("{}/{}", self.layout.place(self.behavior.leader()), self.behavior.command()),
        }
    }

    /// Notes the counters that the summary starts from; with `--json` there is none.
    async fn begin_count(&self, addr: &str) {
        let asking = Session::new(Some(addr.to_owned()), false);
        if !self.session.json() {
            let from = Reading::now(&asking).await.ok();
            self.tally.replace(from.map(|from| Tally::new(&from, self.parts())));
        }
    }

    fn parts(&self) -> Parts {
        let place = |path| self.layout.place(path);
        Parts {
            behavior: self.behavior.name(),
            robot: place(self.behavior.leader()),
            source: place(SOURCE),
            chain: CHAIN.map(place).into(),
        }
    }

    /// Runs until the measurement is over and the pictures are written; `None` where the user
    /// ended it before.
    async fn run(&self, addr: &str, head: &Head) -> Result<Option<Ended>, Failure> {
        let asking = Session::new(Some(addr.to_owned()), false);
        let acting = Acting::new(&asking, self.behavior, self.layout);
        let mut face = Face::open(&asking, self.session.json(), head.for_a_screen(), &head.lines());
        tokio::select! {
            () = face.keep(|all| self.tally.borrow_mut().iter_mut().for_each(|tally| tally.add(all))) => Ok(None),
            never = acting.keep() => match never {},
            ended = self.end(&asking, &acting) => {
                let (report, pictures) = ended?;
                Ok(Some(Ended { report: report.map(|report| report.with(acting.scanned())), pictures }))
            }
        }
    }

    /// Prints the result; for a demo that the user ended, the figures since it came up.
    async fn over(&self, ended: Result<Option<Ended>, Failure>, addr: &str) -> Done {
        drop(self.warnings.take());
        let ended = ended?;
        if self.session.json() {
            return ended.map_or(Ok(Exit::Ok), |ended| self.session.print_json(&ended));
        }
        let Some(ended) = ended else {
            let asking = Session::new(Some(addr.to_owned()), false);
            let tally = self.tally.take();
            if let (Some(tally), Ok(to)) = (tally, Reading::now(&asking).await) {
                out::text(&tally.report(&to).summary());
            }
            if let Some(dir) = &self.pictures {
                let name = self.behavior.name();
                out::complain(
                    "note",
                    &format!(
                        "{} may lack pictures: they are written when {name} was seen to its end",
                        dir.display()
                    ),
                );
            }
            return Ok(Exit::Ok);
        };
        if let Some(report) = &ended.report {
            out::text(&report.summary());
        }
        for path in &ended.pictures {
            out::line(&path.display().to_string());
        }
        Ok(Exit::Ok)
    }

    /// Stops the component that commands the robot before the robot itself: the hold and the way out of the
    /// eye that a scan sends when it ends still find a robot that takes them.
    async fn rest(&self, addr: &str) {
        let Some(commander) = self.behavior.commander() else { return };
        let asking = Session::new(Some(addr.to_owned()), false);
        let stop = asking.stop_all_of(vec![self.layout.place(commander)], REST);
        // A component that does not stop now is stopped with all the rest.
        if let Ok(Ok(())) = tokio::time::timeout(REST, stop).await {
            tokio::time::sleep(WAY_OUT).await;
        }
    }

    /// Measures and writes pictures as asked; without either it runs for ever.
    async fn end(
        &self,
        asking: &Session,
        acting: &Acting<'_>,
    ) -> Result<(Option<Report>, Vec<PathBuf>), Failure> {
        let parts = self.parts();
        let measured = async {
            match self.seconds {
                Some(seconds) => measure(asking, &parts, seconds).await.map(Some),
                None => Ok(None),
            }
        };
        let written = async {
            match &self.pictures {
                Some(dir) => acting.write(dir).await,
                None => Ok(Vec::new()),
            }
        };
        if self.seconds.is_none() && self.pictures.is_none() {
            return std::future::pending().await;
        }
        tokio::try_join!(measured, written)
    }
}

/// Object that `--json` prints at the end.
#[derive(Serialize)]
struct Ended {
    #[serde(flatten)]
    report: Option<Report>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<PathBuf>,
}

fn own_directory() -> Vec<PathBuf> {
    let own = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_owned));
    own.into_iter().collect()
}

/// A missing class means here that the plugins are not built, or elsewhere; the file that needs it is no file
/// of the user.
fn built(mut failure: Failure) -> Failure {
    if failure.reason == "CLASS_NOT_FOUND" {
        let said = failure.message.split_once(": ").map_or("", |(_, said)| said).to_owned();
        failure.message = format!("the demo needs plugins that are missing: {said}");
        failure.help = "build the plugins beside this program (`cargo build --release`), or name their directory: --plugins DIR".to_owned();
    }
    failure
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_plugins_are_told_without_a_file_that_nobody_has() {
        let said = "demo.json:17:16: process `host` has no class `bscan/bscan`; there are none";
        let failure = built(Failure::refused("CLASS_NOT_FOUND", said.to_owned(), String::new()));
        let expected = "the demo needs plugins that are missing: process `host` has no class `bscan/bscan`; there are none";
        assert_eq!(failure.message, expected);
        assert!(failure.help.contains("--plugins DIR"), "{}", failure.help);
    }

    #[test]
    fn other_numbers_of_processes_are_refused_with_what_is_possible() {
        for text in ["0", "4", "many"] {
            assert!(processes(text).is_err_and(|why| why.contains("1, 2 or 3")), "{text}");
        }
    }
}
