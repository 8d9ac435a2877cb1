//! Echoes below a place of the retina: membrane, surface, layers, and the tissue between them.
//!
//! Invariant: echoes are given from the first to the deepest and are at most [`ECHOES`].

use std::f64::consts::TAU;

use crate::noise::Noise;

/// Echoes below one place at most: both sides of the membrane, ILM, two inner layers and the pigment
/// epithelium, and the tissue below the ILM and around the epithelium.
pub const ECHOES: usize = 8;

/// Inner layers: optical path below the ILM (m) and amplitude beside that of the ILM. RNFL/GCL, INL.
pub const LAYERS: [(f64, f64); 2] = [(35e-6, 0.3), (90e-6, 0.3)];

/// From the ILM to the retinal pigment epithelium (RPE) where the globe is smooth, optical path, m.
pub const EPITHELIUM_M: f64 = 240e-6;
/// Amplitude of the RPE.
const EPITHELIUM: f64 = 0.75;

/// Vessels lie above this optical path below the ILM, m.
const VESSELS_M: f64 = 60e-6;

/// Amplitude of the ILM.
pub const ILM: f64 = 1.0;
/// Amplitude of the membrane's upper side.
pub const MEMBRANE: f64 = 0.6;
/// Amplitude of its lower side.
const MEMBRANE_BACK: f64 = 0.25;

/// Side of the squares in which each echo has one amplitude, m.
pub const SPECKLE_M: f64 = 10e-6;
/// Side of the squares with one column of scatterers, m. A column of an image, 6 µm wide, is the mean of
/// thirty: so clinical instruments show the mean of many frames, in which speckle has faded but is still
/// there.
pub const GRAIN_M: f64 = 0.2e-6;

/// Columns that differ; which one lies below a place of the retina is drawn from its speckle.
pub const COLUMNS: usize = 64;

/// Stream of the tissue's columns; those of the echoes are below.
const BELOW: u64 = 16;

/// Below this height the membrane lies on the retina and has no echo of its own, m.
const THINNEST_M: f64 = 0.5e-6;

/// The membrane is not flat: it waves over so much of its height, each wave so long, m.
const WAVES: f64 = 0.05;
const WAVE_M: f64 = 210e-6;

/// One echo, or the tissue between echoes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echo {
    /// Optical path from the tip (geometric distance times index), m.
    pub path_m: f64,
    /// Amplitude beside that of the ILM without speckle.
    pub amplitude: f64,
    /// Not one echo but the scatterers around `path_m`.
    pub tissue: Option<Tissue>,
}

impl Echo {
    /// One echo of its own.
    pub fn new(path_m: f64, amplitude: f64) -> Echo {
        Echo { path_m, amplitude, tissue: None }
    }
}

/// Scatterers of the retina.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tissue {
    /// Which of their columns.
    pub column: usize,
    pub layers: Layers,
}

/// The layer that a column of scatterers hangs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layers {
    /// From the ILM down: they follow the surface, and are missing where that dips into the pit.
    Inner,
    /// Around the RPE, which goes straight on below pit and vessels.
    Outer,
}

/// Light that a place gives back beside a healthy one without vessels: amplitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    /// From the inner layers.
    pub inner: f64,
    /// From the borders between them.
    pub borders: f64,
    /// From the outer ones, in whose light vessels stand.
    pub outer: f64,
}

/// The retina below the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// x and y on the retina, m.
    pub at_m: [f64; 2],
    /// Optical path from the tip to the membrane, to the ILM and to the RPE, m.
    pub membrane_m: f64,
    pub ilm_m: f64,
    pub epithelium_m: f64,
    pub shade: Shade,
}

/// The echoes below one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echoes {
    echoes: [Echo; ECHOES],
    count: usize,
}

impl Echoes {
    /// Adds one behind those that are there; one more than there is room for is left out.
    pub fn push(&mut self, echo: Echo) {
        if let Some(room) = self.echoes.get_mut(self.count) {
            *room = echo;
            self.count += 1;
        }
    }

    pub fn as_slice(&self) -> &[Echo] {
        &self.echoes[..self.count]
    }
}

/// An epiretinal membrane: patches of thin tissue on the retina.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Membrane {
    pub patches: [Option<Patch>; 2],
}

/// One patch: an ellipse along x and y that rises over a flank.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Middle, m on the retina.
    pub middle_m: [f64; 2],
    /// Half axes along x and y, m.
    pub half_m: [f64; 2],
    /// Height above the ILM, m.
    pub height_m: f64,
    /// Part of the half axes over which it rises.
    pub flank: f64,
}

impl Membrane {
    /// No membrane.
    pub const NONE: Membrane = Membrane { patches: [None, None] };

    /// Two patches of 45 µm and 30 µm beside the fovea.
    pub const DEFAULT: Membrane = Membrane {
        patches: [
            Some(Patch { middle_m: [0.6e-3, 0.0], half_m: [0.45e-3, 0.4e-3], height_m: 45e-6, flank: 0.3 }),
            Some(Patch {
                middle_m: [-1.0e-3, 0.1e-3],
                half_m: [0.3e-3, 0.35e-3],
                height_m: 30e-6,
                flank: 0.3,
            }),
        ],
    };

    /// Height above the ILM at `x`, `y` on the retina, m; 0 beside the patches.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.patches.iter().flatten().map(|patch| patch.height(x, y)).fold(0.0, f64::max)
    }
}

impl Patch {
    fn height(&self, x: f64, y: f64) -> f64 {
        let [cx, cy] = self.middle_m;
        let [hx, hy] = self.half_m;
        let out = ((x - cx) / hx).hypot((y - cy) / hy);
        let rise = ((1.0 - out) / self.flank).clamp(0.0, 1.0);
        let waves = (TAU * (x - cx) / WAVE_M).sin() * (TAU * (y - cy) / WAVE_M + 1.0).cos();
        self.height_m * rise * rise * (3.0 - 2.0 * rise) * (1.0 + WAVES * waves)
    }
}

/// Thickness of the membrane at `x`, `y`, m: 6 to 9 µm.
fn thickness(x: f64, y: f64) -> f64 {
    let along = (TAU * x / 83e-6).sin() + (TAU * (0.6 * x + y) / 131e-6).sin();
    7.5e-6 + 0.75e-6 * along
}

/// The echoes below a place in a medium of `index`. Amplitudes are redrawn for each 10 µm square of the
/// retina and each layer, the tissue for each square of [`GRAIN_M`].
pub fn echoes(noise: Noise, place: &Place, index: f64) -> Echoes {
    let &Place { at_m: [x, y], membrane_m, ilm_m, epithelium_m, shade } = place;
    let square = |side_m: f64| {
        let along = |along: f64| (along / side_m).floor() as i64 as u64;
        along(x).wrapping_mul(0x1_0000_0001).wrapping_add(along(y))
    };
    let here = square(SPECKLE_M);
    let speckled = |layer: u64, amplitude: f64| amplitude * (0.55 + 0.9 * noise.part(layer).uniform(here));
    let column = noise.part(BELOW).bits(square(GRAIN_M)) as usize % COLUMNS;
    let tissue =
        |path_m, layers, amplitude| Echo { path_m, amplitude, tissue: Some(Tissue { column, layers }) };
    let mut all = Echoes::default();
    let height_m = ilm_m - membrane_m;
    if height_m > index * THINNEST_M {
        all.push(Echo::new(membrane_m, speckled(1, MEMBRANE)));
        let thick_m = index * thickness(x, y);
        if height_m > 1.5 * thick_m {
            all.push(Echo::new(membrane_m + thick_m, speckled(1, MEMBRANE_BACK)));
        }
    }
    all.push(Echo::new(ilm_m, speckled(0, ILM)));
    all.push(tissue(ilm_m, Layers::Inner, shade.inner));
    for ((below_m, amplitude), layer) in LAYERS.into_iter().zip(2..) {
        let shadow = if below_m < VESSELS_M { 1.0 } else { shade.outer };
        all.push(Echo::new(ilm_m + below_m, shade.borders * shadow * speckled(layer, amplitude)));
    }
    all.push(tissue(epithelium_m, Layers::Outer, shade.outer));
    all.push(Echo::new(epithelium_m, shade.outer * speckled(4, EPITHELIUM)));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Straight below a tip 500 µm above the ILM, where the retina is as thick as the globe has it.
    fn below([x, y]: [f64; 2], height_m: f64) -> Echoes {
        let place = Place {
            at_m: [x, y],
            membrane_m: 668e-6 - 1.336 * height_m,
            ilm_m: 668e-6,
            epithelium_m: 668e-6 + EPITHELIUM_M,
            shade: Shade { inner: 1.0, borders: 1.0, outer: 1.0 },
        };
        echoes(Noise::new(1, 1), &place, 1.336)
    }

    #[test]
    fn below_a_patch_there_are_eight_echoes_from_the_membrane_down() {
        let height = Membrane::DEFAULT.height(0.6e-3, 0.0);
        assert!((height - 45e-6).abs() < 1e-12);
        let below_it = below([0.6e-3, 0.0], height);
        let paths: Vec<f64> = below_it.as_slice().iter().map(|echo| echo.path_m).collect();
        assert_eq!(paths.len(), ECHOES);
        assert!(paths.is_sorted(), "{paths:?}");
        assert!((paths[0] - (668e-6 - 1.336 * 45e-6)).abs() < 1e-12);
        let beside = below([0.0, 0.0], Membrane::DEFAULT.height(0.0, 0.0));
        assert_eq!(beside.as_slice().len(), 6);
    }

    #[test]
    fn speckle_is_one_per_square_and_lies_between_its_bounds() {
        let ilm = |x: f64, y: f64| below([x, y], 0.0).as_slice()[0].amplitude;
        assert_eq!(ilm(1e-6, 1e-6), ilm(9e-6, 9e-6));
        assert_ne!(ilm(9e-6, 1e-6), ilm(11e-6, 1e-6));
        assert_ne!(ilm(-1e-6, 1e-6), ilm(1e-6, 1e-6));
        let all: Vec<f64> = (0..1000).map(|n| ilm(f64::from(n) * 10e-6 + 1e-6, 0.0)).collect();
        assert!(all.iter().all(|a| (0.55..1.45).contains(a)));
        let mean = all.iter().sum::<f64>() / 1000.0;
        assert!((mean - 1.0).abs() < 0.03, "{mean}");
    }

    #[test]
    fn the_membrane_rises_over_its_flank_without_a_cliff() {
        let mut before = 0.0;
        for n in 0..=3000 {
            let x = f64::from(n) * 1e-6 - 1.5e-3;
            let height = Membrane::DEFAULT.height(x, 0.0);
            assert!((height - before).abs() < 0.6e-6, "a step of {} at {x}", height - before);
            before = height;
        }
    }
}
