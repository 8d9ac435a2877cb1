//! `oct_file`: plays raw spectra from a file at the rate they were taken with, again and again.
//!
//! Invariant: the file is read and checked when configured, never while it runs; lines are numbered and timed
//! as a detector does it, so a reader can tell the difference only by the content.

use std::path::Path;

use trocar_sdk::data::{SampleFormat, SpectraHeader, Spectrometer};
use trocar_sdk::prelude::*;

use crate::pace::Pace;
use crate::raw::{Layout, load};

/// Frames of the output's pool.
const SLOTS: u32 = 64;

#[derive(Config)]
pub(crate) struct OctFileConfig {
    /// File of u16 little endian, [frames][ascans][samples], read when configured; relative to the directory
    /// the host runs in
    path: String,
    /// Pixels of a line
    #[config(min = 64, max = 8192, unit = "px", default = 1024)]
    samples: u32,
    /// Lines of a frame of the file
    #[config(min = 1, max = 65536, default = 1)]
    ascans: u32,
    /// Bits of a count
    #[config(min = 1, max = 16, default = 12)]
    bits: u32,
    /// Lines per second
    #[config(min = 1.0, max = 200000.0, unit = "Hz", default = 4000.0)]
    line_rate_hz: f64,
    /// Exposure of a line
    #[config(min = 0.0, max = 1.0, unit = "s", default = 0.0001)]
    exposure_s: f64,
    /// Polynomial of the wavelength over the line, x from -1 to 1
    #[config(unit = "m", default = [840e-9, 50e-9, 0.0, 0.0])]
    wavelength_m: [f64; 4],
    /// Most lines of a frame sent: what comes faster is lost and told
    #[config(min = 1, max = 64, default = 64)]
    max_lines: u32,
    /// Begins again after the last line; without it nothing comes any more
    #[config(default = true)]
    repeat: bool,
}

/// Plays raw spectra from a file.
#[derive(Component)]
#[component(name = "oct_file", model = "stream", rate_hz = 1000, safety = "sensor")]
pub struct OctFile {
    /// Raw spectra
    #[output]
    spectra: Out<Frame<SpectraHeader>>,
    /// Lines lost since Start.
    #[event("spectrometer")]
    overrun: Event<u64>,
    /// Lines lost since Start.
    #[state]
    lost: u64,
    /// Lines in the file.
    #[state]
    lines: u64,
    #[state]
    geometry: Spectrometer,
    #[config]
    cfg: OctFileConfig,
    #[host]
    host: Host,
    counts: Vec<u16>,
    pace: Pace,
}

/// The detector that the file stands for.
#[provides("spectrometer")]
impl OctFile {
    /// Which light falls on which pixel, how often, for how long.
    #[read]
    fn spectrometer(s: &OctFileState) -> Spectrometer {
        s.geometry
    }
}

impl Component for OctFile {
    fn configure(&mut self) -> Result {
        let cfg = &self.cfg;
        let layout = Layout { samples: cfg.samples as usize, ascans: cfg.ascans as usize, bits: cfg.bits };
        let counts = load(Path::new(&cfg.path), layout).map_err(|why| format!("path: {why}"))?;
        self.spectra.reserve((cfg.max_lines * cfg.samples * 2) as usize, SLOTS)?;
        self.lines = (counts.len() / layout.samples) as u64;
        self.geometry = Spectrometer {
            samples: cfg.samples,
            bits: cfg.bits,
            wavelength: cfg.wavelength_m,
            line_rate: cfg.line_rate_hz,
            exposure: cfg.exposure_s,
        };
        self.counts = counts;
        Ok(())
    }

    fn start(&mut self) -> Result {
        self.pace = Pace::new(self.host.now(), self.cfg.line_rate_hz);
        self.lost = 0;
        Ok(())
    }

    fn resume(&mut self) -> Result {
        self.start()
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let mut batch = self.pace.take(tick.now(), u64::from(self.cfg.max_lines));
        if !self.cfg.repeat {
            let end = (batch.first + batch.lines).min(self.lines);
            batch.lost = batch.lost.min(self.lines.saturating_sub(batch.first - batch.lost));
            batch.lines = end.saturating_sub(batch.first);
        }
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

impl OctFile {
    /// Sends lines; false when there was no frame for them.
    fn send(&mut self, first: u64, lines: u64) -> bool {
        let Ok(mut loan) = self.spectra.loan() else { return false };
        let (stamp, samples) = (self.pace.middle(first), self.cfg.samples as usize);
        *loan.header_mut() = SpectraHeader {
            stamp,
            index: first,
            lines: lines as u32,
            samples: self.cfg.samples,
            format: SampleFormat::U16,
            bits: self.cfg.bits,
            line_period: self.pace.period_s(),
        };
        let room = loan.bytes_mut().chunks_exact_mut(2 * samples).take(lines as usize);
        let mut made = 0;
        for (index, bytes) in (first..).zip(room) {
            let at = (index % self.lines.max(1)) as usize * samples;
            let Some(line) = self.counts.get(at..at + samples) else { break };
            for (count, bytes) in line.iter().zip(bytes.as_chunks_mut::<2>().0) {
                *bytes = count.to_ne_bytes();
            }
            made += bytes.len();
        }
        loan.commit(made, stamp);
        true
    }
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
