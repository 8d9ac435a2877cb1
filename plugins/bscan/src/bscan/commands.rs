//! The interface `scan`: how a scan is begun, ended and seen.
//!
//! Invariant: a scan begins only where all it needs is there, and else says what is missing and what to do.

use trocar_oct_core::tip::axis_of;
use trocar_sdk::prelude::*;

use super::{BScan, BScanState, LONGEST_DELAY_S, ROBOT_LOST_S, SURFACE_LOST_S, is_ready};
use crate::line::Line;
use crate::payloads::{Phase, Progress, ScanRequest};

/// A tool that leans by less than 2.5° stands upright in words.
const UPRIGHT_COSINE: f64 = 0.999;

/// The scan.
#[provides("scan")]
impl BScan {
    /// Begins a scan: goes to the offset and to just before the begin of the line, and then along it.
    #[command(name = "start")]
    fn begin(&mut self, request: &ScanRequest) -> Result<(), String> {
        if self.progress.phase != Phase::IDLE {
            return Err("a scan is running: abort it first, or wait for bscan_done".into());
        }
        let now = self.now;
        let line = self.line_of(request, now)?;
        self.leave_room(line.offset_m)?;
        self.depth.begin();
        self.scan.begin(line.columns);
        self.sending.restart();
        self.gone.clear();
        self.progress.scan += 1;
        (self.progress.columns, self.progress.of) = (0, line.columns as u32);
        (self.progress.refused, self.progress.stranded) = (0, false.into());
        self.line = Some(line);
        self.enter(Phase::APPROACH, now);
        Ok(())
    }

    /// Ends the scan at once; without one nothing happens.
    #[command]
    fn abort(&mut self) {
        self.give_up("aborted by command");
    }

    /// Progress of the scan.
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
        let Some(least_m) = self.least_m(&axis) else {
            return Err(format!(
                "the tool leans by {:.0} degrees from z of the robot's base frame, and 60 are the most: z has to be the axis of the \
                 eye; see set_base_frame",
                axis[2].clamp(-1.0, 1.0).acos().to_degrees()
            ));
        };
        if self.last.distance < least_m {
            return Err(format!(
                "the tip is {:.0} µm from the surface, and min_distance_m is {:.0} µm{}: bring it away first",
                1e6 * self.last.distance,
                1e6 * self.cfg.min_distance_m,
                leaning(&axis, least_m)
            ));
        }
        let delay_s = self.measured_delay_s();
        if delay_s > LONGEST_DELAY_S {
            return Err(format!(
                "the measured delay is {:.1} ms, and above {:.0} ms the loop is not closed: bring source, tracker and robot \
                 nearer together",
                1e3 * delay_s,
                1e3 * LONGEST_DELAY_S
            ));
        }
        let columns = self.cfg.max_columns as usize;
        Line::of(request, self.pose.position, axis, least_m, columns).map_err(|why| why.to_string())
    }
}

/// Describes the effect of a tool that leans on min_distance_m; empty for one that stands.
fn leaning(axis: &[f64; 3], least_m: f64) -> String {
    if axis[2] > UPRIGHT_COSINE {
        String::new()
    } else {
        format!(", {:.0} µm along a tool that leans so", 1e6 * least_m)
    }
}

#[cfg(test)]
#[path = "commands_tests.rs"]
mod tests;
