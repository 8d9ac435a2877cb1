//! The tissue between the echoes: columns of many weak scatterers, whose light adds up to speckle. Those of
//! the inner layers hang on the ILM, those of the outer ones on the pigment epithelium.
//!
//! Invariant: a column is a function of its number alone; tables are made once, and adding a column allocates
//! nothing.

use crate::noise::Noise;
use crate::phasor::{Field, LANES, Runs, lanes, lanes_mut};
use crate::tissue::{COLUMNS, EPITHELIUM_M, Layers, Tissue};

/// Optical path below the ILM at which the outer layers begin where the globe is smooth, m. In the middle of
/// the pit, which is 134 µm deep, they begin with the ILM.
const OUTER_M: f64 = 140e-6;

/// Optical path from one scatterer to the next one, m. Several lie within the resolution of 9 µm, each of a
/// random phase and a Rayleigh-distributed amplitude: their sum is fully developed speckle (Goodman, *Speckle
/// Phenomena in Optics*, 2007, chapter 3).
const PITCH_M: f64 = 2e-6;

/// Optical path over which scatterers add up: the square of the axial response of the usual spectrometer with
/// a Hann window, integrated, m.
const CELL_M: f64 = 9.2e-6;

/// Seed of all columns: they are the same in all worlds, which differ in where each column lies.
const SEED: u64 = 0x0c7;

/// Optical path below the ILM (m) and mean level of the light that comes back from there (dB beside the ILM).
/// Between the rows the level runs straight. The order of bright and dark is that of Staurenghi et al.,
/// *Proposed lexicon for anatomic landmarks in normal posterior segment spectral-domain OCT*, 2014; the
/// levels are chosen, and leave the echoes of [`crate::tissue`] 5 dB above what lies 14 µm beside them.
const PROFILE: [(f64, f64); 21] = [
    // Nerve fibres.
    (6e-6, -30.0),
    (9e-6, -14.0),
    (17e-6, -15.0),
    (21e-6, -25.0),
    // Ganglion cells, and from 60 µm on the inner plexiform layer.
    (42e-6, -27.0),
    (60e-6, -26.0),
    (80e-6, -24.5),
    (98e-6, -24.5),
    // The outer nuclear layer.
    (106e-6, -32.0),
    (192e-6, -34.0),
    // The external limiting membrane.
    (202e-6, -27.0),
    (210e-6, -31.0),
    // The ellipsoid zone, and the pigment epithelium around its echo.
    (217e-6, -17.0),
    (226e-6, -17.5),
    (236e-6, -13.0),
    (246e-6, -13.0),
    (254e-6, -18.0),
    // The choroid.
    (290e-6, -21.0),
    (340e-6, -25.0),
    (400e-6, -31.0),
    (490e-6, -44.0),
];

/// One scatterer of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatterer {
    /// Optical path below what the column hangs on, m.
    pub below_m: f64,
    /// Amplitude beside that of the ILM without speckle.
    pub amplitude: f64,
}

/// Mean level at an optical path below the ILM, dB beside the ILM; none outside of the tissue.
pub fn level_db(below_m: f64) -> Option<f64> {
    PROFILE.array_windows().find_map(|[(from, low), (to, high)]| {
        let part = (below_m - from) / (to - from);
        (0.0..1.0).contains(&part).then(|| low + part * (high - low))
    })
}

/// The scatterers of a column, from the first to the deepest.
pub fn scatterers(tissue: Tissue) -> impl Iterator<Item = Scatterer> {
    let noise = Noise::new(SEED, tissue.column as u64);
    let ([first, ..], [.., last]) = (PROFILE, PROFILE);
    let count = ((last.0 - first.0) / PITCH_M) as u64;
    let of_layers = move |below_m: &f64| (*below_m >= OUTER_M) == (tissue.layers == Layers::Outer);
    (0..count).filter_map(move |n| {
        let below_m = Some(first.0 + PITCH_M * (n as f64 + noise.uniform(2 * n))).filter(of_layers)?;
        let power = 10f64.powf(0.1 * level_db(below_m)?) * PITCH_M / CELL_M;
        // The square of a Rayleigh-distributed amplitude is exponential.
        let drawn = -(1.0 - noise.uniform(2 * n + 1)).ln();
        let hangs_m = match tissue.layers {
            Layers::Inner => 0.0,
            Layers::Outer => EPITHELIUM_M,
        };
        Some(Scatterer { below_m: below_m - hangs_m, amplitude: (power * drawn).sqrt() })
    })
}

/// The fields of all columns over the pixels of a detector.
#[derive(Clone, Debug)]
pub(crate) struct Bank {
    inner: Field,
    outer: Field,
    /// Pixels of a line.
    samples: usize,
}

impl Bank {
    /// Makes the tables: some 25 ms for 1024 pixels.
    pub(crate) fn new(runs: &Runs, samples: usize) -> Bank {
        let field = |layers| {
            let [mut re, mut im] = [vec![0.0; COLUMNS * samples], vec![0.0; COLUMNS * samples]];
            for column in 0..COLUMNS {
                let at = column * samples..(column + 1) * samples;
                for Scatterer { below_m, amplitude } in scatterers(Tissue { column, layers }) {
                    runs.add(&mut re[at.clone()], &mut im[at.clone()], 2.0 * below_m, amplitude as f32);
                }
            }
            [re, im]
        };
        Bank { inner: field(Layers::Inner), outer: field(Layers::Outer), samples }
    }

    /// Adds a column to a field, hung on what is `path_m` away.
    pub(crate) fn add(&self, runs: &Runs, field: &mut Field, path_m: f64, tissue: Tissue, amplitude: f32) {
        let Some([column_re, column_im]) = self.column(tissue) else { return };
        let [re, im] = field;
        runs.each(2.0 * path_m, amplitude, |at, er, ei| {
            let (Some(cr), Some(ci)) = (lanes(column_re, at), lanes(column_im, at)) else { return };
            let (Some(re), Some(im)) = (lanes_mut(re, at), lanes_mut(im, at)) else { return };
            for lane in 0..LANES {
                re[lane] += cr[lane] * er[lane] - ci[lane] * ei[lane];
                im[lane] += cr[lane] * ei[lane] + ci[lane] * er[lane];
            }
        });
    }

    /// The field of one column.
    fn column(&self, tissue: Tissue) -> Option<[&[f32]; 2]> {
        let [re, im] = match tissue.layers {
            Layers::Inner => &self.inner,
            Layers::Outer => &self.outer,
        };
        let from = tissue.column % COLUMNS * self.samples;
        Some([re.get(from..from + self.samples)?, im.get(from..from + self.samples)?])
    }
}
