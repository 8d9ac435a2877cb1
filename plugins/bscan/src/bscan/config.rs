//! The configuration of the component `bscan`.
//!
//! Invariant: plain data; what the controller is set to follows from it and from the loop's delay alone.

use trocar_sdk::prelude::*;

use crate::depth::Settings;

#[derive(Config)]
pub(super) struct BScanConfig {
    /// Speed along the tool per distance from the offset
    #[config(live, min = 0.0, max = 100.0, unit = "1/s", default = 30.0)]
    pub(super) kp_per_s: f64,
    /// The same, summed up over time
    #[config(live, min = 0.0, max = 2000.0, unit = "1/s^2", default = 100.0)]
    pub(super) ki_per_s2: f64,
    /// Time that the robot takes to answer a velocity: the lag of its drive and a period. With the measured
    /// delays it bounds the gains
    #[config(live, min = 0.0, max = 0.1, unit = "s", default = 0.009)]
    pub(super) robot_lag_s: f64,
    /// Highest speed along the tool
    #[config(live, min = 1e-5, max = 0.01, unit = "m/s", default = 0.005)]
    pub(super) max_speed_m_s: f64,
    /// Highest speed towards the surface, beside the surface's own
    #[config(live, min = 1e-5, max = 0.005, unit = "m/s", default = 0.0005)]
    pub(super) approach_m_s: f64,
    /// The tip never goes nearer to the surface, whose height counts along z of the robot's base frame, the
    /// axis of the eye
    #[config(live, min = 0.00015, max = 0.001, unit = "m", default = 0.00015)]
    pub(super) min_distance_m: f64,
    /// Way back from the surface at the end of the line, and of a scan that ends before: an eye that moves
    /// comes near a tip that stands
    #[config(live, min = 0.0, max = 0.001, unit = "m", default = 0.0004)]
    pub(super) retract_m: f64,
    /// Most that the eye comes up, with pulse and breath. Beside min_distance_m it has room in the offset,
    /// and in retract_m if the robot goes back by itself when this component dies
    #[config(live, min = 0.0, max = 0.001, unit = "m", default = 0.00035)]
    pub(super) eye_motion_m: f64,
    /// An approach that takes longer is given up
    #[config(live, min = 0.1, max = 600.0, unit = "s", default = 30.0)]
    pub(super) approach_timeout_s: f64,
    /// Rows of the image: bins of an A-scan from the first
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    pub(super) rows: u32,
    /// Most columns of a scan
    #[config(min = 1, max = 4096, unit = "px", default = 1024)]
    pub(super) max_columns: u32,
    /// Images per second
    #[config(min = 0.1, max = 100.0, unit = "Hz", default = 15.0)]
    pub(super) image_rate_hz: f64,
    /// Black and white of A-scans in dB; those of bytes are taken as they are
    #[config(default = [45.0, 95.0])]
    pub(super) range_db: [f64; 2],
}

impl BScanConfig {
    /// For a loop that takes `delay_s` in all, and a tip that comes no nearer than `least_m` along the tool.
    pub(super) fn depth(&self, delay_s: f64, least_m: f64) -> Settings {
        Settings {
            kp_per_s: self.kp_per_s,
            ki_per_s2: self.ki_per_s2,
            max_speed_m_s: self.max_speed_m_s,
            approach_m_s: self.approach_m_s,
            min_distance_m: least_m,
            delay_s,
            ..Settings::default()
        }
    }
}
