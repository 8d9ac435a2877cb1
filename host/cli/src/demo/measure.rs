//! Figures of the demo in a window of time, as its GCM reports them.
//!
//! Invariant: a robot's window begins and ends right after one of its steps, when its counters agree with its
//! time grid; in between it may be late, and the machine may be busy, without a count being off. A busy
//! machine hides when a look was taken: each window says how long it lasted, and how far off that may be.

use std::time::{Duration, Instant};

use serde::Serialize;

use super::acting::Scanned;
use crate::failure::Failure;
use crate::session::Session;
use crate::top::rates::since;
use crate::units;
use crate::view::{ConnectionView, StatsView, SystemView};

/// Threads, caches and the robot's first motion settle before figures are taken.
const SETTLE: Duration = Duration::from_millis(500);
/// Two looks that, with the time between them, take no longer than this place a step well: less than half a
/// period of the robot.
const SHARP: Duration = Duration::from_micros(400);
/// After this long the best place found is taken.
const PATIENCE: Duration = Duration::from_millis(500);

/// Paths of the measured components.
pub(super) struct Parts {
    pub(super) behavior: &'static str,
    pub(super) robot: String,
    pub(super) source: String,
    /// The inputs of the video on its way; the last one is where it ends.
    pub(super) chain: Vec<String>,
}

/// Object that `--json` prints at the end.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Report {
    behavior: &'static str,
    /// The time in which the video was counted, and how far off that may be, s.
    seconds: f64,
    unsure_s: f64,
    processes: usize,
    robot: Steps,
    video: Video,
    /// The last scan, where one came to its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    scan: Option<Scanned>,
}

/// Steps of a component in a window.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct Steps {
    /// Time in which the steps were counted, and how far off that may be, s.
    ///
    /// executed + skipped = its periods.
    seconds: f64,
    unsure_s: f64,
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

/// Measures for `seconds`, or up to `PATIENCE` longer where no look is quick.
pub(super) async fn measure(session: &Session, parts: &Parts, seconds: u64) -> Result<Report, Failure> {
    let window = Duration::from_secs(seconds);
    tokio::time::sleep(SETTLE).await;
    let robot = async {
        let a = after_step(session, &parts.robot).await?;
        tokio::time::sleep_until((a.moment.at + window).into()).await;
        Ok::<_, Failure>((a, after_step(session, &parts.robot).await?))
    };
    let system = async {
        let a = Reading::now(session).await?;
        tokio::time::sleep_until((a.moment.at + window).into()).await;
        Ok::<_, Failure>((a, Reading::now(session).await?))
    };
    let (robot, system) = tokio::try_join!(robot, system)?;
    let steps = Steps::between(&robot.0, &robot.1);
    let (a, b) = (&system.0, &system.1);
    let counted = Counts::of(&a.all, parts).with(Counts::of(&b.all, parts), since);
    Ok(Report::of(steps, a.moment.until(&b.moment), counted, &b.all, parts))
}

/// The time of a look: the middle of two times, between which it was taken.
#[derive(Clone, Copy)]
struct Moment {
    at: Instant,
    /// Half of the time between the two.
    unsure: Duration,
}

impl Moment {
    fn within(from: Instant, to: Instant) -> Self {
        let unsure = (to - from) / 2;
        Self { at: from + unsure, unsure }
    }

    /// Seconds from here to there, and how far off that may be.
    fn until(&self, end: &Moment) -> (f64, f64) {
        ((end.at - self.at).as_secs_f64(), (self.unsure + end.unsure).as_secs_f64())
    }
}

/// The robot's counters right after one of its steps.
struct Robot {
    moment: Moment,
    stats: StatsView,
}

/// Reads the robot's counters right after a step. A look that was itself held up says nothing about the time
/// it was taken: the function waits for the next step, and keeps the best look.
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
            best = Some((took, Robot { moment: Moment::within(last.0, now.1), stats: now.2.clone() }));
        }
        match best.take() {
            Some((took, robot)) if took < SHARP || begin.elapsed() > PATIENCE => return Ok(robot),
            None if begin.elapsed() > PATIENCE => {
                return Ok(Robot { moment: Moment::within(now.0, now.1), stats: now.2 });
            }
            found => best = found,
        }
        last = now;
    }
}

/// All counters at one moment.
pub(super) struct Reading {
    moment: Moment,
    all: SystemView,
}

impl Reading {
    pub(super) async fn now(session: &Session) -> Result<Reading, Failure> {
        let begun = Instant::now();
        let all = session.list().await?;
        Ok(Reading { moment: Moment::within(begun, Instant::now()), all })
    }
}

fn stats_of(all: &SystemView, path: &str) -> StatsView {
    let found = all.components.iter().find(|c| c.path == path);
    found.map(|c| c.stats.clone()).unwrap_or_default()
}

/// The connection at which the video ends.
fn end_of(all: &SystemView, parts: &Parts) -> ConnectionView {
    let end = all.connections.iter().find(|c| Some(&c.client) == parts.chain.last());
    end.cloned().unwrap_or_default()
}

/// Counts of the summary: all so far, or those of a window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    executed: u64,
    skipped: u64,
    overruns: u64,
    pairs: u64,
    /// Lost on the way of the video.
    lost: u64,
    left_out: u64,
}

impl Counts {
    fn of(all: &SystemView, parts: &Parts) -> Self {
        let robot = stats_of(all, &parts.robot);
        let video = all.connections.iter().filter(|c| parts.chain.contains(&c.client));
        Self {
            executed: robot.executed,
            skipped: robot.skipped,
            overruns: robot.overruns,
            pairs: end_of(all, parts).passed,
            lost: video.map(|c| c.dropped + c.skipped).sum(),
            left_out: stats_of(all, &parts.source).skipped,
        }
    }

    /// Each by itself: `f` of what it was and what it is.
    fn with(self, now: Self, f: impl Fn(u64, u64) -> u64) -> Self {
        Self {
            executed: f(self.executed, now.executed),
            skipped: f(self.skipped, now.skipped),
            overruns: f(self.overruns, now.overruns),
            pairs: f(self.pairs, now.pairs),
            lost: f(self.lost, now.lost),
            left_out: f(self.left_out, now.left_out),
        }
    }
}

/// Counts of a demo that the user ends, added up over restarts of its processes: counters that begin anew
/// take nothing away.
pub(super) struct Tally {
    from: Moment,
    parts: Parts,
    sum: Counts,
    last: Counts,
}

impl Tally {
    pub(super) fn new(from: &Reading, parts: Parts) -> Self {
        let last = Counts::of(&from.all, &parts);
        Self { from: from.moment, parts, sum: Counts::default(), last }
    }

    /// Adds what came since the look before. What a process did after the last look at it is not known.
    pub(super) fn add(&mut self, all: &SystemView) {
        let now = Counts::of(all, &self.parts);
        self.sum = self.sum.with(self.last.with(now, since), |sum, more| sum + more);
        self.last = now;
    }

    /// Makes the report up to this look, which is not right after a step of the robot.
    pub(super) fn report(mut self, to: &Reading) -> Report {
        self.add(&to.all);
        let window = self.from.until(&to.moment);
        let robot = Steps::of(window, self.sum, &stats_of(&to.all, &self.parts.robot));
        Report::of(robot, window, self.sum, &to.all, &self.parts)
    }
}

impl Steps {
    /// In so many seconds, and how far off that may be.
    fn of((seconds, unsure_s): (f64, f64), counted: Counts, now: &StatsView) -> Self {
        let Counts { executed, skipped, overruns, .. } = counted;
        Self {
            seconds,
            unsure_s,
            executed,
            skipped,
            overruns,
            rate_hz: if seconds > 0.0 { executed as f64 / seconds } else { 0.0 },
            lateness_p50_ns: now.lateness_p50_ns,
            lateness_p99_ns: now.lateness_p99_ns,
            lateness_max_ns: now.lateness_max_ns,
        }
    }

    fn between(from: &Robot, to: &Robot) -> Self {
        let counts = |s: &StatsView| Counts {
            executed: s.executed,
            skipped: s.skipped,
            overruns: s.overruns,
            ..Counts::default()
        };
        let counted = counts(&from.stats).with(counts(&to.stats), since);
        Self::of(from.moment.until(&to.moment), counted, &to.stats)
    }
}

impl Report {
    fn of(
        robot: Steps,
        (seconds, unsure_s): (f64, f64),
        counted: Counts,
        now: &SystemView,
        parts: &Parts,
    ) -> Report {
        let end = end_of(now, parts);
        let Counts { pairs, lost, left_out, .. } = counted;
        Report {
            behavior: parts.behavior,
            seconds,
            unsure_s,
            processes: now.processes.len(),
            robot,
            video: Video {
                pairs,
                rate_hz: if seconds > 0.0 { pairs as f64 / seconds } else { 0.0 },
                drops: lost,
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
            "robot {} in {:.1} s, {} skipped, {}, late p99 {}; video {} in {:.1} s ({}), {} dropped, {} left out, latency p99 {}\n{scan}",
            units::count(robot.executed, "step"),
            robot.seconds,
            robot.skipped,
            units::count(robot.overruns, "overrun"),
            units::time(robot.lateness_p99_ns),
            units::count(video.pairs, "pair"),
            self.seconds,
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
    use crate::view::ComponentView;

    #[test]
    fn a_summary_counts_over_restarts_of_processes() {
        let parts = || Parts {
            behavior: "bscan",
            robot: "robot/robot".into(),
            source: "host/camera".into(),
            chain: vec!["host/display/image".into()],
        };
        let at = Moment::within(Instant::now(), Instant::now());
        let look = |executed, passed| {
            let stats = StatsView { executed, ..StatsView::default() };
            SystemView {
                components: vec![ComponentView {
                    path: "robot/robot".into(),
                    stats,
                    ..ComponentView::default()
                }],
                connections: vec![ConnectionView {
                    client: "host/display/image".into(),
                    passed,
                    ..ConnectionView::default()
                }],
                ..SystemView::default()
            }
        };
        let mut tally = Tally::new(&Reading { moment: at, all: look(1000, 30) }, parts());
        // Both processes end and begin anew; meanwhile one is not there at all.
        for all in [look(3000, 90), SystemView::default(), look(400, 12)] {
            tally.add(&all);
        }
        let report = tally.report(&Reading { moment: at, all: look(900, 42) });
        assert_eq!((report.robot.executed, report.video.pairs), (2000 + 900, 60 + 42));
    }

    #[test]
    fn a_window_lasts_from_the_middle_of_a_look_to_the_middle_of_another_and_says_how_far_off_that_may_be() {
        let start = Instant::now();
        let after = |ms| start + Duration::from_millis(ms);
        let robot = |from, to, executed, skipped| Robot {
            moment: Moment::within(after(from), after(to)),
            stats: StatsView { executed, skipped, ..StatsView::default() },
        };
        let steps = Steps::between(&robot(0, 2, 100, 1), &robot(1000, 1006, 1100, 3));
        let expected =
            Steps { seconds: 1.002, unsure_s: 0.004, executed: 1000, skipped: 2, ..Steps::default() };
        assert_eq!(Steps { rate_hz: 0.0, ..steps.clone() }, expected);
        assert!((steps.rate_hz - 1000.0 / 1.002).abs() < 1e-9, "{steps:?}");
    }
}
