//! The component `force_sensor`, behind the contract of force sensors.
//!
//! Invariant: a sample without a valid tip has stamp 0 and no force; values outside the range stay as
//! measured.

use trocar_phantom::World;
use trocar_phantom::noise::Noise;
use trocar_phantom::sensor::ForceErrors;
use trocar_sdk::Carried;
use trocar_sdk::data::{CartesianState, ForceRange, Wrench};
use trocar_sdk::prelude::*;

use crate::gauge::{Gauge, Site, load};

/// Streams of the world's random numbers, one per site.
const STREAMS: [u64; 2] = [32, 33];

/// The bias wanders to and fro within this time, s.
const DRIFT_PERIOD_S: f64 = 600.0;

const RATE_HZ: f64 = 1000.0;

/// No force is larger, N: sums of such forces are finite.
const LARGEST_N: f64 = 1e100;

#[derive(Config)]
struct ForceSensorConfig {
    /// Simulated world
    #[config(one_of = ["default", "no_membrane", "static", "static_no_membrane", "saccade", "step"], default = "default")]
    world: String,
    /// Seed of the simulated world and of the sensor's noise
    #[config(default = 1)]
    seed: u64,
    /// Place of the sensor: at the tip, which feels the retina, or in the shaft, which feels the sclera
    #[config(one_of = ["tip", "sclera"], default = "tip")]
    site: String,
    /// Largest force on each axis
    #[config(min = 0.001, max = 100.0, unit = "N", default = 0.2)]
    range_n: f64,
    /// Standard deviation of one sample on each axis
    #[config(min = 0.0, max = 1.0, unit = "N", default = 0.00025)]
    noise_n: f64,
    /// Fastest drift of the bias
    #[config(min = 0.0, max = 0.1, unit = "N/s", default = 0.00001)]
    drift_n_s: f64,
}

/// A simulated force sensor with three axes in the tool, at 1 kHz; forces in the frame of the tip.
#[derive(Component)]
#[component(name = "force_sensor", rate_hz = 1000, safety = "sensor")]
pub struct ForceSensor {
    /// True pose and twist of the tip in the simulated world
    #[input(tag = "sim")]
    tip: In<CartesianState>,
    /// Each measurement
    #[output(name = "wrench")]
    out: Out<Wrench>,
    /// A component left its range, or all are back.
    #[event("force_sensor")]
    overload: Event<Flag>,
    #[state]
    wrench: Wrench,
    #[state]
    range: ForceRange,
    /// The force that is taken as zero.
    #[state]
    #[unit("N")]
    zero: [f64; 3],
    /// Samples since Start that could not be taken.
    #[state]
    missed: u64,
    #[config]
    cfg: ForceSensorConfig,
    site: Site,
    world: Option<World>,
    noise: Option<Noise>,
    gauge: Gauge,
}

/// The load.
#[provides("force_sensor")]
impl ForceSensor {
    /// Force as measured last, less the bias; stamp 0 where it could not be measured. No torque.
    #[read]
    fn measured_cf(s: &ForceSensorState) -> Wrench {
        s.wrench
    }

    /// Range and noise of the sensor.
    #[read]
    fn range(s: &ForceSensorState) -> ForceRange {
        s.range
    }

    /// Takes the mean of the last 32 samples as zero.
    #[command]
    fn bias(&mut self) -> Result<(), String> {
        self.gauge.zero().map_err(|missing| {
            format!("{missing} more samples are needed for a zero: connect `tip` to the robot and wait")
        })?;
        self.zero = self.gauge.bias().into();
        Ok(())
    }
}

impl ForceSensor {
    /// The load of this moment, N, in the frame of the tip; none without a valid tip.
    fn load(&mut self, now: Stamp) -> Option<nalgebra::Vector3<f64>> {
        let sample = self.tip.sample().filter(|sample| !sample.stale)?;
        let (tip, world, noise) = (sample.value, self.world?, self.noise?);
        // A tip that is too old is none: its twist tells no more where it is.
        let Carried { isometry, .. } = tip.carried(now).ok().filter(|carried| carried.known)?;
        let linear = tip.twist.linear.into();
        let t_s = now.ns() as f64 * 1e-9;
        let ForceSensorConfig { noise_n, drift_n_s, .. } = self.cfg;
        let errors = ForceErrors { noise_n, rate_hz: RATE_HZ, drift_n_s, drift_period_s: DRIFT_PERIOD_S };
        let load = load(&world, self.site, &isometry, &linear, t_s) + errors.at(noise, t_s);
        // A tip that is nowhere, or faster than anything, feels nothing that can be told.
        load.iter().all(|force| force.abs() <= LARGEST_N).then_some(load)
    }
}

impl Component for ForceSensor {
    fn configure(&mut self) -> Result {
        let ForceSensorConfig { world, seed, site, range_n, noise_n, .. } = &self.cfg;
        let named = World::named(world, *seed)
            .ok_or_else(|| format!("world: `{world}` is none; there are {}", World::NAMES.join(", ")))?;
        self.site = if site == "sclera" { Site::Sclera } else { Site::Tip };
        // The retina's picture is decoded at the first look at it, which is no work for a step.
        let _ = named.surface_z(0.0, 0.0, 0.0);
        self.noise = Some(named.noise(STREAMS[usize::from(self.site == Site::Sclera)]));
        self.world = Some(named);
        self.range = ForceRange {
            force: [*range_n; 3],
            torque: [0.0; 3],
            force_noise: *noise_n,
            torque_noise: 0.0,
            rate: RATE_HZ,
        };
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.gauge = Gauge::default();
        (self.zero, self.missed, self.wrench) = ([0.0; 3], 0, Wrench::default());
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        self.wrench = match self.load(now) {
            Some(raw) => {
                if let Some(outside) = self.gauge.compare(&raw, self.cfg.range_n) {
                    self.overload.emit(outside.into());
                }
                Wrench { stamp: now, force: self.gauge.take(&raw).into(), torque: [0.0; 3] }
            }
            None => {
                self.gauge.miss();
                self.missed += 1;
                Wrench::default()
            }
        };
        self.out.write(&self.wrench);
        Ok(())
    }
}

#[cfg(test)]
#[path = "sensor_tests.rs"]
mod tests;
