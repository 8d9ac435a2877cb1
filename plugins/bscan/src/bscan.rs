//! The component `bscan`: Robot-Assisted B-Scan as a behaviour that can be started and aborted at any time.
//!
//! Invariant: the robot is commanded in APPROACH, SCAN and RETRACT only, by velocities that end by themselves when they are not
//! repeated, behind a guard that keeps the tip off the retina whatever is commanded. Every way out, good or bad, ends with `hold`
//! and without the guard, and is told by exactly one event; after a bad one the robot goes away from the retina by itself, by a
//! bounded way, since an eye that moves comes near a tip that stands.

mod pictures;

use trocar_oct_core::tip::{Timeline, axis_of};
use trocar_sdk::data::{
    AScanHeader, Distance, FixtureKind, ImageHeader, OperatingMode, OperatingState, Pose, Twist,
    VirtualFixture,
};
use trocar_sdk::prelude::*;

use crate::depth::{Advice, Depth, JUMP_M, Settings};
use crate::image::{Rolling, Scan};
use crate::line::Line;
use crate::payloads::{Phase, Progress, ScanColumn, ScanDone, ScanRequest};
use crate::poses::Poses;

/// Frames of each output's pool.
const SLOTS: u32 = 6;
/// The loop is not closed above this measured delay, from exposure to step and from robot to step, s. The prediction is stable to
/// 10 ms.
const LONGEST_DELAY_S: f64 = 0.012;
/// A surface that was not seen for this long ends a scan, s.
const SURFACE_LOST_S: f64 = 0.05;
/// A robot that does not tell where it is for this long ends a scan, s.
const ROBOT_LOST_S: f64 = 0.02;
/// A scan ends when the line takes longer than so many times its length over its speed, and so much more, s.
const SLOWEST: f64 = 1.5;
const LATEST_S: f64 = 2.0;
/// A robot that is further from where the line has it ends the scan, m.
const LAG_M: f64 = 0.2e-3;
/// Across the tool the tip goes to the begin only when it is this near to the offset, m.
const CLOSE_M: f64 = 50e-6;
/// The scan sets off this near to its begin and to the offset, m, after so long, s.
const NEAR_M: f64 = 15e-6;
const SETTLED_S: f64 = 0.1;
/// The tip nears the guard at most at this times the distance that is left, 1/s: the most that the robot takes.
const GUARD_PER_S: f64 = 30.0;
/// Share of a new delay in their mean.
const DELAY_SHARE: f64 = 1.0 / 32.0;

#[derive(Config)]
pub(crate) struct BScanConfig {
    /// Speed along the tool per distance from the offset
    #[config(live, min = 0.0, max = 100.0, unit = "1/s", default = 30.0)]
    kp_per_s: f64,
    /// The same, summed up over time
    #[config(live, min = 0.0, max = 2000.0, unit = "1/s^2", default = 100.0)]
    ki_per_s2: f64,
    /// How long the robot takes to answer a velocity: the lag of its drive and a period. With the measured delays it bounds the
    /// gains
    #[config(live, min = 0.0, max = 0.1, unit = "s", default = 0.009)]
    robot_lag_s: f64,
    /// Highest speed along the tool
    #[config(live, min = 1e-5, max = 0.01, unit = "m/s", default = 0.005)]
    max_speed_m_s: f64,
    /// Highest speed towards the surface, beside the surface's own
    #[config(live, min = 1e-5, max = 0.005, unit = "m/s", default = 0.0005)]
    approach_m_s: f64,
    /// The tip never goes nearer to the surface
    #[config(live, min = 0.00015, max = 0.001, unit = "m", default = 0.00015)]
    min_distance_m: f64,
    /// Way back from the surface at the end of the line, and of a scan that ends before: an eye that moves comes near a tip that
    /// stands. Its swing and min_distance_m have room in the least offset and this
    #[config(live, min = 0.0, max = 0.001, unit = "m", default = 0.0004)]
    retract_m: f64,
    /// An approach that takes longer is given up
    #[config(live, min = 0.1, max = 600.0, unit = "s", default = 30.0)]
    approach_timeout_s: f64,
    /// Rows of the images: bins of an A-scan from the first
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    rows: u32,
    /// Most columns of a scan
    #[config(min = 1, max = 4096, unit = "px", default = 1024)]
    max_columns: u32,
    /// Columns of the M-scan
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    mscan_columns: u32,
    /// A-scans of a column of the M-scan
    #[config(min = 1, max = 10000, default = 16)]
    mscan_lines: u32,
    /// Images per second
    #[config(min = 0.1, max = 100.0, unit = "Hz", default = 15.0)]
    image_rate_hz: f64,
    /// Black and white of A-scans in dB; those of bytes are taken as they are
    #[config(default = [45.0, 95.0])]
    range_db: [f64; 2],
}

impl BScanConfig {
    /// For a loop that takes `delay_s` in all.
    fn depth(&self, delay_s: f64) -> Settings {
        Settings {
            kp_per_s: self.kp_per_s,
            ki_per_s2: self.ki_per_s2,
            max_speed_m_s: self.max_speed_m_s,
            approach_m_s: self.approach_m_s,
            min_distance_m: self.min_distance_m,
            delay_s,
            ..Settings::default()
        }
    }
}

/// Robot-Assisted B-Scan: goes along a line at a constant distance from the retina and makes an image of the A-scans.
#[derive(Component)]
#[component(name = "bscan", rate_hz = 1000)]
pub struct BScan {
    /// From the tip to the retina; its tracker has to know the robot
    #[input]
    distance: In<Distance>,
    /// A-scans, f32 in dB or bytes
    #[input(optional, fifo = 32)]
    ascan: In<Frame<AScanHeader>>,
    /// The image of the scan, while it grows and when it is done
    #[output]
    bscan_image: Out<Frame<ImageHeader>>,
    /// Each column of the image when it is there: where it was taken
    #[output]
    column: Out<ScanColumn>,
    /// The last moments, the newest at the right
    #[output]
    mscan_image: Out<Frame<ImageHeader>>,
    /// Each column of the M-scan when it is there: where it was taken
    #[output]
    mscan_column: Out<ScanColumn>,
    /// Where the tip is.
    #[required(interface = "robot")]
    measured_cp: Function<(), Pose>,
    /// Whether it takes motions.
    #[required(interface = "robot")]
    operating_state: Function<(), OperatingState>,
    /// Moves the tip across the tool.
    #[required(interface = "robot", name = "servo_cv")]
    servo_across: Function<Twist>,
    /// Called at the end of each scan.
    #[required(interface = "robot")]
    hold: Function,
    /// Brings the tip away from the retina when a scan has ended before its end.
    #[required(interface = "robot", optional)]
    move_cr: Function<Pose>,
    /// Moves the tip along the tool.
    #[required(interface = "axis", name = "servo_cv")]
    servo_along: Function<Twist>,
    /// Keeps the tip min_distance_m off the retina while a scan runs: the robot's own fixture.
    #[required(interface = "fixture", optional)]
    set_guard: Function<VirtualFixture>,
    /// The scan has come to its end.
    #[event("scan")]
    bscan_done: Event<ScanDone>,
    /// The scan has ended before its end: why.
    #[event("scan")]
    bscan_aborted: Event<Text<128>>,
    #[state]
    progress: Progress,
    /// Images for which there was no frame.
    #[state]
    left_out: u64,
    /// Frames since Start that were no A-scans.
    #[state]
    refused_frames: u64,
    #[config]
    cfg: BScanConfig,
    depth: Depth,
    pose: Pose,
    /// Age of the robot's poses when they come, mean, s.
    hop_s: f64,
    /// As the robot told last.
    robot: OperatingState,
    /// Along the line, m.
    gone: Timeline,
    /// The same as it was sent, m.
    planned_m: f64,
    line: Option<Line>,
    since: Moments,
    last: Distance,
    scan: Scan,
    rolling: Rolling,
    next_image: [Stamp; 2],
    column_pose: Pose,
    /// Of the M-scan's column that grows, and columns that are there.
    rolling_pose: Pose,
    rolled: u32,
    poses: Poses,
    image_index: [u64; 2],
    /// Rows, columns, columns and A-scans of the M-scan that there is room for.
    built: Option<(usize, usize, usize, u32)>,
    /// Of the last step.
    now: Stamp,
}

/// When things began or were seen last.
#[derive(Clone, Copy, Default)]
struct Moments {
    phase: Stamp,
    /// Near to begin and offset.
    near: Stamp,
    surface: Stamp,
    robot: Stamp,
    delay_known: bool,
    /// The last surface was none that can be followed.
    jumped: bool,
}

/// The scan.
#[provides("scan")]
impl BScan {
    /// Begins a scan: goes to the offset and to the begin of the line, and then along it.
    #[command(name = "start")]
    fn begin(&mut self, request: &ScanRequest) -> Result<(), String> {
        if self.progress.phase != Phase::IDLE {
            return Err("a scan is running: abort it first, or wait for bscan_done".into());
        }
        let now = self.now;
        let line = self.line_of(request, now)?;
        self.depth.begin();
        self.scan.begin(line.columns);
        self.gone.clear();
        self.progress.scan += 1;
        (self.progress.columns, self.progress.of) = (0, line.columns as u32);
        self.line = Some(line);
        self.enter(Phase::APPROACH, now);
        Ok(())
    }

    /// Ends the scan at once; without one nothing happens.
    #[command]
    fn abort(&mut self) {
        self.give_up("aborted by command");
    }

    /// How far the scan is.
    #[read]
    fn progress(s: &BScanState) -> Progress {
        s.progress
    }
}

impl BScan {
    /// The line of a request, when all that a scan needs is there.
    fn line_of(&self, request: &ScanRequest, now: Stamp) -> Result<Line, String> {
        let axis = axis_of(&self.pose.orientation)
            .filter(|_| self.pose.is_valid() && now.seconds_since(self.pose.stamp) < ROBOT_LOST_S)
            .ok_or(
                "the robot does not tell where it is: connect its interface arm to robot, enable and home it",
            )?;
        if !is_ready(&self.robot) {
            return Err(
                "the robot takes no motion: send it state_command \"enable\" or \"resume\", then \"home\""
                    .into(),
            );
        }
        if !self.last.valid.get() || now.seconds_since(self.last.stamp) > SURFACE_LOST_S {
            return Err("there is no surface: bring the tip over the retina, some 0.3 to 1 mm away".into());
        }
        if self.last.velocity.is_nan() {
            return Err(
                "the tracker does not know the robot: connect the robot's state to its input robot".into()
            );
        }
        if self.last.distance < self.cfg.min_distance_m {
            return Err(format!(
                "the tip is {:.0} um from the surface, and min_distance_m is {:.0} um: bring it away first",
                1e6 * self.last.distance,
                1e6 * self.cfg.min_distance_m
            ));
        }
        let delay_s = self.progress.delay + self.hop_s;
        if delay_s > LONGEST_DELAY_S {
            return Err(format!(
                "the loop's delay is {:.1} ms, and above {:.0} ms it is not closed: bring source, tracker and robot nearer \
                 together",
                1e3 * delay_s,
                1e3 * LONGEST_DELAY_S
            ));
        }
        let columns = self.cfg.max_columns as usize;
        Line::of(request, self.pose.position, axis, self.cfg.min_distance_m, columns)
            .map_err(|why| why.to_string())
    }

    fn enter(&mut self, phase: Phase, now: Stamp) {
        self.progress.phase = phase;
        self.since.phase = now;
        self.since.near = Stamp::INVALID;
    }

    /// Ends a scan before its end.
    fn give_up(&mut self, why: &str) {
        if self.progress.phase == Phase::IDLE {
            return;
        }
        let told = self.now.seconds_since(self.since.robot) <= ROBOT_LOST_S;
        let axis = axis_of(&self.pose.orientation).filter(|_| told && is_ready(&self.robot));
        self.rest();
        if let Some(axis) = axis.filter(|_| self.cfg.retract_m > 0.0) {
            // One command, which the robot carries out to its end whatever becomes of this component.
            let position = axis.map(|a| -a * self.cfg.retract_m);
            self.move_cr.send(Pose { stamp: self.now, position, ..Pose::default() });
        }
        self.bscan_aborted.emit(Text::new(why));
    }

    /// The robot stands, and is not commanded any more.
    fn rest(&mut self) {
        self.hold.send(());
        self.set_guard.send(VirtualFixture::default());
        self.enter(Phase::IDLE, self.now);
        self.progress.error = 0.0;
        self.line = None;
    }

    /// Velocities along and across the tool, m/s.
    fn send(&self, stamp: Stamp, along: [f64; 3], across: [f64; 3]) {
        let twist = |linear| Twist { stamp, linear, ..Twist::default() };
        self.servo_along.send(twist(along));
        self.servo_across.send(twist(across));
    }

    /// Robot and surface as they are told.
    fn look(&mut self, now: Stamp) {
        if let Ok(pose) = self.measured_cp.call(())
            && pose.is_valid()
            && pose.position.iter().all(|p| p.is_finite())
            && pose.stamp != self.pose.stamp
        {
            self.pose = pose;
            self.poses.push(pose);
            self.hop_s += DELAY_SHARE * (now.seconds_since(pose.stamp).max(0.0) - self.hop_s);
            self.since.robot = now;
            self.depth.tip_at(pose.stamp.ns(), pose.position, &pose.orientation);
            if let Some(line) = &self.line {
                self.gone.push(pose.stamp.ns(), line.along_m(&pose.position));
            }
        }
        if let Ok(state) = self.operating_state.call(()) {
            self.robot = state;
        }
        let Some(seen) = self.distance.latest() else { return };
        if seen.stamp == self.last.stamp {
            return;
        }
        self.last = seen;
        self.progress.surface = seen.valid;
        let delay_s = now.seconds_since(seen.stamp);
        let share = if std::mem::replace(&mut self.since.delay_known, true) { DELAY_SHARE } else { 1.0 };
        self.progress.delay += share * (delay_s - self.progress.delay);
        self.progress.loop_delay = self.progress.delay + self.hop_s + self.cfg.robot_lag_s;
        if !seen.valid.get() {
            return;
        }
        // Before a scan the surface is wherever it is seen; in a scan another layer is none.
        self.since.jumped =
            self.progress.phase != Phase::IDLE && self.depth.jump_m(seen.stamp.ns(), seen.distance) > JUMP_M;
        if !self.since.jumped && self.depth.surface_at(seen.stamp.ns(), seen.distance, seen.velocity) {
            self.since.surface = now;
        }
    }

    /// Moves the robot for one period; the reason when it cannot go on.
    fn drive(&mut self, tick: &Tick) -> Result<(), &'static str> {
        let (now, dt_s) = (tick.now(), tick.period_s());
        let Some(line) = self.line else { return Ok(()) };
        if now.seconds_since(self.since.robot) > ROBOT_LOST_S {
            return Err("the robot has not told for 20 ms where it is");
        }
        if !is_ready(&self.robot) {
            return Err("the robot is no longer enabled and homed");
        }
        if now.seconds_since(self.since.surface) > SURFACE_LOST_S {
            return Err(if self.since.jumped {
                "the surface was not where it can be for 50 ms: perhaps a deeper layer was seen in its place"
            } else {
                "the surface was not seen for 50 ms"
            });
        }
        if self.progress.delay + self.hop_s > LONGEST_DELAY_S {
            return Err("the loop's delay is above 12 ms");
        }
        let offset_m = line.offset_m + self.retracted_m(now);
        let settings = self.cfg.depth(self.progress.loop_delay);
        let Some(advice) = self.depth.advise(now.ns(), dt_s, offset_m, &settings) else {
            // The robot is late: it stands until it is here again, or is lost.
            self.send(now, [0.0; 3], [0.0; 3]);
            return Ok(());
        };
        if self.progress.phase != Phase::RETRACT && advice.distance_m < self.cfg.min_distance_m {
            return Err("the tip is nearer to the surface than min_distance_m");
        }
        let Some(axis) = axis_of(&self.pose.orientation) else {
            return Err("the robot's orientation is no unit quaternion");
        };
        if !advice.blind {
            self.set_guard.send(self.guard(&axis, advice.distance_m));
        }
        self.progress.distance = advice.distance_m;
        self.progress.error = advice.distance_m - offset_m;
        let across = if advice.blind { [0.0; 3] } else { self.across(&line, &advice, tick) };
        if self.progress.phase == Phase::SCAN && line.lag_m(&self.pose.position, self.planned_m) > LAG_M {
            return Err("the robot is more than 0.2 mm away from where it should be on the line");
        }
        self.send(now, axis.map(|a| a * advice.speed_m_s), across);
        if self.progress.phase == Phase::APPROACH
            && now.seconds_since(self.since.phase) > self.cfg.approach_timeout_s
        {
            return Err("the begin of the line was not reached in time");
        }
        let latest_s = SLOWEST * line.length_m / line.speed_m_s + LATEST_S;
        if self.progress.phase == Phase::SCAN && now.seconds_since(self.since.phase) > latest_s {
            return Err("the end of the line was not reached in time");
        }
        Ok(())
    }

    /// A plane across the tool, min_distance_m above a surface `distance_m` before the tip.
    fn guard(&self, axis: &[f64; 3], distance_m: f64) -> VirtualFixture {
        let below_m = distance_m - self.cfg.min_distance_m;
        let position = [0, 1, 2].map(|i| self.pose.position[i] + axis[i] * below_m);
        let [x, y, z, w] = self.pose.orientation;
        // The tool's frame, half a turn about its own x: the allowed side is where z points.
        let frame = Pose { stamp: self.pose.stamp, position, orientation: [w, z, -y, -x] };
        VirtualFixture { kind: FixtureKind::PLANE, reserved: 0, frame, stiffness: GUARD_PER_S }
    }

    /// How much further than the offset the tip is wanted by now, m.
    fn retracted_m(&self, now: Stamp) -> f64 {
        if self.progress.phase != Phase::RETRACT {
            return 0.0;
        }
        self.cfg.retract_m.min(self.cfg.approach_m_s * now.seconds_since(self.since.phase))
    }

    /// Velocity across the tool; goes on from APPROACH to SCAN.
    fn across(&mut self, line: &Line, advice: &Advice, tick: &Tick) -> [f64; 3] {
        let (now, tip_m) = (tick.now(), &self.pose.position);
        match self.progress.phase {
            Phase::SCAN => {
                let since_s = now.seconds_since(self.since.phase);
                self.planned_m += line.pace_m_s(since_s) * tick.period_s();
                return line.follow(tip_m, since_s);
            }
            Phase::RETRACT => return [0.0; 3],
            _ => {}
        }
        let (velocity, left_m) = line.to_start(tip_m);
        let off_m = (advice.distance_m - line.offset_m).abs();
        let near = left_m < NEAR_M && off_m < NEAR_M;
        if !near {
            self.since.near = Stamp::INVALID;
        } else if !self.since.near.is_valid() {
            self.since.near = now;
        } else if now.seconds_since(self.since.near) > SETTLED_S {
            self.planned_m = line.along_m(tip_m);
            self.enter(Phase::SCAN, now);
        }
        // Low over the retina nothing goes across: first to the offset, then to the begin.
        if off_m < CLOSE_M { velocity } else { [0.0; 3] }
    }

    /// Has the last A-scan of the line been seen? Without A-scans: is the tip at its end?
    fn is_over(&self, now: Stamp) -> bool {
        let Some(line) = &self.line else { return false };
        let late_ns = (LONGEST_DELAY_S * 1e9) as u64;
        let gone_m = self.gone.at(now.ns().saturating_sub(late_ns));
        gone_m.is_some_and(|gone_m| gone_m >= line.length_m)
    }

    /// Has the tip been given the time to go away, and to come to rest?
    fn is_away(&self, now: Stamp) -> bool {
        let away_s = self.cfg.retract_m / self.cfg.approach_m_s + SETTLED_S;
        now.seconds_since(self.since.phase) > away_s
    }

    /// The end of the line has been reached, and its A-scans have arrived.
    fn finish(&mut self, now: Stamp) {
        self.end_column(now);
        self.progress.columns = self.scan.filled() as u32;
        self.send_scan(now);
        self.enter(Phase::RETRACT, now);
    }

    /// The tip is as far away as it is wanted, or cannot get there: the image is there all the same.
    fn end(&mut self) {
        let Progress { scan, of, columns, .. } = self.progress;
        let done = ScanDone { scan, columns: of, empty: of - columns };
        self.rest();
        self.bscan_done.emit(done);
    }
}

/// Does a robot in this state take motions?
fn is_ready(robot: &OperatingState) -> bool {
    robot.state == OperatingMode::ENABLED && robot.is_homed.get()
}

impl Component for BScan {
    fn configure(&mut self) -> Result {
        let cfg = &self.cfg;
        let [low, high] = cfg.range_db;
        if !(low.is_finite() && high.is_finite() && high - low >= 1.0) {
            return Err(format!(
                "range_db: {low} to {high} is no range: the second is at least 1 dB above the first"
            )
            .into());
        }
        let (rows, columns) = (cfg.rows as usize, cfg.max_columns as usize);
        let mscan = (cfg.mscan_columns as usize, rows, cfg.mscan_lines);
        if self.built == Some((rows, columns, mscan.0, mscan.2)) {
            return Ok(());
        }
        self.bscan_image.reserve(rows * columns, SLOTS)?;
        self.mscan_image.reserve(rows * mscan.0, SLOTS)?;
        self.scan = Scan::new(columns, rows);
        self.rolling = Rolling::new(mscan.0, rows, mscan.2);
        self.built = Some((rows, columns, mscan.0, mscan.2));
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.progress, self.refused_frames) = (Progress::default(), 0);
        self.since = Moments::default();
        (self.line, self.last, self.pose) = (None, Distance::default(), Pose::default());
        self.robot = OperatingState::default();
        self.depth = Depth::default();
        (self.poses, self.rolled, self.hop_s) = (Poses::default(), 0, 0.0);
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.give_up("the component was stopped");
        Ok(())
    }

    fn make_safe(&mut self) -> Result {
        self.give_up("the component was made safe");
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        self.now = now;
        self.progress.stamp = now;
        self.look(now);
        self.draw();
        self.progress.columns = self.scan.filled() as u32;
        if self.progress.phase != Phase::IDLE {
            let driven = self.drive(tick);
            match (driven, self.progress.phase) {
                (Err(_), Phase::RETRACT) => self.end(),
                (Err(why), _) => self.give_up(why),
                (Ok(()), Phase::SCAN) if self.is_over(now) => self.finish(now),
                (Ok(()), Phase::RETRACT) if self.is_away(now) => self.end(),
                _ => {}
            }
        }
        self.send_images(now);
        Ok(())
    }
}

#[cfg(test)]
#[path = "bscan_tests.rs"]
mod tests;
