//! Time for one spectrum of the simulated retina, with and without the tissue between its echoes.
//! `cargo run --release -p trocar-phantom --example spectrum_speed`
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use nalgebra::{Point3, Vector3};
use trocar_phantom::World;
use trocar_phantom::spectra::{Optics, Spectrograph};

const PASSES: usize = 12;
/// Along the usual scan, 1 µm apart.
const PLACES: u32 = 3000;

fn main() -> Result<(), Box<dyn Error>> {
    let world = World::named("static", 1).ok_or("no such world")?;
    for samples in [1024, 2048] {
        let begin = Instant::now();
        let mut maker = Spectrograph::new(Optics::with_samples(samples), world.noise(16))?;
        println!("{samples} px: tables in {:.1} ms", begin.elapsed().as_secs_f64() * 1e3);
        let mut out = vec![0; samples];
        for tissue in [false, true] {
            let mut all = Vec::new();
            for n in 0..PLACES {
                let x = 1e-6 * f64::from(n) - 1.5e-3;
                let tip = Point3::new(x, 0.0, -0.5e-3);
                let below = world.below(&tip, &Vector3::z_axis(), 0.0).ok_or("past the retina")?;
                let mut echoes = world.echoes(&below).as_slice().to_vec();
                echoes.retain(|echo| tissue || echo.tissue.is_none());
                all.push(echoes);
            }
            // The best of many passes: whatever else the machine does makes them longer.
            let mut best_us = f64::INFINITY;
            for _ in 0..PASSES {
                let begin = Instant::now();
                for (n, echoes) in (0..).zip(&all) {
                    maker.line(echoes, 0.0, n, &mut out);
                }
                best_us = best_us.min(begin.elapsed().as_secs_f64() * 1e6 / f64::from(PLACES));
            }
            println!("{samples} px, tissue {tissue}: {best_us:.1} µs per spectrum");
        }
    }
    Ok(())
}
