//! `oct_source`: a simulated spectrometer that looks along a simulated tool at the phantom's retina.
//!
//! Invariant: line n is a function of configuration, world, n and the tip's place at that time; lines that
//! found no frame or came too late are lost as a real detector loses them, and told.

use nalgebra::{Point3, UnitVector3, Vector3};
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::tissue::{ECHOES, Echo};
use trocar_phantom::{Below, World};
use trocar_sdk::data::{CartesianState, Distance, SampleFormat, SpectraHeader, Spectrometer};
use trocar_sdk::prelude::*;

use crate::pace::Pace;

/// Frames of the output's pool.
const SLOTS: u32 = 64;
/// Moments of an exposure that blur it.
const MOMENTS: usize = 4;
/// Stream of random numbers of this device; those of the world are below 16.
const NOISE: u64 = 16;

#[derive(Config)]
pub(crate) struct OctSourceConfig {
    /// Which phantom: all simulated devices of a system name the same one
    #[config(one_of = ["default", "no_membrane", "static", "static_no_membrane", "saccade", "step"], default = "default")]
    world: String,
    /// Seed of world and noise: all simulated devices of a system have the same one
    #[config(default = 1)]
    seed: u64,
    /// Pixels of a line, a multiple of 128
    #[config(min = 128, max = 8192, unit = "px", default = 1024)]
    samples: u32,
    /// Lines per second
    #[config(min = 1.0, max = 200000.0, unit = "Hz", default = 4000.0)]
    line_rate_hz: f64,
    /// Exposure of a line
    #[config(min = 0.0, max = 1.0, unit = "s", default = 0.0001)]
    exposure_s: f64,
    /// Motion during the exposure blurs the line, as a mean over four moments
    #[config(live, default = false)]
    motion_blur: bool,
    /// Most lines of a frame: what comes faster is lost and told
    #[config(min = 1, max = 64, default = 64)]
    max_lines: u32,
    /// Light from the tissue beside that of a healthy retina: amplitude
    #[config(live, min = 0.0, max = 100.0, default = 1.0)]
    signal: f64,
    /// Part of the full well that the reference arm fills; above 1 the detector is saturated
    #[config(live, min = 0.0, max = 100.0, default = 0.55)]
    reference: f64,
    /// Is the light source on?
    #[config(live, default = true)]
    light: bool,
    /// Dispersion a2, a3 of the simulated optics
    #[config(default = [18.0, 4.0], unit = "rad")]
    dispersion_rad: [f64; 2],
    /// Takes a frame of max_lines at each `trigger` instead of running freely
    #[config(default = false)]
    triggered: bool,
    /// Place of the tip while no input tells it, in the world, with the tool along +z
    #[config(default = [0.0, 0.0, -0.0005], unit = "m")]
    tip_m: [f64; 3],
}

/// Simulated spectra of the phantom's retina, as a spectrometer at the tip of the tool would count them.
#[derive(Component)]
#[component(name = "oct_source", model = "stream", rate_hz = 1000, safety = "sensor", provides("truth"))]
pub struct OctSource {
    /// True pose and twist of the tip in the world
    #[input(optional, tag = "sim")]
    tip: In<CartesianState>,
    /// Raw spectra
    #[output]
    spectra: Out<Frame<SpectraHeader>>,
    /// The true distance from the tip to the first surface, for each line
    #[output(tag = "truth")]
    true_distance: Out<Distance>,
    /// Lines lost since Start.
    #[event("spectrometer")]
    overrun: Event<u64>,
    /// Lines lost since Start.
    #[state]
    lost: u64,
    #[state]
    geometry: Spectrometer,
    #[state]
    truth: Distance,
    #[config]
    cfg: OctSourceConfig,
    #[host]
    host: Host,
    device: Option<Device>,
    built: Option<Built>,
    pace: Pace,
    fire: bool,
}

/// Objects that are made of the configuration.
struct Device {
    world: World,
    spectrograph: Spectrograph,
    line: Vec<u16>,
    tip: CartesianState,
}

/// Part of the configuration that the device was made of.
type Built = (String, u64, u32, u32, [f64; 2]);

/// The detector.
#[provides("spectrometer")]
impl OctSource {
    /// Which light falls on which pixel, how often, for how long.
    #[read]
    fn spectrometer(s: &OctSourceState) -> Spectrometer {
        s.geometry
    }

    /// Takes one frame now; only if the configuration asks for triggers.
    #[command]
    fn trigger(&mut self) -> Result<(), &'static str> {
        if !self.cfg.triggered {
            return Err("this source runs freely: configure triggered = true, or wait for the next frame");
        }
        self.fire = true;
        Ok(())
    }
}

/// True values of the simulated world, for comparison: no controller may see them.
#[provides("truth", tag = "truth")]
impl OctSource {
    /// The distance from the tip to the first surface at the last line; not valid when the tool points past
    /// the retina.
    #[read]
    fn distance(s: &OctSourceState) -> Distance {
        s.truth
    }
}

impl Component for OctSource {
    fn configure(&mut self) -> Result {
        let cfg = &self.cfg;
        if cfg.exposure_s * cfg.line_rate_hz > 1.0 {
            return Err(format!(
                "exposure_s: {} s is longer than a line at {} Hz takes, {} s",
                cfg.exposure_s,
                cfg.line_rate_hz,
                1.0 / cfg.line_rate_hz
            )
            .into());
        }
        let built = (cfg.world.clone(), cfg.seed, cfg.samples, cfg.max_lines, cfg.dispersion_rad);
        if self.built.as_ref() == Some(&built) {
            // Only what is live has changed, or times, which Start looks at.
            self.geometry.line_rate = cfg.line_rate_hz;
            self.geometry.exposure = cfg.exposure_s;
            self.set_light();
            return Ok(());
        }
        let world = World::named(&cfg.world, cfg.seed)
            .ok_or_else(|| format!("world: no world {}; there are {}", cfg.world, World::NAMES.join(", ")))?;
        let mut optics = Optics::with_samples(cfg.samples as usize);
        optics.dispersion_rad = cfg.dispersion_rad;
        let spectrograph = Spectrograph::new(optics, world.noise(NOISE))?;
        // The picture behind the relief is decoded now, not in the first step.
        let _ = world.surface_z(0.0, 0.0, 0.0);
        self.spectra.reserve(cfg.max_lines as usize * optics.samples * 2, SLOTS)?;
        self.geometry = Spectrometer {
            samples: cfg.samples,
            bits: optics.bits,
            wavelength: [optics.centre_m, 0.5 * optics.span_m, 0.0, 0.0],
            line_rate: cfg.line_rate_hz,
            exposure: cfg.exposure_s,
        };
        self.device = Some(Device {
            world,
            spectrograph,
            line: vec![0; optics.samples],
            tip: CartesianState::default(),
        });
        self.built = Some(built);
        self.set_light();
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.pace = Pace::new(self.host.now(), self.cfg.line_rate_hz);
        (self.lost, self.fire) = (0, false);
        Ok(())
    }

    fn resume(&mut self) -> Result {
        self.start()
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let most = u64::from(self.cfg.max_lines);
        let batch = match (self.cfg.triggered, std::mem::take(&mut self.fire)) {
            (false, _) => self.pace.take(tick.now(), most),
            (true, true) => self.pace.fire(tick.now(), most),
            (true, false) => return Ok(()),
        };
        let lost_before = self.lost;
        self.lost += batch.lost;
        if batch.lines > 0 && !self.send(batch.first, batch.lines) {
            self.lost += batch.lines;
        }
        if self.lost > lost_before {
            self.overrun.emit(self.lost);
        }
        Ok(())
    }
}

impl OctSource {
    /// Live settings into the optics.
    fn set_light(&mut self) {
        if let Some(device) = &mut self.device {
            let light = f64::from(u8::from(self.cfg.light));
            device.spectrograph.set_light(light, Optics::GAIN * self.cfg.signal, self.cfg.reference);
        }
    }

    /// Makes and sends lines; false when there was no frame for them.
    fn send(&mut self, first: u64, lines: u64) -> bool {
        let Some(device) = &mut self.device else { return true };
        let mut stands = CartesianState::default();
        stands.pose.position = self.cfg.tip_m;
        device.tip = self.tip.latest().unwrap_or(stands);
        let Ok(mut loan) = self.spectra.loan() else { return false };
        let stamp = self.pace.middle(first);
        let samples = device.line.len();
        *loan.header_mut() = SpectraHeader {
            stamp,
            index: first,
            lines: lines as u32,
            samples: samples as u32,
            format: SampleFormat::U16,
            bits: self.geometry.bits,
            line_period: self.pace.period_s(),
        };
        let room = loan.bytes_mut().chunks_exact_mut(2 * samples).take(lines as usize);
        let mut made = 0;
        let moments = if self.cfg.motion_blur { MOMENTS } else { 1 };
        for (index, bytes) in (first..).zip(room) {
            let stamp = self.pace.middle(index);
            self.truth = device.take(stamp, index, moments, self.cfg.exposure_s);
            for (count, bytes) in device.line.iter().zip(bytes.as_chunks_mut::<2>().0) {
                *bytes = count.to_ne_bytes();
            }
            self.true_distance.write(&self.truth);
            made += bytes.len();
        }
        loan.commit(made, stamp);
        true
    }
}

impl Device {
    /// Takes one line, and says how far the first surface truly was.
    fn take(&mut self, stamp: Stamp, index: u64, moments: usize, exposure_s: f64) -> Distance {
        let t_s = stamp.ns() as f64 * 1e-9;
        let mut echoes = [Echo::default(); MOMENTS * ECHOES];
        let mut count = 0;
        for moment in 0..moments {
            let off_s = exposure_s * ((moment as f64 + 0.5) / moments as f64 - 0.5);
            let Some(below) = self.below(stamp, off_s) else { continue };
            for echo in self.world.echoes(&below).as_slice() {
                echoes[count] = Echo { amplitude: echo.amplitude / moments as f64, ..*echo };
                count += 1;
            }
        }
        self.spectrograph.line(&echoes[..count], t_s, index, &mut self.line);
        let below = self.below(stamp, 0.0);
        Distance {
            stamp,
            distance: below.map_or(f64::NAN, |below| below.distance_m),
            velocity: f64::NAN,
            valid: below.is_some().into(),
            ..Distance::default()
        }
    }

    /// Returns the surface that the tool points at `off_s` after `stamp`, if there is one.
    fn below(&self, stamp: Stamp, off_s: f64) -> Option<Below> {
        let (tip, axis) = self.tip_at(stamp, off_s)?;
        self.world.below(&tip, &axis, stamp.ns() as f64 * 1e-9 + off_s)
    }

    /// Tip and axis of the tool `off_s` after `stamp`; `None` when the last sample was no pose.
    fn tip_at(&self, stamp: Stamp, off_s: f64) -> Option<(Point3<f64>, UnitVector3<f64>)> {
        let at = stamp.ns().saturating_add_signed((off_s * 1e9).round() as i64);
        let pose = self.tip.carried(Stamp::from_ns(at)).ok()?.isometry;
        Some((pose.translation.vector.into(), pose.rotation * Vector3::z_axis()))
    }
}

#[cfg(test)]
#[path = "source_tests.rs"]
mod tests;
