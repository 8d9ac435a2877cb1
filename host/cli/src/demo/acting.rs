//! Does in a running demo what a surgeon would do: sets the system up, makes scans, and has pictures written.
//!
//! Invariant: every action is an ordinary call that any client could make. A refused call is made again,
//! since a process may be on its way back.

use std::convert::Infallible;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::watch;

use super::behavior::{Ask, Behavior, Picture, Scanning};
use super::layout::Layout;
use crate::failure::Failure;
use crate::out;
use crate::session::Session;

/// Deadline of one call, ns.
const DEADLINE_NS: u64 = 2_000_000_000;
/// Deadline of a call that writes a picture, with encoding and file system, ns.
const PICTURE_NS: u64 = 12_000_000_000;
/// Pause before a refused call is made again.
const AGAIN: Duration = Duration::from_millis(200);
/// A call that is refused for longer than this is reported.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause between two looks at a scan.
const LOOK: Duration = Duration::from_millis(50);
/// Pause between the end of a scan and the next one.
const BETWEEN: Duration = Duration::from_secs(1);
/// A behaviour without a scan has been seen after this long.
const SEEN: Duration = Duration::from_secs(7);
/// Phases that `progress` reports while there is no scan, and while the tip is on its way to the line.
const IDLE: &str = "IDLE";
const APPROACH: &str = "APPROACH";
/// Phase while the tip moves along the line.
const SCAN: &str = "SCAN";

/// A scan that came to its end, compared with the ground truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Scanned {
    /// Scans that came to their end.
    scans: u64,
    columns: u64,
    /// Looks at the truth while the last one ran.
    looks: usize,
    /// Distance of the tip from where it should have been.
    deviation_rms_um: f64,
    deviation_max_um: f64,
}

impl Scanned {
    fn of(columns: u64, deviations_um: &[f64]) -> Scanned {
        let squares: f64 = deviations_um.iter().map(|um| um * um).sum();
        Scanned {
            scans: 0,
            columns,
            looks: deviations_um.len(),
            deviation_rms_um: (squares / deviations_um.len().max(1) as f64).sqrt(),
            deviation_max_um: deviations_um.iter().fold(0.0, |most, um| um.abs().max(most)),
        }
    }

    pub(super) fn summary(&self) -> String {
        format!(
            "scan {}: {} columns; the tip {:.1} µm RMS beside its distance, {:.1} µm at most, in {} looks at the truth\n",
            self.scans, self.columns, self.deviation_rms_um, self.deviation_max_um, self.looks
        )
    }
}

/// The surgeon's part in a running demo.
pub(super) struct Acting<'a> {
    session: &'a Session,
    behavior: Behavior,
    layout: Layout,
    /// Number of times the behaviour was seen to its end, and the last scan.
    done: watch::Sender<(u64, Option<Scanned>)>,
}

impl<'a> Acting<'a> {
    pub(super) fn new(session: &'a Session, behavior: Behavior, layout: Layout) -> Self {
        Self { session, behavior, layout, done: watch::Sender::new((0, None)) }
    }

    /// The last scan; none where nothing was scanned.
    pub(super) fn scanned(&self) -> Option<Scanned> {
        self.done.borrow().1
    }

    /// Acts for ever.
    pub(super) async fn keep(&self) -> Infallible {
        for ask in self.behavior.begin(self.layout) {
            self.insist(&ask).await;
        }
        let Some(scanning) = self.behavior.scanning(self.layout) else {
            loop {
                tokio::time::sleep(SEEN).await;
                self.done.send_modify(|(times, _)| *times += 1);
            }
        };
        for start in scanning.starts.iter().cycle() {
            self.insist(start).await;
            if let Some(scanned) = self.scan(&scanning).await {
                self.done.send_modify(|(times, last)| {
                    *times += 1;
                    *last = Some(Scanned { scans: *times, ..scanned });
                });
            }
            tokio::time::sleep(BETWEEN).await;
        }
        // This circle has no end.
        std::future::pending().await
    }

    /// Repeats a call until it is granted.
    async fn insist(&self, ask: &Ask) {
        let (begun, mut told) = (tokio::time::Instant::now(), false);
        while let Err(failure) = self.call(&ask.path, Some(&ask.arg), DEADLINE_NS).await {
            if begun.elapsed() > PATIENCE && !std::mem::replace(&mut told, true) {
                out::complain("warning", &format!("{} is refused: {}", ask.path, failure.message));
            }
            tokio::time::sleep(AGAIN).await;
        }
    }

    /// Watches a scan until the tip is at the end of the line; `None` where the tip does not get there.
    async fn scan(&self, scanning: &Scanning) -> Option<Scanned> {
        let mut deviations_um = Vec::new();
        loop {
            tokio::time::sleep(LOOK).await;
            let progress = self.call(&scanning.progress, None, DEADLINE_NS).await.ok()?;
            match progress["phase"].as_str()? {
                APPROACH => {}
                SCAN => {
                    let truth = self.call(&scanning.truth, None, DEADLINE_NS).await.ok()?;
                    deviations_um.push(1e6 * (truth["distance"].as_f64()? - scanning.offset_m));
                }
                phase => {
                    let (columns, of) = (progress["columns"].as_u64()?, progress["of"].as_u64()?);
                    let is_whole = !deviations_um.is_empty() && (phase != IDLE || columns == of);
                    return is_whole.then(|| Scanned::of(columns, &deviations_um));
                }
            }
        }
    }

    /// Has all pictures written once the behaviour was seen to its end.
    pub(super) async fn write(&self, dir: &Path) -> Result<Vec<PathBuf>, Failure> {
        let mut done = self.done.subscribe();
        // `self` holds the sender.
        let _ = done.wait_for(|(times, _)| *times > 0).await;
        let mut written = Vec::new();
        for Picture { save, name } in self.behavior.pictures(self.layout) {
            let path = dir.join(name);
            self.call(&save, Some(&json!({ "path": path })), PICTURE_NS).await?;
            written.push(path);
        }
        Ok(written)
    }

    async fn call(&self, path: &str, arg: Option<&Value>, deadline_ns: u64) -> Result<Value, Failure> {
        Ok(self.session.invoke(path, arg, deadline_ns, false).await?.value.unwrap_or_default())
    }
}

/// The directory for pictures, made where it is not there; none of them may be in it.
pub(super) fn directory(dir: &Path, behavior: Behavior, layout: Layout) -> Result<PathBuf, Failure> {
    let made = fs::create_dir_all(dir).and_then(|()| dir.canonicalize());
    let dir = made.map_err(|e| {
        Failure::local(
            "IO",
            format!("{} is no directory for pictures: {e}", dir.display()),
            "name a directory that can be made: --pictures DIR",
        )
    })?;
    let there = behavior
        .pictures(layout)
        .into_iter()
        .map(|picture| dir.join(picture.name))
        .find(|path| path.exists());
    there.map_or(Ok(dir), |path| {
        Err(Failure::local(
            "FILE_EXISTS",
            format!("{} is there already, and no picture is overwritten", path.display()),
            "name another directory, or remove it first",
        ))
    })
}
