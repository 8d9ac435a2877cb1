//! The component `bscan`: Robot-Assisted B-Scan as a behaviour that can be started and aborted at any time.
//!
//! Invariant: the robot is commanded in APPROACH, SCAN and RETRACT only, by velocities that end by themselves
//! if they are not repeated, behind a guard that keeps the tip off the retina whatever is commanded. Every
//! way out, good or bad, ends with `hold` and without the guard, and is told by exactly one event. After a
//! bad one, and after the death of this component, the robot goes away from the retina by itself, by a
//! bounded way, since an eye that moves comes near a tip that stands.

mod commands;
mod config;
mod control;
mod ending;
mod pictures;
mod room;
mod seeing;

use trocar_oct_core::tip::Timeline;
use trocar_sdk::data::{
    AScanHeader, Distance, ImageHeader, OperatingMode, OperatingState, Pose, Retreat, Twist, VirtualFixture,
};
use trocar_sdk::prelude::*;

use crate::ascans::Grey;
use crate::depth::Depth;
use crate::image::Scan;
use crate::line::Line;
use crate::payloads::{Phase, Progress, ScanColumn, ScanDone};
use crate::sending::{SLOTS, Sending};
use crate::taken::{Taken, Track};
use config::BScanConfig;
use ending::Owed;

/// The loop is not closed above this measured delay, from exposure to step and from robot to step, s. The
/// prediction is stable to 10 ms.
const LONGEST_DELAY_S: f64 = 0.012;
/// A surface that was not seen for this long ends a scan, s.
const SURFACE_LOST_S: f64 = 0.05;
/// A robot that does not tell where it is for this long ends a scan, s.
const ROBOT_LOST_S: f64 = 0.02;

/// Robot-Assisted B-Scan: goes along a line at a constant distance from the retina and makes an image of the
/// A-scans.
#[derive(Component)]
#[component(name = "bscan", rate_hz = 1000, models("periodic", "exec_in", "exec_out"), rates_hz(100, 8000))]
pub struct BScan {
    /// From the tip to the retina; its tracker has to know the robot
    #[input(fifo = 64)]
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
    /// Pose of the tip.
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
    /// Way back that the robot takes by itself when this component dies in a scan.
    #[required(interface = "axis", optional)]
    set_retreat: Function<Retreat>,
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
    /// Frames since Start that were no A-scans, or had a time that cannot be.
    #[state]
    refused_frames: u64,
    /// Distances since Start that had no time, one from ahead, or numbers that cannot be.
    #[state]
    refused_distances: u64,
    /// Readings of the robot's pose since Start that had a time from ahead, or no numbers.
    #[state]
    refused_poses: u64,
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
    /// The robot goes back by itself when this component dies.
    goes_back: bool,
    /// From tip to surface when that was seen last, or as predicted since, if that is less, m.
    near_m: f64,
    /// Commands at the end of the last scan that the robot has not taken.
    owed: Owed,
    /// Position of the tip at that end, and its way back from there, m.
    from_m: [f64; 3],
    way_m: f64,
    last: Distance,
    scan: Scan,
    /// Time and place of the column that grows.
    taken: Taken,
    track: Track,
    sending: Sending,
    grey: Grey,
    /// Rows and columns that there is room for.
    built: Option<(usize, usize)>,
    /// Time of the last step.
    now: Stamp,
}

/// When things began or were seen last.
#[derive(Clone, Copy, Default)]
struct Moments {
    phase: Stamp,
    /// Near to begin and offset.
    near: Stamp,
    /// At the end of the line.
    end: Stamp,
    surface: Stamp,
    robot: Stamp,
    delay_known: bool,
    /// The last surface was none that can be followed.
    jumped: bool,
}

/// Does a robot in this state take motions?
fn is_ready(robot: &OperatingState) -> bool {
    robot.state == OperatingMode::ENABLED && robot.is_homed.get()
}

impl Component for BScan {
    fn configure(&mut self) -> Result {
        self.keep_room()?;
        self.grey = Grey::of(self.cfg.range_db)?;
        let room @ (rows, columns) = (self.cfg.rows as usize, self.cfg.max_columns as usize);
        if self.built == Some(room) {
            return Ok(());
        }
        self.bscan_image.reserve(rows * columns, SLOTS)?;
        self.scan = Scan::new(columns, rows);
        self.built = Some(room);
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.progress = Progress::default();
        (self.refused_frames, self.refused_distances, self.refused_poses) = (0, 0, 0);
        (self.since, self.owed) = (Moments::default(), Owed::default());
        (self.line, self.last, self.pose) = (None, Distance::default(), Pose::default());
        self.robot = OperatingState::default();
        self.depth = Depth::default();
        (self.track, self.hop_s) = (Track::default(), 0.0);
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
        self.settle();
        self.mind_the_way();
        self.draw(now);
        self.progress.columns = self.scan.filled() as u32;
        if self.progress.phase != Phase::IDLE {
            let driven = self.drive(tick);
            match (driven, self.progress.phase) {
                (Err(_), Phase::RETRACT) => self.end_early(),
                (Err(why), _) => self.give_up(why),
                (Ok(()), Phase::SCAN) if self.is_over(now) => self.finish(now),
                (Ok(()), Phase::RETRACT) if self.is_away(now) => self.end(),
                _ => {}
            }
        }
        self.send_if_due(now);
        Ok(())
    }
}

#[cfg(test)]
mod nearest_tests;
#[cfg(test)]
mod offset_tests;
#[cfg(test)]
mod tilted_tests;
