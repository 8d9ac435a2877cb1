//! Spectra against their formula.

use super::*;
use crate::World;
use nalgebra::{Point3, Vector3};

fn tissue(height_m: f64) -> Vec<Echo> {
    let world = World::named("static", 1).expect("a name");
    let tip = Point3::new(0.4e-3, 0.1e-3, world.surface_z(0.4e-3, 0.1e-3, 0.0) - height_m);
    let below = world.below(&tip, &Vector3::z_axis(), 0.0).expect("over the retina");
    world.echoes(&below).as_slice().to_vec()
}

fn spectrograph(optics: Optics) -> Spectrograph {
    Spectrograph::new(optics, Noise::new(1, 16)).expect("usual optics")
}

#[test]
fn the_fast_line_is_the_exact_one_but_for_rounding() {
    for samples in [1024, 2048] {
        let mut fast = spectrograph(Optics { gain: 0.2, ..Optics::with_samples(samples) });
        let mut out = vec![0; samples];
        for (n, height_m) in [0.05e-3, 0.5e-3, 0.9e-3, 1.2e-3].into_iter().enumerate() {
            let (echoes, index) = (tissue(height_m), 1000 + n as u64);
            fast.line(&echoes, 0.1, index, &mut out);
            let exact = fast.exact_line(&echoes, 0.1, index);
            let off = |(a, b): (&u16, &u16)| a.abs_diff(*b);
            let worst = out.iter().zip(&exact).map(off).max().expect("pixels");
            assert!(worst <= 1, "{samples} px at {height_m} m: {worst} counts off");
            let other = out.iter().zip(&exact).filter(|(a, b)| a != b).count();
            assert!(other * 20 < samples, "{samples} px at {height_m} m: {other} pixels differ");
        }
    }
}

#[test]
fn fringes_of_two_pixels_are_those_of_the_largest_depth() {
    let optics = Optics::with_samples(1024);
    assert!((optics.z_max_m() - 1.8063e-3).abs() < 1e-7, "{}", optics.z_max_m());
    let turns = |pixel: usize| 2.0 * optics.z_max_m() / optics.wavelength_m(pixel);
    assert!((turns(511) - turns(512) - 0.5).abs() < 2e-3, "{}", turns(511) - turns(512));
}

#[test]
fn a_line_is_the_same_whatever_was_made_before_it_and_another_one_has_other_noise() {
    let mut maker = spectrograph(Optics::with_samples(1024));
    let echoes = tissue(0.5e-3);
    let [mut one, mut two, mut again] = [[0; 1024]; 3];
    maker.line(&echoes, 0.0, 7, &mut one);
    maker.line(&tissue(0.7e-3), 0.0, 8, &mut two);
    maker.line(&echoes, 0.0, 7, &mut again);
    assert_eq!(one, again);
    maker.line(&echoes, 0.0, 9, &mut two);
    assert_ne!(one, two);
}

#[test]
fn noise_is_that_of_shot_and_reading() {
    let mut maker = spectrograph(Optics::with_samples(1024));
    let expected = maker.exact_electrons(&[], 0.0)[512];
    let (mut sum, mut squares, mut line) = (0.0, 0.0, [0; 1024]);
    for index in 0..4000 {
        maker.line(&[], 0.0, index, &mut line);
        let electrons = f64::from(line[512]) * 150e3 / 4095.0;
        sum += electrons;
        squares += electrons * electrons;
    }
    let (mean, n) = (sum / 4000.0, 4000.0);
    let variance = squares / n - mean * mean;
    assert!((mean / expected - 1.0).abs() < 1e-3, "{mean} for {expected}");
    // Quantising in steps of 36.6 electrons adds a twelfth of its square.
    let wanted = expected + 3600.0 + 36.63f64.powi(2) / 12.0;
    assert!((variance / wanted - 1.0).abs() < 0.1, "{variance} for {wanted}");
}

#[test]
fn too_much_light_saturates_and_none_is_dark() {
    let mut line = vec![0; 1024];
    spectrograph(Optics { reference: 1.3, ..Optics::with_samples(1024) }).line(&[], 0.0, 0, &mut line);
    assert!(line.iter().filter(|count| **count == 4095).count() > 100);
    spectrograph(Optics { light: 0.0, ..Optics::with_samples(1024) }).line(
        &tissue(0.5e-3),
        0.0,
        0,
        &mut line,
    );
    assert!(line.iter().all(|count| *count < 10), "{:?}", line.iter().max());
}

#[test]
fn the_source_drifts_by_one_percent_in_a_minute_and_no_further() {
    let optics = Optics::with_samples(1024);
    let slope = (optics.brightness(1.0) - optics.brightness(0.0)) * 60.0;
    assert!((slope - 0.01).abs() < 1e-4, "{slope}");
    for t in 0..1000 {
        assert!((optics.brightness(f64::from(t) * 1e4) - 1.0).abs() <= 0.01);
    }
}

#[test]
fn optics_that_make_no_spectrum_are_refused_by_name() {
    let refused =
        |optics| Spectrograph::new(optics, Noise::new(1, 1)).err().map(|e| e.to_string()).unwrap_or_default();
    let usual = Optics::with_samples(1024);
    assert!(refused(Optics { samples: 1000, ..usual }).starts_with("samples: 1000 is no multiple of 128"));
    assert!(refused(Optics { samples: 0, ..usual }).starts_with("samples: 0"));
    assert!(refused(Optics { bits: 17, ..usual }).starts_with("bits: 17"));
    assert!(refused(Optics { light: f64::NAN, ..usual }).starts_with("light: NaN"));
    assert!(refused(Optics { fwhm_m: 0.0, ..usual }).starts_with("fwhm_m: 0"));
}
