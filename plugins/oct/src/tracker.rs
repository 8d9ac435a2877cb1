//! `surface_tracker`: A-scans in, distance from the tip to the retina out.
//!
//! Invariant: one distance for each A-scan, with its stamp; valid only when this A-scan shows the surface
//! where it can be.

use trocar_oct_core::kalman::Noises;
use trocar_oct_core::tracker::{Change, Reading, Settings, Tracker};
use trocar_sdk::data::{AScanHeader, ArmState, Distance, SampleFormat};
use trocar_sdk::prelude::*;

/// Frames of one step at most.
const BURST: usize = 32;
/// Longest A-scan, bins.
const LONGEST: usize = 8192;
/// Most that a time may lie ahead of the step that takes it, s: clocks of machines and their grids differ by
/// so much. A time from further ahead would make all that follow it too late for the time line.
const AHEAD_S: f64 = 0.02;

#[derive(Config)]
pub(crate) struct SurfaceTrackerConfig {
    /// Nothing nearer than this is a surface: there lies what the reference arm leaves
    #[config(live, min = 0.0, max = 0.01, unit = "m", default = 0.0001)]
    min_depth_m: f64,
    /// Refractive index between tip and surface
    #[config(live, min = 1.0, max = 2.0, default = 1.336)]
    n_index: f64,
    /// A surface stands four standard deviations and this many dB above the noise
    #[config(live, min = 0.0, max = 40.0, default = 3.0)]
    snr_db: f64,
    /// Standard deviation of a single measurement (Kalman filter, R)
    #[config(live, min = 1e-8, max = 0.001, unit = "m", default = 3e-6)]
    measurement_m: f64,
    /// Standard deviation of the surface's acceleration (Kalman filter, Q)
    #[config(live, min = 1e-5, max = 10.0, unit = "m/s^2", default = 0.02)]
    acceleration_m_s2: f64,
    /// A measurement further from the prediction than this is left out
    #[config(live, min = 1e-6, max = 0.001, unit = "m", default = 60e-6)]
    gate_m: f64,
    /// Measurements that were left out for this long say where the surface is now
    #[config(live, min = 0.001, max = 1.0, unit = "s", default = 0.01)]
    patience_s: f64,
    /// A surface that was not seen for this long is lost
    #[config(live, min = 0.001, max = 10.0, unit = "s", default = 0.05)]
    lost_after_s: f64,
}

/// Finds the first surface in each A-scan and follows it with a Kalman filter, on the time line of the
/// A-scans.
#[derive(Component)]
#[component(name = "surface_tracker", model = "stream")]
pub struct SurfaceTracker {
    /// A-scans, f32, dB
    #[input(fifo = 32)]
    ascan: In<Frame<AScanHeader>>,
    /// Pose of the tip by the encoders: without it, the tip counts as standing still and the surface's
    /// velocity is not known
    #[input(optional, fifo = 32)]
    robot: In<ArmState>,
    /// One distance for each A-scan
    #[output]
    distance: Out<Distance>,
    /// The surface was not seen for lost_after_s, or is somewhere else now: the last distance.
    #[event("surface")]
    surface_lost: Event<Distance>,
    /// The surface is there: its distance.
    #[event("surface")]
    surface_found: Event<Distance>,
    #[state]
    last: Distance,
    /// A-scans since Start.
    #[state]
    seen: u64,
    /// A-scans since Start without a valid distance.
    #[state]
    invalid: u64,
    /// Frames since Start that were no A-scans in f32, or had a time that cannot be.
    #[state]
    refused_frames: u64,
    /// Poses of the robot since Start that had no time, or one from ahead.
    #[state]
    refused_poses: u64,
    #[config]
    cfg: SurfaceTrackerConfig,
    tracker: Option<Tracker>,
    bins: Vec<f32>,
}

/// The surface.
#[provides("surface")]
impl SurfaceTracker {
    /// The distance at the last A-scan.
    #[read]
    fn measured_distance(s: &SurfaceTrackerState) -> Distance {
        s.last
    }
}

impl SurfaceTrackerConfig {
    fn settings(&self) -> Settings {
        Settings {
            min_depth_m: self.min_depth_m,
            index: self.n_index,
            above_db: self.snr_db,
            noises: Noises { measurement_m: self.measurement_m, acceleration_m_s2: self.acceleration_m_s2 },
            gate_m: self.gate_m,
            patience_s: self.patience_s,
            lost_after_s: self.lost_after_s,
            ..Settings::default()
        }
    }
}

impl Component for SurfaceTracker {
    fn configure(&mut self) -> Result {
        let settings = self.cfg.settings();
        match &mut self.tracker {
            Some(tracker) => tracker.set(settings),
            none => *none = Some(Tracker::new(settings)),
        }
        if self.bins.is_empty() {
            self.bins = vec![0.0; LONGEST];
        }
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.tracker = Some(Tracker::new(self.cfg.settings()));
        (self.seen, self.invalid, self.refused_frames, self.refused_poses) = (0, 0, 0, 0);
        self.last = Distance::default();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let Some(tracker) = &mut self.tracker else { return Ok(()) };
        let can_be = |stamp: Stamp| stamp.is_valid() && !stamp.is_ahead_of(tick.now(), AHEAD_S);
        while let Some(state) = self.robot.next() {
            let pose = state.measured_cp;
            if can_be(pose.stamp) {
                tracker.tip_at(pose.stamp.ns(), pose.position, &pose.orientation);
            } else {
                self.refused_poses += 1;
            }
        }
        for _ in 0..BURST {
            let Some(frame) = self.ascan.next() else { break };
            let header = *frame.header();
            // The last line's time is the furthest: where that can be told, all can.
            let last = (header.lines as usize).saturating_sub(1);
            let told = header.format == SampleFormat::F32 && header.stamp_of(last).is_some_and(can_be);
            let lines = frame.lines().ok().filter(|_| told);
            let Some((lines, room)) = lines.zip(self.bins.get_mut(..header.samples as usize)) else {
                self.refused_frames += 1;
                continue;
            };
            for (i, line) in lines.iter().enumerate() {
                for (bin, bytes) in room.iter_mut().zip(line.as_chunks::<4>().0) {
                    *bin = f32::from_ne_bytes(*bytes);
                }
                let ns = header.stamp_of(i).unwrap_or(header.stamp).ns();
                let reading = tracker.see(ns, room, header.bin, header.first);
                self.last = payload(&reading, tracker.has_robot());
                self.seen += 1;
                self.invalid += u64::from(!reading.valid);
                self.distance.write(&self.last);
                match reading.change {
                    Change::None => {}
                    Change::Lost => _ = self.surface_lost.emit(self.last),
                    Change::Found => _ = self.surface_found.emit(self.last),
                }
            }
        }
        Ok(())
    }
}

/// Returns a reading in its published form. Without a filter there is no distance: 0 and not valid, with a
/// sigma that says so.
fn payload(reading: &Reading, has_robot: bool) -> Distance {
    let known = reading.distance_m.is_finite();
    Distance {
        stamp: Stamp::from_ns(reading.ns),
        distance: if known { reading.distance_m } else { 0.0 },
        velocity: if has_robot { reading.velocity_m_s } else { f64::NAN },
        sigma: reading.sigma_m,
        snr_db: reading.snr_db,
        valid: (reading.valid && known).into(),
        reserved: [0; 7],
    }
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;
