//! What light meets below a place of the retina: membrane, surface, layers.
//!
//! Invariant: echoes are given from the first to the deepest and are at most [`ECHOES`].

use crate::noise::Noise;

/// Echoes below one place at most: membrane, ILM and three layers.
pub const ECHOES: usize = 5;

/// Layers below the ILM: optical path below it (m) and amplitude beside that of the ILM. RNFL/GCL, INL, RPE.
pub const LAYERS: [(f64, f64); 3] = [(35e-6, 0.3), (90e-6, 0.3), (240e-6, 0.75)];

/// Amplitude of the ILM.
pub const ILM: f64 = 1.0;
/// Amplitude of the membrane.
pub const MEMBRANE: f64 = 0.6;

/// Side of the squares that have one speckle, m.
pub const SPECKLE_M: f64 = 10e-6;

/// Below this height the membrane lies on the retina and has no echo of its own, m.
const THINNEST_M: f64 = 0.5e-6;

/// One echo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echo {
    /// Optical path from the tip (geometric distance times index), m.
    pub path_m: f64,
    /// Amplitude beside that of the ILM without speckle.
    pub amplitude: f64,
}

/// The echoes below one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echoes {
    echoes: [Echo; ECHOES],
    count: usize,
}

impl Echoes {
    /// Adds one behind those that are there; a sixth is left out.
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
        self.height_m * rise * rise * (3.0 - 2.0 * rise)
    }
}

/// The echoes below `x`, `y` on the retina when the ILM is `ilm_path_m` (optical) away and the membrane `height_m`
/// (geometric) above it in a medium of `index`. Speckle is redrawn for each 10 µm square of the retina and each layer.
pub fn echoes(noise: Noise, x: f64, y: f64, ilm_path_m: f64, height_m: f64, index: f64) -> Echoes {
    let square = |along: f64| (along / SPECKLE_M).floor() as i64 as u64;
    let place = square(x).wrapping_mul(0x1_0000_0001).wrapping_add(square(y));
    let speckled = |layer: u64, amplitude: f64| amplitude * (0.55 + 0.9 * noise.part(layer).uniform(place));
    let mut all = Echoes::default();
    if height_m > THINNEST_M {
        all.push(Echo { path_m: ilm_path_m - index * height_m, amplitude: speckled(1, MEMBRANE) });
    }
    all.push(Echo { path_m: ilm_path_m, amplitude: speckled(0, ILM) });
    for (layer, (below, amplitude)) in LAYERS.into_iter().enumerate() {
        all.push(Echo { path_m: ilm_path_m + below, amplitude: speckled(2 + layer as u64, amplitude) });
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn below_a_patch_there_are_five_echoes_from_the_membrane_down() {
        let noise = Noise::new(1, 1);
        let height = Membrane::DEFAULT.height(0.6e-3, 0.0);
        assert!((height - 45e-6).abs() < 1e-12);
        let below = echoes(noise, 0.6e-3, 0.0, 668e-6, height, 1.336);
        let paths: Vec<f64> = below.as_slice().iter().map(|echo| echo.path_m).collect();
        assert_eq!(paths.len(), 5);
        assert!(paths.is_sorted(), "{paths:?}");
        assert!((paths[0] - (668e-6 - 1.336 * 45e-6)).abs() < 1e-12);
        let beside = echoes(noise, 0.0, 0.0, 668e-6, Membrane::DEFAULT.height(0.0, 0.0), 1.336);
        assert_eq!(beside.as_slice().len(), 4);
    }

    #[test]
    fn speckle_is_one_per_square_and_lies_between_its_bounds() {
        let noise = Noise::new(1, 1);
        let ilm = |x: f64, y: f64| echoes(noise, x, y, 1e-3, 0.0, 1.0).as_slice()[0].amplitude;
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
