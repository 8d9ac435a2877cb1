//! A-scans of the phantom's tissue: filled layers, speckle, shadows of vessels.

use nalgebra::{Point3, Vector3};
use trocar_oct_core::chain::{Chain, Levels};
use trocar_oct_core::dispersion::Dispersion;
use trocar_oct_core::grid::{Grid, Interpolation};
use trocar_phantom::noise::Noise;
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::tissue::{COLUMNS, EPITHELIUM_M, Echo, Layers, Tissue};
use trocar_phantom::{Below, World};

/// Optical path to the ILM, m: 500 µm of vitreous.
const ILM_M: f64 = 668e-6;

/// Source and processing of an OCT with its background taken.
struct Oct {
    spectrograph: Spectrograph,
    chain: Chain,
    lines: u64,
}

impl Oct {
    fn new() -> Oct {
        let spectrograph = Spectrograph::new(Optics::with_samples(1024), Noise::new(1, 16)).expect("optics");
        let grid = Grid::from_wavelengths(1024, [840e-9, 50e-9, 0.0, 0.0]).expect("a grid");
        let mut chain = Chain::new(grid, Interpolation::Cubic, Levels::default());
        chain.set_dispersion(Dispersion { a2_rad: 18.0, a3_rad: 4.0 });
        chain.background().capture(256);
        let mut oct = Oct { spectrograph, chain, lines: 0 };
        (0..256).for_each(|_| _ = oct.ascan(&[]));
        oct
    }

    /// dB of each bin.
    fn ascan(&mut self, echoes: &[Echo]) -> Vec<f32> {
        let (mut counts, mut ascan) = (vec![0; 1024], vec![0.0; 512]);
        self.lines += 1;
        self.spectrograph.line(echoes, 0.0, self.lines, &mut counts);
        let bytes: Vec<u8> = counts.iter().flat_map(|count| count.to_ne_bytes()).collect();
        self.chain.line(&bytes, &mut ascan).expect("lengths fit");
        ascan
    }

    /// Bin of an optical path below the ILM, m.
    fn bin(&self, below_m: f64) -> usize {
        ((ILM_M + below_m) / self.chain.grid().bin_m()).round() as usize
    }

    /// Mean dB of each bin over places along x from `x` on, 1 µm apart, with the tip 500 µm above the ILM.
    fn mean(&mut self, world: &World, at_m: [f64; 2], places: u32) -> Vec<f32> {
        self.mean_below(world, at_m, places, |_| ILM_M)
    }

    /// The same with the tip so high that the ILM has the optical path that `ilm_m` says for the place, m.
    fn mean_below(
        &mut self,
        world: &World,
        [x, y]: [f64; 2],
        places: u32,
        ilm_m: impl Fn(&Below) -> f64,
    ) -> Vec<f32> {
        let mut sum = vec![0.0; 512];
        for n in 0..places {
            let x = x + 1e-6 * f64::from(n);
            let below = |path_m: f64| {
                let z = world.surface_z(x, y, 0.0) - path_m / 1.336;
                world.below(&Point3::new(x, y, z), &Vector3::z_axis(), 0.0).expect("the retina")
            };
            let below = below(ilm_m(&below(ILM_M)));
            let ascan = self.ascan(world.echoes(&below).as_slice());
            sum.iter_mut().zip(ascan).for_each(|(sum, db)| *sum += db / places as f32);
        }
        sum
    }
}

fn world() -> World {
    World::named("static_no_membrane", 1).expect("a name")
}

#[test]
fn tissue_fills_the_room_between_the_layers_above_the_noise_and_below_their_peaks() {
    let mut oct = Oct::new();
    let level = oct.mean(&world(), [-1.4e-3, 0.0], 300);
    let at = |below_m: f64| level[oct.bin(below_m)];
    let noise = level[400..500].iter().sum::<f32>() / 100.0;
    let peaks = [0.0, 35e-6, 90e-6, 240e-6].map(at);
    let lowest = peaks.into_iter().fold(f32::INFINITY, f32::min);
    for (below_m, above_db) in [(14e-6, 15.0), (62e-6, 10.0), (150e-6, 4.0), (222e-6, 15.0), (300e-6, 8.0)] {
        let (filled, above) = (at(below_m), f64::from(at(below_m) - noise));
        assert!(above >= above_db, "{:.0} µm: {above} dB above the noise", below_m * 1e6);
        assert!(
            filled < peaks[0] - 8.0,
            "{:.0} µm: {filled} dB beside the ILM's {}",
            below_m * 1e6,
            peaks[0]
        );
    }
    // Tissue between the three layers is below the weakest of them.
    for below_m in [62e-6, 150e-6, 180e-6] {
        assert!(at(below_m) < lowest - 5.0, "{:.0} µm: {} dB of {lowest}", below_m * 1e6, at(below_m));
    }
    assert!(at(62e-6) > at(150e-6) + 4.0, "the outer nuclear layer is the darkest");
    let choroid = [260e-6, 300e-6, 360e-6, 420e-6].map(at);
    assert!(choroid.windows(2).all(|pair| pair[0] > pair[1]), "the choroid fades: {choroid:?}");
}

/// Amplitudes of fully developed speckle are Rayleigh-distributed: their standard deviation is 0.523 of their
/// mean, `sqrt(4/π − 1)` (Goodman, *Speckle Phenomena in Optics*, 2007, chapter 3).
#[test]
fn speckle_within_a_layer_is_fully_developed() {
    let mut oct = Oct::new();
    let bins: Vec<usize> = (0..6).map(|n| oct.bin(270e-6 + 12e-6 * f64::from(n))).collect();
    let mut amplitudes = vec![Vec::new(); bins.len()];
    for column in 0..COLUMNS {
        let tissue = Some(Tissue { column, layers: Layers::Outer });
        let ascan = oct.ascan(&[Echo { path_m: ILM_M + EPITHELIUM_M, amplitude: 1.0, tissue }]);
        for (all, bin) in amplitudes.iter_mut().zip(&bins) {
            all.push(10f64.powf(f64::from(ascan[*bin]) / 20.0));
        }
    }
    let contrast = |all: &Vec<f64>| {
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let variance = all.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / all.len() as f64;
        variance.sqrt() / mean
    };
    let all: Vec<f64> = amplitudes.iter().map(contrast).collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("contrast {mean:.3} of {all:.3?}");
    assert!((mean - 0.523).abs() < 0.04, "{mean}: {all:?}");
}

#[test]
fn below_a_vessel_there_is_a_shadow_and_above_it_none() {
    let (world, mut oct) = (world(), Oct::new());
    let whole = |from: [f64; 2], is: &dyn Fn(f64) -> bool| {
        (0..50).all(|n| is(world.shade(from[0] + 1e-6 * f64::from(n), from[1]).outer))
    };
    let places: Vec<[f64; 2]> =
        (0..40_000).map(|n| [f64::from(n % 200) * 20e-6 - 2e-3, f64::from(n / 200) * 20e-6 - 2e-3]).collect();
    let find =
        |is: &dyn Fn(f64) -> bool| places.iter().copied().find(|place| whole(*place, is)).expect("one");
    let (vessel, clear) = (find(&|outer| outer < 0.35), find(&|outer| outer == 1.0));
    // A vessel raises the surface, not what is under it: the epithelium lies in one bin for both.
    let level = |below: &Below| ILM_M + EPITHELIUM_M - 1.336 * (below.epithelium_m - below.ilm_m);
    let (under, beside) =
        (oct.mean_below(&world, vessel, 50, level), oct.mean_below(&world, clear, 50, level));
    for below_m in [222e-6, 270e-6, 300e-6] {
        let bins = oct.bin(below_m) - 3..=oct.bin(below_m) + 3;
        let by: f32 = bins.clone().map(|bin| beside[bin] - under[bin]).sum::<f32>() / bins.count() as f32;
        println!("{:.0} µm: {by:.1} dB darker", below_m * 1e6);
        assert!(by >= 3.0, "{:.0} µm: {by} dB darker", below_m * 1e6);
    }
    let (on, off) = (oct.mean(&world, vessel, 50), oct.mean(&world, clear, 50));
    let bin = oct.bin(0.0);
    assert!((off[bin] - on[bin]).abs() < 3.0, "the surface is no darker");
}
