//! `oct_processor`: raw spectra in, A-scans out.
//!
//! Invariant: one A-scan for each line, with its stamp and number; a line that is dark or saturated gives
//! silence, and is told once when it begins and once when it is over. A search for the dispersion is spread
//! over many steps.

mod frames;

use trocar_oct_core::chain::{Chain, Levels, Light};
use trocar_oct_core::dispersion::{Dispersion, Window};
use trocar_oct_core::grid::{Grid, Interpolation};
use trocar_oct_core::search::{Found, Search};
use trocar_sdk::data::{AScanHeader, SpectraHeader};
use trocar_sdk::prelude::*;

use crate::payloads::{DispersionFound, DispersionTerms, RangeDb};

/// Frames of each output's pool.
const SLOTS: u32 = 64;
/// Frames of one step at most.
const BURST: usize = 32;
/// Largest dispersion that can be set, rad; a search looks at less (`trocar_oct_core::search::WIDEST_RAD`).
const LARGEST_RAD: f64 = 1000.0;

#[derive(Config)]
pub(crate) struct OctProcessorConfig {
    /// Pixels of a line, as the spectrometer has them
    #[config(min = 64, max = 8192, unit = "px", default = 1024)]
    samples: u32,
    /// Polynomial of the wavelength over the line, x from -1 to 1, as the spectrometer has it
    #[config(unit = "m", default = [840e-9, 50e-9, 0.0, 0.0])]
    wavelength_m: [f64; 4],
    /// Measured wavenumber of each pixel in rad/m, instead of the polynomial
    #[config(default = [])]
    k_curve_rad_m: Vec<f64>,
    /// Method for values between pixels
    #[config(one_of = ["cubic", "linear"], default = "cubic")]
    interpolation: String,
    /// Window over the line
    #[config(one_of = ["hann", "hamming", "blackman", "rectangle"], default = "hann")]
    window: String,
    /// Dispersion a2, a3 to take out; the default is that of the simulated source
    #[config(min = -1000.0, max = 1000.0, unit = "rad", default = [18.0, 4.0])]
    dispersion_rad: [f64; 2],
    /// Black and white of ascan_u8, dB re one count squared
    #[config(default = [45.0, 95.0])]
    range_db: [f64; 2],
    /// Bins of ascan_u8, from the first, that are black: what the reference arm leaves beside the background
    /// would be a white bar at the top of every picture. `ascan` has them as they are
    #[config(min = 0, max = 4096, default = 12)]
    hidden_bins: u32,
    /// A line whose mean is below this part of the largest count is dark
    #[config(min = 0.0, max = 1.0, default = 0.01)]
    dark_level: f64,
    /// A line with more than this part of its pixels at the largest count is saturated
    #[config(min = 0.0, max = 1.0, default = 0.004)]
    full_level: f64,
    /// Bits of a count
    #[config(min = 1, max = 16, default = 12)]
    bits: u32,
    /// Most lines of a frame
    #[config(min = 1, max = 1024, default = 64)]
    max_lines: u32,
    /// Lines that a search for the dispersion transforms in one step
    #[config(min = 1, max = 64, default = 8)]
    search_lines_per_step: u32,
}

/// Makes A-scans of raw spectra: background, wavenumbers, window, dispersion, transform, decibels.
#[derive(Component)]
#[component(name = "oct_processor", model = "stream")]
pub struct OctProcessor {
    /// Raw spectra
    #[input(fifo = 32)]
    spectra: In<Frame<SpectraHeader>>,
    /// A-scans, f32, dB re one count squared
    #[output]
    ascan: Out<Frame<AScanHeader>>,
    /// The same as bytes over the range of set_range_db, the first hidden_bins of them black
    #[output]
    ascan_u8: Out<Frame<AScanHeader>>,
    /// The background was captured of so many lines.
    #[event("processor")]
    background_done: Event<u32>,
    /// A search for the dispersion has ended.
    #[event("processor")]
    dispersion_done: Event<DispersionFound>,
    /// Lines are saturated from now on (true), or no longer (false).
    #[event("processor")]
    saturated: Event<Flag>,
    /// Lines are dark from now on (true), or no longer (false).
    #[event("processor")]
    dark: Event<Flag>,
    /// A frame that cannot be processed, the first since Start: why.
    #[event("processor")]
    refused: Event<Text<160>>,
    /// A-scans sent since Start.
    #[state]
    processed: u64,
    /// Lines since Start that were dark.
    #[state]
    dark_lines: u64,
    /// Lines since Start that were saturated.
    #[state]
    saturated_lines: u64,
    /// Frames since Start that could not be processed.
    #[state]
    refused_frames: u64,
    /// Lines since Start for whose A-scans there was no frame.
    #[state]
    left_out: u64,
    #[state]
    #[unit("m")]
    depth_scale: f64,
    #[state]
    #[unit("s")]
    latency: f64,
    #[state]
    dispersion: DispersionTerms,
    #[state]
    range: RangeDb,
    #[config]
    cfg: OctProcessorConfig,
    works: Option<Works>,
}

/// Objects that are made of the configuration.
struct Works {
    chain: Chain,
    search: Search,
    ascan: Vec<f32>,
    capture: u32,
    /// Light of the last line.
    light: Light,
}

/// Settings of the processing.
#[provides("processor")]
impl OctProcessor {
    /// Takes the mean of the next lines as background. They have to show the reference arm alone: cover the
    /// sample arm, or look where there is nothing.
    #[command]
    fn set_background(
        &mut self,
        #[arg(min = 256, max = 65536, doc = "lines to take the mean of")] lines: u32,
    ) {
        if let Some(works) = &mut self.works {
            works.capture = lines;
            works.chain.background().capture(lines);
        }
    }

    /// Sets the dispersion to take out.
    #[command]
    fn set_dispersion(&mut self, terms: &DispersionTerms) -> Result<(), String> {
        for (name, value) in [("a2", terms.a2), ("a3", terms.a3)] {
            if value.is_nan() || value.abs() > LARGEST_RAD {
                return Err(format!("{name}: {value} rad is not within ±{LARGEST_RAD} rad"));
            }
        }
        self.put_dispersion(*terms);
        Ok(())
    }

    /// Looks for the dispersion that makes the next 64 lines sharpest, a2 within ±60 rad and a3 within ±20
    /// rad, and takes it; `dispersion_done` tells when and which. One at the end of that range is not taken.
    #[command]
    fn auto_dispersion(&mut self) -> Result<(), &'static str> {
        let Some(works) = &mut self.works else {
            return Err("the processor is not configured: configure it first");
        };
        if works.search.is_busy() {
            return Err("a search is running: wait for dispersion_done");
        }
        works.search.begin();
        Ok(())
    }

    /// Sets the window over the line: hann, hamming, blackman or rectangle.
    #[command]
    fn set_window(&mut self, name: &Text<16>) -> Result<(), String> {
        let name: &str = name;
        let window = Window::named(name)
            .ok_or_else(|| format!("no window {name:?}; there are {}", Window::NAMES.join(", ")))?;
        if let Some(works) = &mut self.works {
            works.chain.set_window(window);
        }
        Ok(())
    }

    /// Sets black and white of ascan_u8, dB re one count squared.
    #[command]
    fn set_range_db(&mut self, range: &RangeDb) -> Result<(), String> {
        check_range(range)?;
        self.range = *range;
        Ok(())
    }

    /// Optical path from one bin to the next.
    #[read(unit = "m")]
    fn depth_scale(s: &OctProcessorState) -> f64 {
        s.depth_scale
    }

    /// From the middle of the last line's exposure to its A-scan.
    #[read(unit = "s")]
    fn latency(s: &OctProcessorState) -> f64 {
        s.latency
    }

    /// The dispersion that is taken out.
    #[read]
    fn dispersion(s: &OctProcessorState) -> DispersionTerms {
        s.dispersion
    }

    /// A-scans sent since Start.
    #[read]
    fn processed(s: &OctProcessorState) -> u64 {
        s.processed
    }
}

fn check_range(range: &RangeDb) -> Result<(), String> {
    let RangeDb { low, high } = *range;
    if low.is_finite() && high.is_finite() && high - low >= 1.0 {
        return Ok(());
    }
    Err(format!(
        "{low} dB to {high} dB is no range: give two numbers, the second at least 1 dB above the first"
    ))
}

impl OctProcessor {
    fn put_dispersion(&mut self, terms: DispersionTerms) {
        if let Some(works) = &mut self.works {
            works.chain.set_dispersion(Dispersion { a2_rad: terms.a2, a3_rad: terms.a3 });
        }
        self.dispersion = terms;
    }

    /// Goes on with a search.
    fn search(&mut self) {
        let Some(works) = &mut self.works else { return };
        for _ in 0..self.cfg.search_lines_per_step {
            if let Some(Found { dispersion, sharpness, sure, at_edge }) = works.search.work(&mut works.chain)
            {
                let terms = DispersionTerms { a2: dispersion.a2_rad, a3: dispersion.a3_rad };
                if sure {
                    self.put_dispersion(terms);
                }
                let DispersionTerms { a2, a3 } = terms;
                let found = DispersionFound {
                    a2,
                    a3,
                    sharpness,
                    taken: sure.into(),
                    at_edge: at_edge.into(),
                    reserved: [0; 6],
                };
                self.dispersion_done.emit(found);
                return;
            }
        }
    }
}

impl Component for OctProcessor {
    fn configure(&mut self) -> Result {
        let cfg = &self.cfg;
        let samples = cfg.samples as usize;
        let grid = if cfg.k_curve_rad_m.is_empty() {
            Grid::from_wavelengths(samples, cfg.wavelength_m).map_err(|why| format!("wavelength_m: {why}"))?
        } else if cfg.k_curve_rad_m.len() == samples {
            Grid::from_wavenumbers(cfg.k_curve_rad_m.clone())
                .map_err(|why| format!("k_curve_rad_m: {why}"))?
        } else {
            let n = cfg.k_curve_rad_m.len();
            return Err(
                format!("k_curve_rad_m: {n} wavenumbers for {samples} pixels: give one for each").into()
            );
        };
        let range = RangeDb { low: cfg.range_db[0], high: cfg.range_db[1] };
        check_range(&range).map_err(|why| format!("range_db: {why}"))?;
        let how = if cfg.interpolation == "linear" { Interpolation::Linear } else { Interpolation::Cubic };
        let levels = Levels { bits: cfg.bits, dark: cfg.dark_level as f32, full: cfg.full_level as f32 };
        let bins = grid.bins();
        let mut chain = Chain::new(grid, how, levels);
        if let Some(window) = Window::named(&cfg.window) {
            chain.set_window(window);
        }
        let lines = cfg.max_lines as usize;
        self.ascan.reserve(4 * lines * bins, SLOTS)?;
        self.ascan_u8.reserve(lines * bins, SLOTS)?;
        self.depth_scale = chain.grid().bin_m();
        self.range = range;
        let terms = DispersionTerms { a2: cfg.dispersion_rad[0], a3: cfg.dispersion_rad[1] };
        let (search, ascan) = (Search::new(samples), vec![0.0; bins]);
        self.works = Some(Works { chain, search, ascan, capture: 0, light: Light::Good });
        self.put_dispersion(terms);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.processed, self.refused_frames, self.left_out) = (0, 0, 0);
        (self.dark_lines, self.saturated_lines) = (0, 0);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        for _ in 0..BURST {
            match self.frame(tick.now()) {
                None => break,
                Some(Ok(())) => {}
                Some(Err(why)) => {
                    self.refused_frames += 1;
                    if self.refused_frames == 1 {
                        self.refused.emit(Text::new(why));
                    }
                }
            }
        }
        self.search();
        Ok(())
    }
}

#[cfg(test)]
#[path = "processor_tests.rs"]
mod tests;
