//! The chain against numpy (gate A9), against the phantom's truth, and the search for dispersion (gate A10).

use super::*;
use crate::search::{Found, LINES, Search};
use crate::surface::{Rule, first_surface};
use trocar_phantom::noise::Noise;
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::tissue::Echo;

const TRUE: Dispersion = Dispersion { a2_rad: 18.0, a3_rad: 4.0 };

fn chain() -> Chain {
    let grid = Grid::from_wavelengths(1024, [840e-9, 50e-9, 0.0, 0.0]).expect("a grid");
    let mut chain = Chain::new(grid, Interpolation::Cubic, Levels::default());
    chain.set_dispersion(TRUE);
    chain
}

fn bytes(counts: &[u16]) -> Vec<u8> {
    counts.iter().flat_map(|count| count.to_ne_bytes()).collect()
}

/// The simulated detector, and the chain's background taken of its reference arm.
struct Simulated {
    spectrograph: Spectrograph,
    chain: Chain,
    counts: Vec<u16>,
    ascan: Vec<f32>,
}

impl Simulated {
    fn new(optics: Optics) -> Simulated {
        let spectrograph = Spectrograph::new(optics, Noise::new(1, 16)).expect("usual optics");
        let mut all =
            Simulated { spectrograph, chain: chain(), counts: vec![0; 1024], ascan: vec![0.0; 512] };
        all.chain.background().capture(256);
        for index in 0..256 {
            all.line(&[], 1 << 40 | index);
        }
        all
    }

    fn line(&mut self, echoes: &[Echo], index: u64) -> Light {
        self.spectrograph.line(echoes, 0.0, index, &mut self.counts);
        self.chain.line(&bytes(&self.counts), &mut self.ascan).expect("lengths fit")
    }
}

fn echo(path_m: f64, amplitude: f64) -> Echo {
    Echo::new(path_m, amplitude)
}

#[test]
fn a_surface_near_the_tip_does_not_fade_into_the_background_that_is_followed() {
    let mut all = Simulated::new(Optics::with_samples(1024));
    // In bin 10: its fringes are as slow as what a drift of the source changes.
    let near = [echo(35e-6, 1.0)];
    all.line(&near, 1);
    let first = all.ascan[8..13].iter().copied().fold(f32::MIN, f32::max);
    for index in 2..64 * 150 {
        all.line(&near, index);
    }
    let last = all.ascan[8..13].iter().copied().fold(f32::MIN, f32::max);
    assert!((last - first).abs() < 0.1, "{first} dB became {last} dB");
    // A surface further away lets the background be followed.
    let far = [echo(600e-6, 1.0)];
    for index in 0..70 {
        all.line(&far, 20_000 + index);
    }
    let before = all.chain.background().counts().to_vec();
    for index in 0..70 {
        all.line(&far, 21_000 + index);
    }
    assert_ne!(before, all.chain.background().counts());
}

#[test]
fn the_a_scan_is_that_of_numpy_within_a_twentieth_of_a_decibel() {
    let text = include_str!("../tests/ascan_reference.txt");
    let mut lines = text.lines().skip(1);
    let mut numbers = || -> Vec<f64> {
        let line = lines.next().expect("three lines");
        line.split(' ').map(|n| n.parse().expect("a number")).collect()
    };
    let (counts, background, ascan) = (numbers(), numbers(), numbers());
    let counts: Vec<u16> = counts.into_iter().map(|c| c as u16).collect();
    let background: Vec<u16> = background.into_iter().map(|c| c as u16).collect();
    let (mut chain, mut out) = (chain(), vec![0.0; 512]);
    chain.background().capture(1);
    chain.line(&bytes(&background), &mut out).expect("lengths fit");
    // The line itself is seen before it is processed; one of 64 would move the background.
    chain.line(&bytes(&counts), &mut out).expect("lengths fit");
    let noise = ascan[384..].iter().sum::<f64>() / 128.0;
    let mut compared = 0;
    for (bin, (ours, theirs)) in out.iter().zip(&ascan).enumerate() {
        if *theirs > noise {
            let off = (f64::from(*ours) - theirs).abs();
            assert!(off < 0.05, "bin {bin}: {ours} dB for {theirs} dB");
            compared += 1;
        }
    }
    assert!(compared > 200, "{compared} bins above the noise");
}

#[test]
fn the_depth_scale_is_right_within_a_thousandth() {
    let mut simulated = Simulated::new(Optics::with_samples(1024));
    let bin_m = simulated.chain.grid().bin_m();
    let mut bins = [0.0; 2];
    for (bin, path_m) in bins.iter_mut().zip([400e-6, 1400e-6]) {
        simulated.line(&[echo(path_m, 1.0)], 1);
        *bin = f64::from(first_surface(&simulated.ascan, &Rule::default()).expect("a surface").bin);
    }
    let scale = 1000e-6 / (bins[1] - bins[0]);
    assert!((scale / bin_m - 1.0).abs() < 1e-3, "{scale:e} m per bin for {bin_m:e}");
}

#[test]
fn a_single_surface_is_found_within_a_twentieth_of_a_micrometre() {
    let mut simulated = Simulated::new(Optics::with_samples(1024));
    let bin_m = simulated.chain.grid().bin_m();
    let (mut squares, n) = (0.0, 400);
    for index in 0..n {
        let path_m = 668e-6 + 0.37e-6 * f64::from(index);
        simulated.line(&[echo(path_m, 1.0)], u64::try_from(index).expect("not negative"));
        let found = first_surface(&simulated.ascan, &Rule::default()).expect("a surface");
        squares += ((f64::from(found.bin) * bin_m - path_m) / 1.336).powi(2);
    }
    let rms = (squares / f64::from(n)).sqrt();
    println!("static accuracy {rms:.3e} m");
    assert!(rms < 0.05e-6, "{rms:.2e} m");
}

#[test]
fn with_the_wrong_sign_of_dispersion_the_peak_loses_more_than_half() {
    let mut simulated = Simulated::new(Optics::with_samples(1024));
    let mut peak = |dispersion| {
        simulated.chain.set_dispersion(dispersion);
        simulated.line(&[echo(668e-6, 1.0)], 1);
        simulated.ascan[100..300].iter().copied().fold(0.0, f32::max)
    };
    let (right, none) = (peak(TRUE), peak(Dispersion::default()));
    let wrong = peak(Dispersion { a2_rad: -18.0, a3_rad: -4.0 });
    assert!(right - wrong > 6.0 && right > none && none > wrong, "{right}, {none}, {wrong} dB");
}

fn search(optics: Optics, echoes: impl Fn(u64) -> Vec<Echo>) -> (Found, usize, Simulated) {
    let mut simulated = Simulated::new(optics);
    let mut search = Search::new(1024);
    assert!(search.work(&mut simulated.chain).is_none() && !search.is_busy());
    search.begin();
    for index in 0..LINES as u64 {
        simulated.line(&echoes(index), index);
        search.see(&simulated.chain);
    }
    let mut work = 0;
    loop {
        work += 1;
        if let Some(found) = search.work(&mut simulated.chain) {
            assert!(!search.is_busy());
            return (found, work, simulated);
        }
        assert!(work < 40_000, "the search does not end");
    }
}

fn tissue(index: u64) -> Vec<Echo> {
    let path_m = 600e-6 + 1.7e-6 * index as f64;
    let speckle = Noise::new(9, 9).part(index);
    [(0.0, 1.0), (35e-6, 0.3), (90e-6, 0.3), (240e-6, 0.75)]
        .into_iter()
        .enumerate()
        .map(|(layer, (below, a))| echo(path_m + below, a * (0.55 + 0.9 * speckle.uniform(layer as u64))))
        .collect()
}

#[test]
fn the_search_finds_the_dispersion_and_a_peak_as_high_as_it_can_be() {
    for dispersion in [[18.0, 4.0], [-25.0, 3.0], [0.0, 0.0], [33.3, -7.0]] {
        let optics = Optics { dispersion_rad: dispersion, ..Optics::with_samples(1024) };
        let (found, work, mut simulated) = search(optics, tissue);
        println!("{dispersion:?}: {found:?} after {work} lines");
        assert!(found.sure);
        assert!((found.dispersion.a2_rad - dispersion[0]).abs() <= 0.5, "{found:?} for {dispersion:?}");
        let mut peak = |dispersion| {
            simulated.chain.set_dispersion(dispersion);
            simulated.line(&[echo(668e-6, 1.0)], 1);
            simulated.ascan[100..300].iter().copied().fold(0.0, f32::max)
        };
        let best = peak(Dispersion { a2_rad: dispersion[0], a3_rad: dispersion[1] });
        let ours = peak(found.dispersion);
        assert!(best - ours <= 0.5, "{ours} dB for {best} dB");
    }
}

#[test]
fn a_search_in_noise_is_not_sure_of_what_it_finds() {
    let (found, ..) = search(Optics::with_samples(1024), |_| Vec::new());
    assert!(!found.sure, "{found:?}");
}

#[test]
fn a_dispersion_beyond_the_range_is_told_as_its_edge_and_not_as_found() {
    for dispersion in [[75.0, 4.0], [-90.0, 0.0], [10.0, 26.0]] {
        let optics = Optics { dispersion_rad: dispersion, ..Optics::with_samples(1024) };
        let (found, ..) = search(optics, tissue);
        assert!(found.at_edge && !found.sure, "{found:?} for {dispersion:?}");
    }
    let near = Optics { dispersion_rad: [55.0, 15.0], ..Optics::with_samples(1024) };
    let (found, ..) = search(near, tissue);
    assert!(found.sure && !found.at_edge && (found.dispersion.a2_rad - 55.0).abs() <= 0.5, "{found:?}");
}

#[test]
fn dark_and_saturated_lines_are_silence_and_leave_the_background_alone() {
    let mut simulated = Simulated::new(Optics::with_samples(1024));
    let before = simulated.chain.background().counts().to_vec();
    simulated.spectrograph.set_light(0.0, Optics::GAIN, 0.55);
    assert_eq!(simulated.line(&[echo(668e-6, 1.0)], 1), Light::Dark);
    assert!(simulated.ascan.iter().all(|db| *db == SILENT_DB));
    simulated.spectrograph.set_light(1.0, Optics::GAIN, 1.3);
    for index in 0..200 {
        assert_eq!(simulated.line(&[echo(668e-6, 1.0)], index), Light::Saturated);
    }
    assert_eq!(first_surface(&simulated.ascan, &Rule::default()), None);
    assert_eq!(simulated.chain.background().counts(), before);
}

#[test]
fn without_a_captured_background_the_first_line_does_and_the_surface_is_the_same() {
    let mut simulated = Simulated::new(Optics::with_samples(1024));
    let mut fresh = Simulated { chain: chain(), ..Simulated::new(Optics::with_samples(1024)) };
    for index in 0..300 {
        simulated.line(&[echo(668e-6, 1.0)], index);
        fresh.line(&[echo(668e-6, 1.0)], index);
        let [a, b] =
            [&simulated, &fresh].map(|s| first_surface(&s.ascan, &Rule::default()).expect("a surface").bin);
        assert!((a - b).abs() < 0.05, "line {index}: bin {a} and {b}");
    }
}

/// Remains of interpolation beside a peak stand above the noise of such a detector.
#[test]
fn a_detector_with_hardly_any_noise_shows_the_surface_where_it_is() {
    let mut chain = chain();
    chain.set_dispersion(Dispersion { a2_rad: 0.0, a3_rad: 0.0 });
    let bin_m = chain.grid().bin_m();
    let mut ascan = vec![0.0; 512];
    for line in 0..400 {
        let noise = Noise::new(5, 5).part(line);
        let count = |pixel: u64| {
            let x = (2.0 * pixel as f64 + 1.0) / 1024.0 - 1.0;
            let k = std::f64::consts::TAU / (840e-9 + 50e-9 * x);
            let light = 2000.0 * (-2.0 * x * x).exp() * (1.0 + 0.3 * (2.0 * k * 500e-6).cos());
            (light + 5.0 * noise.uniform(pixel)) as u16
        };
        chain.line(&bytes(&(0..1024).map(count).collect::<Vec<_>>()), &mut ascan).expect("lengths fit");
        let found = first_surface(&ascan, &Rule::default()).expect("a surface");
        let off_m = f64::from(found.bin) * bin_m - 500e-6;
        assert!(off_m.abs() < 2e-6, "line {line}: {off_m:e} m beside it");
    }
}

#[test]
fn lines_of_another_length_are_refused_with_both_lengths() {
    let refused = chain().line(&[0; 2046], &mut [0.0; 512]).expect_err("too short").to_string();
    assert_eq!(refused, "a line of 2046 B into 512 bins: this chain takes 2048 B and gives 512 bins");
    assert!(chain().line(&[0; 2048], &mut [0.0; 511]).is_err());
}
