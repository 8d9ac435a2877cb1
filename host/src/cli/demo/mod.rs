//! `trocar demo`: the shipped system on simulated devices and real images, in one process or several, with a live table.
//!
//! Invariant: it is an ordinary system file through ordinary plugins, and several processes are kept as `trocar up` keeps
//! them; nothing in the program knows what they do.

mod measure;
mod screen;

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::Value;

use self::measure::{Parts, measure};
use self::screen::Screen;
use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::up::programs::{self, Launch};
use super::up::{self, System};
use super::{hosting, logging, out, run, session, style};
use crate::host::{StateChoice, StateDir, StopRequest};
use crate::system_file::SystemFile;

/// The shipped system file.
const SYSTEM: &str = include_str!("../../../demo.json");
/// Images it plays, from the root of the repository.
const IMAGES: &str = "tests/data/chessboard";
const ROBOT: &str = "host/robot";
const SOURCE: &str = "host/source";
/// What gets a process of its own, one after the other, when there are to be more.
const APART: [&str; 2] = [ROBOT, SOURCE];
/// The component whose configuration takes the image directory.
const IMAGE_KEY: &str = "host/source.directory";
/// The last connection of the video chain: what arrives here went all the way.
const CHAIN_END: &str = "host/display/image";
/// Of the robot, to try.
const COMMAND: &str = "arm/measured_js";

const EXAMPLES: &str = "\
While it runs, in another terminal:
  trocar ls
  trocar describe host/robot
  trocar call host/robot/arm/measured_js

In several processes, host/robot is host.robot/robot. One that is killed comes back; its robot then waits:
  trocar resume host.robot/robot";

/// Runs a small surgical system: a simulated robot at 1 kHz and stereo video of real images, with a live table.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct DemoArgs {
    /// End after measuring for this many seconds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: Option<u64>,
    /// In how many processes: with 2 the robot has one of its own, with 3 the image source, too.
    #[arg(long, default_value = "1", value_name = "N", value_parser = processes)]
    processes: usize,
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

fn processes(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n) if (1..=APART.len() + 1).contains(&n) => Ok(n),
        _ => Err(
            "the demo runs in 1, 2 or 3 processes: all in one, the robot apart, or robot and image source \
                  apart; `trocar up FILE` runs any system in any number"
                .to_owned(),
        ),
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
    let images = images(args.data.as_deref())?;
    let mut file = file(args.processes)?;
    file.set(&format!("{IMAGE_KEY}={}", Value::from(images.to_string_lossy())))?;
    let plugins = if args.plugins.is_empty() { own_directory() } else { args.plugins };
    let show = Show { seconds: args.seconds, session, parts: parts(&file) };
    if args.processes == 1 {
        in_one(&file, plugins, args.listen, &show).await
    } else {
        in_several(&file, &plugins, &args.listen, &show).await
    }
}

/// The shipped file, with as much of it apart as makes this many processes.
fn file(processes: usize) -> Result<SystemFile, Failure> {
    let apart = &APART[..processes - 1];
    if apart.is_empty() {
        return Ok(SystemFile::parse("demo.json", SYSTEM.to_owned())?);
    }
    let mut json: Value = serde_json::from_str(SYSTEM).unwrap_or_default();
    for path in apart {
        json["components"][path]["isolation"] = "process".into();
    }
    Ok(SystemFile::parse("demo.json", format!("{json:#}"))?)
}

/// Where what is looked at is in this file.
fn parts(file: &SystemFile) -> Parts {
    let lives = |written: &str| {
        let spec = file.components.iter().find(|c| c.written.to_string() == written);
        spec.map_or_else(|| written.to_owned(), |c| c.id.to_string())
    };
    Parts { robot: lives(ROBOT), source: lives(SOURCE), chain_end: CHAIN_END.to_owned() }
}

async fn in_one(file: &SystemFile, plugins: Vec<PathBuf>, listen: String, show: &Show<'_>) -> Done {
    let config = run::config(file, Path::new(""), plugins, listen)?;
    let mut stop = StopRequest::listen();
    let host = config.start().await?;
    logging::to_readers(host.own_lines());
    let done = match run::bring_up(&host, file, &mut stop).await {
        Ok(true) => {
            let addr = hosting::address(&host);
            show.begin(&format!("listening on {addr}"), &addr);
            tokio::select! {
                done = show.run(&addr) => done,
                () = stop.asked() => Ok(Exit::Ok),
            }
        }
        Ok(false) => Ok(Exit::Interrupted),
        Err(failure) => Err(built(failure)),
    };
    host.shutdown().await;
    done
}

async fn in_several(file: &SystemFile, plugins: &[PathBuf], listen: &str, show: &Show<'_>) -> Done {
    let mut stop = StopRequest::listen();
    let state = StateDir::open(&StateChoice::Ephemeral, false)?;
    let gcm = programs::gcm(listen, state.path());
    let launch = Launch::new(file, Path::new("demo.json"), plugins, state.path());
    let mut system = System::new(up::Gcm::Own(gcm), launch);
    let came_up = tokio::select! {
        came_up = system.come_up(file) => Some(came_up),
        () = stop.asked() => None,
    };
    let done = match came_up {
        Some(Ok(up)) => {
            for warning in &up.warnings {
                out::complain("warning", warning);
            }
            show.begin(&format!("in {} processes, GCM {}", file.processes.len(), up.addr), &up.addr);
            // On a terminal the table says it.
            let voice = (!style::interactive()).then(|| up::voice("demo"));
            tokio::select! {
                never = system.keep(file, voice.as_ref()) => match never {},
                done = show.run(&up.addr) => done,
                () = stop.asked() => Ok(Exit::Ok),
            }
        }
        Some(Err(failure)) => Err(built(failure)),
        None => Ok(Exit::Interrupted),
    };
    system.take_down().await;
    done
}

/// How a running demo is shown.
struct Show<'a> {
    seconds: Option<u64>,
    session: &'a Session,
    parts: Parts,
}

impl Show<'_> {
    fn begin(&self, how: &str, addr: &str) {
        if self.session.json() {
            if self.seconds.is_none() {
                out::line(&serde_json::json!({ "listening": addr }).to_string());
            }
            return;
        }
        out::line(&format!("trocar demo is running {how}"));
        out::text(&run::hints(addr, Some(&format!("{}/{COMMAND}", self.parts.robot))));
        out::line("");
    }

    /// Until it has measured for as long as it was to.
    async fn run(&self, addr: &str) -> Done {
        let asking = Session::new(Some(addr.to_owned()), false);
        let mut screen = Screen::new(&asking, self.session.json());
        let report = tokio::select! {
            never = screen.keep() => match never {},
            report = measure(&asking, &self.parts, self.seconds) => report?,
        };
        if self.session.json() {
            return self.session.print_json(&report);
        }
        out::text(&report.summary());
        Ok(Exit::Ok)
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
        let mut one = file(1).unwrap();
        one.single_process().unwrap();
        one.set(&format!("{IMAGE_KEY}=x")).unwrap();
        let has = |name: &str| one.components.iter().any(|c| c.id.to_string() == name);
        assert!(has(ROBOT) && has(SOURCE), "robot or source is missing");
        assert!(
            one.connections.iter().any(|c| c.client.to_string() == CHAIN_END),
            "nothing ends at {CHAIN_END}"
        );
    }

    #[test]
    fn more_processes_are_the_same_file_with_parts_of_it_apart() {
        let one = file(1).unwrap();
        for n in [2, 3] {
            let several = file(n).unwrap();
            assert_eq!(several.processes.len(), n);
            let written = |file: &SystemFile| -> Vec<_> {
                let mut all: Vec<_> = file
                    .components
                    .iter()
                    .map(|c| (c.written.to_string(), c.class.clone(), c.config.clone(), c.execution.clone()))
                    .collect();
                all.sort_by(|a, b| a.0.cmp(&b.0));
                all
            };
            assert_eq!(written(&several), written(&one), "{n} processes: only where they are differs");
            let apart = several.components.iter().filter(|c| c.id != c.written).count();
            assert_eq!(apart, n - 1, "each further process has one component");
        }
        assert_eq!(parts(&file(3).unwrap()).robot, "host.robot/robot");
        assert!(processes("4").is_err_and(|why| why.contains("1, 2 or 3")) && processes("0").is_err());
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
