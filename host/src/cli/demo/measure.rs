//! What the demo did in a window of time, told by its GCM.
//!
//! Invariant: a window begins and ends right after a step of the robot, when its counters agree with its time grid; in
//! between it may be late, and the machine may be busy, without a count being off.

use std::time::{Duration, Instant};

use serde::Serialize;

use super::acting::Scanned;
use crate::cli::failure::Failure;
use crate::cli::session::Session;
use crate::cli::top::rates::since;
use crate::cli::units;
use crate::cli::view::{ConnectionView, StatsView, SystemView};

/// Threads, caches and the robot's first motion settle before figures are taken.
const SETTLE: Duration = Duration::from_millis(500);
/// Two looks and the time between them that took no longer place a step well: less than half a period of the robot.
const SHARP: Duration = Duration::from_micros(400);
/// After this long the best place found is taken.
const PATIENCE: Duration = Duration::from_millis(500);

/// Paths of what is measured.
pub(super) struct Parts {
    pub(super) behavior: &'static str,
    pub(super) robot: String,
    pub(super) source: String,
    /// The inputs of the video on its way; the last one is where it ends.
    pub(super) chain: Vec<String>,
}

/// What `--json` prints at the end.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Report {
    behavior: &'static str,
    seconds: f64,
    processes: usize,
    robot: Steps,
    video: Video,
    /// The last scan, where one came to its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan: Option<Scanned>,
}

/// What a component did in a window.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct Steps {
    executed: u64,
    skipped: u64,
    overruns: u64,
    rate_hz: f64,
    lateness_p50_ns: u64,
    lateness_p99_ns: u64,
    lateness_max_ns: u64,
}

#[derive(Clone, Debug, Serialize)]
struct Video {
    /// Stereo pairs that reached the end of the chain.
    pairs: u64,
    rate_hz: f64,
    /// Lost on any connection of the chain.
    drops: u64,
    /// Frames the source left out: their time was over before it ran.
    left_out: u64,
    latency_p50_ns: u64,
    latency_p99_ns: u64,
}

/// Measures for exactly `seconds`.
pub(super) async fn measure(session: &Session, parts: &Parts, seconds: u64) -> Result<Report, Failure> {
    let window = Duration::from_secs(seconds);
    tokio::time::sleep(SETTLE).await;
    let robot = async {
        let a = after_step(session, &parts.robot).await?;
        tokio::time::sleep_until((a.at + window).into()).await;
        Ok::<_, Failure>((a, after_step(session, &parts.robot).await?))
    };
    let system = async {
        let a = Reading::now(session).await?;
        tokio::time::sleep_until((a.at + window).into()).await;
        Ok::<_, Failure>((a, Reading::now(session).await?))
    };
    let (robot, system) = tokio::try_join!(robot, system)?;
    Ok(Report::between(&robot, &system, parts, window))
}

/// The robot's counters right after one of its steps.
struct Robot {
    at: Instant,
    stats: StatsView,
}

/// A look that was itself held up says nothing about the time it was taken: the next step is waited for, and the best of
/// them kept.
async fn after_step(session: &Session, robot: &str) -> Result<Robot, Failure> {
    let look = || async {
        let begun = Instant::now();
        let found = session.list_of(robot).await?;
        let stats = found.components.first().map(|c| c.stats.clone()).unwrap_or_default();
        Ok::<_, Failure>((begun, Instant::now(), stats))
    };
    let begin = Instant::now();
    let mut best: Option<(Duration, Robot)> = None;
    let mut last = look().await?;
    loop {
        let now = look().await?;
        let took = now.1 - last.0;
        let stepped = now.2.executed + now.2.skipped != last.2.executed + last.2.skipped;
        if stepped && best.as_ref().is_none_or(|(least, _)| took < *least) {
            best = Some((took, Robot { at: last.0 + took / 2, stats: now.2.clone() }));
        }
        match best.take() {
            Some((took, robot)) if took < SHARP || begin.elapsed() > PATIENCE => return Ok(robot),
            None if begin.elapsed() > PATIENCE => return Ok(Robot { at: now.1, stats: now.2 }),
            found => best = found,
        }
        last = now;
    }
}

/// All counters at one moment.
struct Reading {
    at: Instant,
    all: SystemView,
}

impl Reading {
    async fn now(session: &Session) -> Result<Reading, Failure> {
        let all = session.list().await?;
        Ok(Reading { at: Instant::now(), all })
    }

    fn stats(&self, path: &str) -> StatsView {
        let found = self.all.components.iter().find(|c| c.path == path);
        found.map(|c| c.stats.clone()).unwrap_or_default()
    }

    /// Lost on the way of the video.
    fn lost(&self, parts: &Parts) -> u64 {
        let video = self.all.connections.iter().filter(|c| parts.chain.contains(&c.client));
        video.map(|c| c.dropped).sum()
    }

    fn end(&self, parts: &Parts) -> ConnectionView {
        self.all
            .connections
            .iter()
            .find(|c| Some(&c.client) == parts.chain.last())
            .cloned()
            .unwrap_or_default()
    }
}

impl Steps {
    /// `beyond`: steps that are not of the window any more.
    fn between(from: &StatsView, to: &StatsView, beyond: u64, seconds: f64) -> Self {
        let executed = since(from.executed, to.executed);
        Self {
            executed: executed.saturating_sub(beyond),
            skipped: since(from.skipped, to.skipped),
            overruns: since(from.overruns, to.overruns),
            rate_hz: if seconds > 0.0 { executed as f64 / seconds } else { 0.0 },
            lateness_p50_ns: to.lateness_p50_ns,
            lateness_p99_ns: to.lateness_p99_ns,
            lateness_max_ns: to.lateness_max_ns,
        }
    }
}

impl Report {
    fn between(
        robot: &(Robot, Robot),
        system: &(Reading, Reading),
        parts: &Parts,
        window: Duration,
    ) -> Report {
        let ((from, to), (a, b)) = (robot, system);
        // Periods that began after the window, in the time by which the robot was looked at too late.
        let stepping = to.at - from.at;
        let robot = b.all.components.iter().find(|c| c.path == parts.robot);
        let period_ns = robot.map_or(0, |c| c.execution.period_ns).max(1);
        let late_ns = stepping.saturating_sub(window).as_nanos();
        let beyond = (late_ns as f64 / period_ns as f64).round() as u64;
        let seconds = (b.at - a.at).as_secs_f64();
        let left_out = since(a.stats(&parts.source).skipped, b.stats(&parts.source).skipped);
        let end = b.end(parts);
        let pairs = since(a.end(parts).passed, end.passed);
        Report {
            behavior: parts.behavior,
            seconds,
            processes: b.all.processes.len(),
            robot: Steps::between(&from.stats, &to.stats, beyond, stepping.as_secs_f64()),
            video: Video {
                pairs,
                rate_hz: if seconds > 0.0 { pairs as f64 / seconds } else { 0.0 },
                drops: since(a.lost(parts), b.lost(parts)),
                left_out,
                latency_p50_ns: end.latency_p50_ns,
                latency_p99_ns: end.latency_p99_ns,
            },
            scan: None,
        }
    }

    pub(super) fn with(self, scan: Option<Scanned>) -> Report {
        Report { scan, ..self }
    }

    pub(super) fn summary(&self) -> String {
        let (robot, video) = (&self.robot, &self.video);
        let scan = self.scan.as_ref().map(Scanned::summary).unwrap_or_default();
        format!(
            "in {:.1} s: robot {} steps, {} skipped, {} overruns, late p99 {}; video {} pairs ({}), {} dropped, {} left out, latency p99 {}\n{scan}",
            self.seconds,
            robot.executed,
            robot.skipped,
            robot.overruns,
            units::time(robot.lateness_p99_ns),
            video.pairs,
            units::rate(video.rate_hz),
            video.drops,
            video.left_out,
            units::time(video.latency_p99_ns)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::view::{ComponentView, ExecutionView};

    #[test]
    fn periods_that_began_after_the_window_are_not_counted() {
        let at = Instant::now();
        let robot = |at, executed, skipped| Robot {
            at,
            stats: StatsView { executed, skipped, ..StatsView::default() },
        };
        let execution = ExecutionView { period_ns: 1_000_000, ..ExecutionView::default() };
        let component = ComponentView { path: "r".into(), execution, ..ComponentView::default() };
        let all = SystemView { components: vec![component], ..SystemView::default() };
        let system = || Reading { at, all: all.clone() };
        let parts =
            Parts { behavior: "bscan", robot: "r".into(), source: "s".into(), chain: vec!["d".into()] };
        let stepped = (robot(at, 100, 1), robot(at + Duration::from_millis(1003), 1101, 3));
        let report = Report::between(&stepped, &(system(), system()), &parts, Duration::from_secs(1));
        assert_eq!((report.robot.executed, report.robot.skipped), (998, 2), "{report:?}");
    }
}
