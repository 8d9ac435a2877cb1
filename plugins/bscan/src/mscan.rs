//! The component `mscan`: the last moments of an OCT as an image that rolls.
//!
//! Invariant: it sends no commands; frames without A-scans are counted, and the next good ones go on.

use trocar_sdk::data::{AScanHeader, ArmState, Distance, ImageHeader};
use trocar_sdk::prelude::*;

use crate::ascans::{Grey, ascans};
use crate::image::Rolling;
use crate::payloads::ScanColumn;
use crate::sending::{SLOTS, Sending};
use crate::taken::{Taken, Track};

/// Frames, poses and distances of one step at most: as many as their queues hold.
const BURST: usize = 64;
const DISTANCES: usize = 256;

#[derive(Config)]
struct MScanConfig {
    /// Rows of the image: bins of an A-scan from the first
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    rows: u32,
    /// Columns of the image
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    columns: u32,
    /// A-scans of a column
    #[config(min = 1, max = 10000, default = 16)]
    lines: u32,
    /// Images per second, at most as many as steps
    #[config(live, min = 0.1, max = 100.0, unit = "Hz", default = 15.0)]
    image_rate_hz: f64,
    /// Black and white of A-scans in dB; those of bytes are taken as they are
    #[config(live, default = [45.0, 95.0])]
    range_db: [f64; 2],
}

/// Shows the A-scans of the last moments, the newest at the right (M-mode).
#[derive(Component)]
#[component(name = "mscan", rate_hz = 100)]
pub struct MScan {
    /// A-scans, f32 in dB or bytes
    #[input(fifo = 64)]
    ascan: In<Frame<AScanHeader>>,
    /// Pose of the tip: without it, columns have no pose
    #[input(optional, fifo = 64)]
    robot: In<ArmState>,
    /// From the tip to the retina: without it, columns have no distance
    #[input(optional, fifo = 256)]
    distance: In<Distance>,
    /// The last moments
    #[output]
    image: Out<Frame<ImageHeader>>,
    /// Each column when it is there: where it was taken
    #[output]
    column: Out<ScanColumn>,
    /// A-scans since Start.
    #[state]
    seen: u64,
    /// Frames since Start that were no A-scans, or had a time that cannot be.
    #[state]
    refused_frames: u64,
    /// Distances since Start that had no time, one from ahead, or numbers that cannot be.
    #[state]
    refused_distances: u64,
    /// Poses of the robot since Start that had a time from ahead, or numbers that cannot be.
    #[state]
    refused_poses: u64,
    /// Images since Start for which there was no frame.
    #[state]
    left_out: u64,
    /// Columns since Start.
    #[state]
    columns: u32,
    #[config]
    cfg: MScanConfig,
    rolling: Rolling,
    /// Time and place of the column that grows.
    taken: Taken,
    track: Track,
    sending: Sending,
    grey: Grey,
    built: Option<(u32, u32, u32)>,
}

impl MScan {
    fn look(&mut self, now: Stamp) {
        for _ in 0..BURST {
            let Some(state) = self.robot.next() else { break };
            let pose = state.measured_cp;
            // Stamp 0 is a robot that does not measure yet (CRTK).
            if !self.track.tip_at(pose, now) && pose.is_valid() {
                self.refused_poses += 1;
            }
        }
        for _ in 0..DISTANCES {
            let Some(seen) = self.distance.next() else { break };
            self.refused_distances += u64::from(!self.track.surface_at(seen, now));
        }
    }

    fn draw(&mut self, now: Stamp) {
        for _ in 0..BURST {
            let Some(frame) = self.ascan.next() else { return };
            let Some(all) = ascans(&frame, self.grey, now) else {
                self.refused_frames += 1;
                continue;
            };
            for (taken, ascan) in all {
                if self.rolling.lines() == 0 {
                    self.taken = Taken::begin(taken, &self.track);
                }
                if let Some(lines) = self.rolling.add(ascan) {
                    self.taken.complete(&self.track);
                    self.column.write(&self.taken.column(0, self.columns, lines));
                    self.columns = self.columns.wrapping_add(1);
                }
                self.sending.saw(taken);
                self.seen += 1;
            }
        }
    }
}

impl Component for MScan {
    fn configure(&mut self) -> Result {
        self.grey = Grey::of(self.cfg.range_db)?;
        let MScanConfig { rows, columns, lines, .. } = self.cfg;
        if self.built == Some((rows, columns, lines)) {
            return Ok(());
        }
        self.image.reserve(rows as usize * columns as usize, SLOTS)?;
        self.rolling = Rolling::new(columns as usize, rows as usize, lines);
        self.built = Some((rows, columns, lines));
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.seen, self.left_out, self.columns) = (0, 0, 0);
        (self.refused_frames, self.refused_distances, self.refused_poses) = (0, 0, 0);
        (self.track, self.taken) = (Track::default(), Taken::default());
        self.rolling.clear();
        self.sending.restart();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        self.look(tick.now());
        self.draw(tick.now());
        if self.sending.is_due(tick.now(), self.cfg.image_rate_hz) {
            let size = (self.cfg.columns as usize, self.cfg.rows as usize);
            let sent = self.sending.send(&mut self.image, size, |room| self.rolling.write(room));
            self.left_out += u64::from(!sent);
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "mscan_tests.rs"]
mod tests;
