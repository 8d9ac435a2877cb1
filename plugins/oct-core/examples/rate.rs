//! Measures how many A-scans a second one core makes of raw spectra, surface included (gate A8): prints rates
//! and percentiles.
//!
//! Invariant: lines are those of the phantom, different ones, so that no branch is learnt by heart.
//! `cargo run --release -p trocar-oct-core --example rate`

use std::hint::black_box;
use std::time::Instant;

use trocar_oct_core::chain::{Chain, Levels};
use trocar_oct_core::dispersion::Dispersion;
use trocar_oct_core::grid::{Grid, Interpolation};
use trocar_oct_core::surface::{Rule, first_surface};
use trocar_phantom::noise::Noise;
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::tissue::Echo;

const LINES: usize = 256;
const ROUNDS: usize = 400;

/// Lines of a frame at 4 kHz, and bytes that something else works on in the millisecond between two: more
/// than fit beside the chain into the second level of caches.
const FRAME: usize = 4;
const ELSEWHERE: usize = 16 << 20;
const FRAMES: usize = 4000;

fn main() {
    println!("samples  spectrum simulated in µs  A-scans/s  with surface  p50 µs  p99 µs  p99.9 µs  max µs");
    for samples in [1024, 2048] {
        measure(samples);
    }
    println!(
        "samples  first of {FRAME} lines after other work, p50 µs  p99 µs  others p50 µs  p99 µs  a frame's mean p50 µs  p99 µs"
    );
    for samples in [1024, 2048] {
        measure_cold(samples);
    }
}

/// A chain and lines for it.
fn chain_and_lines(samples: usize) -> (Chain, Vec<Vec<u8>>, Vec<f64>) {
    let optics = Optics::with_samples(samples);
    let mut spectrograph = Spectrograph::new(optics, Noise::new(1, 16)).expect("usual optics");
    let grid = Grid::from_wavelengths(samples, [840e-9, 50e-9, 0.0, 0.0]).expect("a grid");
    let mut chain = Chain::new(grid, Interpolation::Cubic, Levels::default());
    chain.set_dispersion(Dispersion { a2_rad: 18.0, a3_rad: 4.0 });
    let mut counts = vec![0; samples];
    let mut made = Vec::with_capacity(LINES);
    let lines: Vec<Vec<u8>> = (0..LINES)
        .map(|n| {
            let path_m = 500e-6 + 1e-6 * n as f64;
            let layers = [(-40e-6, 0.6), (0.0, 1.0), (35e-6, 0.3), (90e-6, 0.3), (240e-6, 0.75)];
            let echoes = layers.map(|(below, amplitude)| Echo::new(path_m + below, amplitude));
            let one = Instant::now();
            spectrograph.line(&echoes, 0.0, n as u64, &mut counts);
            made.push(one.elapsed().as_nanos() as f64 * 1e-3);
            counts.iter().flat_map(|count| count.to_ne_bytes()).collect()
        })
        .collect();
    (chain, lines, made)
}

fn percentile(all: &mut [f64], part: f64) -> f64 {
    all.sort_by(f64::total_cmp);
    all[((all.len() - 1) as f64 * part) as usize]
}

/// As at 4 kHz: four lines each millisecond, before which the processor did something else.
fn measure_cold(samples: usize) {
    let (mut chain, lines, _) = chain_and_lines(samples);
    let (mut ascan, rule) = (vec![0.0; samples / 2], Rule::default());
    let mut elsewhere = vec![0u8; ELSEWHERE];
    let (mut first, mut others, mut frames) = (Vec::new(), Vec::new(), Vec::new());
    for frame in lines.chunks_exact(FRAME).cycle().take(FRAMES) {
        elsewhere.iter_mut().step_by(64).for_each(|byte| *byte = byte.wrapping_add(1));
        black_box(&mut elsewhere);
        // Lines that the detector has just written are near.
        black_box(frame.iter().flatten().map(|byte| u32::from(*byte)).sum::<u32>());
        let mut whole = 0.0;
        for (n, line) in frame.iter().enumerate() {
            let one = Instant::now();
            black_box(chain.line(black_box(line), &mut ascan)).expect("lengths fit");
            black_box(first_surface(&ascan, &rule));
            let took = one.elapsed().as_nanos() as f64 * 1e-3;
            whole += took;
            if n == 0 { first.push(took) } else { others.push(took) }
        }
        frames.push(whole / FRAME as f64);
    }
    let mut at = |part: f64| [&mut first, &mut others, &mut frames].map(|all| percentile(all, part));
    let ([first50, others50, frame50], [first99, others99, frame99]) = (at(0.5), at(0.99));
    println!(
        "{samples:7}  {first50:40.2}  {first99:6.2}  {others50:13.2}  {others99:6.2}  {frame50:21.2}  {frame99:6.2}"
    );
}

fn measure(samples: usize) {
    let (mut chain, lines, mut made) = chain_and_lines(samples);
    let mut ascan = vec![0.0; samples / 2];
    let simulated = percentile(&mut made, 0.5);
    let rule = Rule::default();
    let begin = Instant::now();
    for _ in 0..ROUNDS {
        for line in &lines {
            black_box(chain.line(black_box(line), &mut ascan)).expect("lengths fit");
        }
    }
    let plain = (ROUNDS * LINES) as f64 / begin.elapsed().as_secs_f64();
    let mut took = Vec::with_capacity(ROUNDS * LINES);
    let begin = Instant::now();
    for _ in 0..ROUNDS {
        for line in &lines {
            let one = Instant::now();
            black_box(chain.line(black_box(line), &mut ascan)).expect("lengths fit");
            black_box(first_surface(&ascan, &rule));
            took.push(one.elapsed().as_nanos() as f64 * 1e-3);
        }
    }
    let whole = (ROUNDS * LINES) as f64 / begin.elapsed().as_secs_f64();
    let mut at = |part: f64| percentile(&mut took, part);
    println!(
        "{samples:7}  {simulated:24.1}  {plain:9.0}  {whole:12.0}  {:6.2}  {:6.2}  {:8.2}  {:6.2}",
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0)
    );
}
