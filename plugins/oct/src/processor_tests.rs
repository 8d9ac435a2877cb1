//! The processor on the bench, on spectra of the phantom's optics.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_phantom::noise::Noise;
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::tissue::Echo;
use trocar_sdk::data::SampleFormat;
use trocar_sdk::testing::Bench;

struct Detector {
    spectrograph: Spectrograph,
    index: u64,
}

impl Detector {
    fn new() -> Detector {
        let optics = Optics::with_samples(1024);
        Detector { spectrograph: Spectrograph::new(optics, Noise::new(1, 16)).unwrap(), index: 0 }
    }

    /// A frame of lines with one surface at `path_m`.
    fn push(&mut self, bench: &mut Bench<OctProcessor>, lines: u32, path_m: Option<f64>) {
        let echo = path_m.map(|path_m| Echo::new(path_m, 1.0));
        let mut bytes = Vec::new();
        let mut counts = [0; 1024];
        for n in 0..u64::from(lines) {
            self.spectrograph.line(echo.as_slice(), 0.0, self.index + n, &mut counts);
            bytes.extend(counts.iter().flat_map(|count| count.to_ne_bytes()));
        }
        let header = SpectraHeader {
            stamp: bench.now(),
            index: self.index,
            lines,
            samples: 1024,
            format: SampleFormat::U16,
            bits: 12,
            line_period: 250e-6,
        };
        self.index += u64::from(lines);
        bench.push_frame("spectra", header, &bytes);
    }
}

fn decibels(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|b| f32::from_ne_bytes(*b)).collect()
}

/// Bin of the highest peak beyond the first 40.
fn peak(ascan: &[f32]) -> (usize, f32) {
    let (at, db) = ascan.iter().enumerate().skip(40).max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    (at, *db)
}

#[test]
fn each_line_gives_an_a_scan_with_its_stamp_number_and_scale() {
    let (mut bench, mut detector) = (Bench::<OctProcessor>::new("{}"), Detector::new());
    detector.push(&mut bench, 4, Some(668e-6));
    let stamp = bench.now();
    bench.step(1);
    let (header, bytes, at) = bench.frames::<AScanHeader>("ascan").remove(0);
    assert_eq!((header.stamp, header.index, header.lines, header.samples), (stamp, 0, 4, 512));
    assert_eq!((header.format, at, bytes.len()), (SampleFormat::F32, stamp, 4 * 4 * 512));
    let scale: f64 = bench.read("processor/depth_scale", ()).unwrap();
    assert_eq!(header.bin, scale);
    for line in decibels(&bytes).chunks_exact(512) {
        assert_eq!(peak(line).0, (668e-6 / scale).round() as usize);
    }
    let (header, grey, _) = bench.frames::<AScanHeader>("ascan_u8").remove(0);
    assert_eq!((header.format, grey.len()), (SampleFormat::U8, 4 * 512));
    let brightest = grey[40..512].iter().enumerate().max_by_key(|(_, grey)| **grey).unwrap().0 + 40;
    assert_eq!(brightest, (668e-6 / scale).round() as usize);
    let latency: f64 = bench.read("processor/latency", ()).unwrap();
    assert!((latency - (1e-3 - 750e-6)).abs() < 1e-9, "{latency}");
}

#[test]
fn the_bytes_leave_out_what_the_reference_arm_leaves_and_the_decibels_do_not() {
    let first = |config: &str| {
        let (mut bench, mut detector) = (Bench::<OctProcessor>::new(config), Detector::new());
        detector.push(&mut bench, 1, Some(668e-6));
        bench.step(1);
        let (_, bytes, _) = bench.frames::<AScanHeader>("ascan").remove(0);
        let (_, grey, _) = bench.frames::<AScanHeader>("ascan_u8").remove(0);
        let shown = grey.iter().take_while(|grey| **grey == 0).count();
        (shown, decibels(&bytes)[..3].iter().all(|db| *db > 45.0))
    };
    // No background was taken: the first bins are those of the reference arm.
    assert_eq!(first(r#"{"range_db": [0, 95]}"#), (12, true));
    assert_eq!(first(r#"{"range_db": [0, 95], "hidden_bins": 0}"#), (0, true));
    assert_eq!(first(r#"{"hidden_bins": 4096}"#), (512, true));
}

#[test]
fn processing_allocates_nothing_not_even_while_it_searches() {
    let (mut bench, mut detector) = (Bench::<OctProcessor>::new("{}"), Detector::new());
    bench.command::<(), ()>("auto_dispersion", ()).unwrap();
    for _ in 0..40 {
        detector.push(&mut bench, 4, Some(668e-6));
        bench.assert_no_alloc(|bench| bench.step(1));
    }
}

#[test]
fn a_background_is_captured_of_as_many_lines_as_were_asked_for() {
    let (mut bench, mut detector) = (Bench::<OctProcessor>::new("{}"), Detector::new());
    bench.command::<u32, ()>("set_background", 300).unwrap();
    for n in 0..80 {
        detector.push(&mut bench, 4, None);
        bench.step(1);
        assert_eq!(bench.events::<u32>("background_done"), if n == 74 { vec![300] } else { vec![] });
    }
    assert!(bench.command::<u32, ()>("set_background", 255).is_err());
}

#[test]
fn the_dispersion_is_found_over_many_steps_and_taken() {
    let mut bench = Bench::<OctProcessor>::new(r#"{"dispersion_rad": [0, 0], "search_lines_per_step": 64}"#);
    let mut detector = Detector::new();
    bench.command::<(), ()>("auto_dispersion", ()).unwrap();
    let refused = bench.command::<(), ()>("auto_dispersion", ()).unwrap_err().reason;
    assert!(refused.contains("a search is running"), "{refused}");
    let mut found = Vec::new();
    for n in 0..1000 {
        detector.push(&mut bench, 1, Some(500e-6 + 3e-6 * f64::from(n % 64)));
        bench.step(1);
        found.extend(bench.events::<DispersionFound>("dispersion_done"));
    }
    let [found] = found[..] else { panic!("{found:?}") };
    assert!(found.taken.get() && !found.at_edge.get() && (found.a2 - 18.0).abs() <= 0.5, "{found:?}");
    assert_eq!(bench.read::<(), DispersionTerms>("dispersion", ()).unwrap().a2, found.a2);
}

#[test]
fn a_dispersion_at_the_edge_of_the_search_is_told_and_not_taken() {
    let mut bench = Bench::<OctProcessor>::new(r#"{"dispersion_rad": [1, 2], "search_lines_per_step": 64}"#);
    let optics = Optics { dispersion_rad: [80.0, 4.0], ..Optics::with_samples(1024) };
    let mut detector =
        Detector { spectrograph: Spectrograph::new(optics, Noise::new(1, 16)).unwrap(), index: 0 };
    bench.command::<(), ()>("auto_dispersion", ()).unwrap();
    let mut found = Vec::new();
    for n in 0..1000 {
        detector.push(&mut bench, 1, Some(500e-6 + 3e-6 * f64::from(n % 64)));
        bench.step(1);
        found.extend(bench.events::<DispersionFound>("dispersion_done"));
    }
    let [found] = found[..] else { panic!("{found:?}") };
    assert!(found.at_edge.get() && !found.taken.get(), "{found:?}");
    let kept = bench.read::<(), DispersionTerms>("dispersion", ()).unwrap();
    assert_eq!(kept, DispersionTerms { a2: 1.0, a3: 2.0 });
}

#[test]
fn dark_and_saturated_light_is_told_when_it_begins_and_when_it_is_over() {
    let (mut bench, mut detector) = (Bench::<OctProcessor>::new("{}"), Detector::new());
    for (light, reference) in [(1.0, 0.55), (0.0, 0.55), (0.0, 0.55), (1.0, 1.4), (1.0, 0.55)] {
        detector.spectrograph.set_light(light, Optics::GAIN, reference);
        detector.push(&mut bench, 2, Some(668e-6));
        bench.step(1);
    }
    assert_eq!(bench.events::<Flag>("dark"), [Flag::TRUE, Flag::FALSE]);
    assert_eq!(bench.events::<Flag>("saturated"), [Flag::TRUE, Flag::FALSE]);
    assert_eq!(
        (bench.state().dark_lines, bench.state().saturated_lines, bench.state().processed),
        (4, 2, 10)
    );
    let frames = bench.frames::<AScanHeader>("ascan");
    for frame in &frames[1..4] {
        assert!(decibels(&frame.1).iter().all(|db| *db == -200.0));
    }
}

#[test]
fn frames_that_do_not_fit_are_counted_told_once_and_left_out() {
    let mut bench = Bench::<OctProcessor>::new("{}");
    let header = SpectraHeader {
        lines: 1,
        samples: 1024,
        format: SampleFormat::U16,
        bits: 12,
        line_period: 250e-6,
        ..SpectraHeader::default()
    };
    for (header, bytes) in [
        (SpectraHeader { samples: 2048, ..header }, 4096),
        (SpectraHeader { format: SampleFormat::F32, ..header }, 4096),
        (SpectraHeader { lines: 65, ..header }, 65 * 2048),
        (header, 2047),
    ] {
        bench.push_frame("spectra", header, &vec![0; bytes]);
        bench.step(1);
    }
    let told = bench.events::<Text<160>>("refused");
    assert_eq!(told.len(), 1);
    assert!(told[0].contains("another number of pixels"), "{}", told[0].as_str());
    assert_eq!((bench.state().refused_frames, bench.state().processed), (4, 0));
    assert!(bench.frames::<AScanHeader>("ascan").is_empty());
}

#[test]
fn commands_refuse_what_makes_no_sense() {
    let mut bench = Bench::<OctProcessor>::new("{}");
    let window = bench.command::<Text<16>, ()>("set_window", Text::new("sinc")).unwrap_err().reason;
    assert!(window.contains("there are hann, hamming, blackman, rectangle"), "{window}");
    bench.command::<Text<16>, ()>("set_window", Text::new("blackman")).unwrap();
    let range =
        bench.command::<RangeDb, ()>("set_range_db", RangeDb { low: 60.0, high: 60.0 }).unwrap_err().reason;
    assert!(range.contains("is no range"), "{range}");
    let a3 = DispersionTerms { a2: 1.0, a3: f64::NAN };
    let dispersion = bench.command::<DispersionTerms, ()>("set_dispersion", a3).unwrap_err().reason;
    assert!(dispersion.starts_with("a3: NaN rad"), "{dispersion}");
}

#[test]
fn configurations_that_are_no_spectrometer_are_refused() {
    let refused = |json: &str| Bench::<OctProcessor>::created().configure(json).unwrap_err().reason;
    assert!(
        refused(r#"{"wavelength_m": [840e-9, 0, 0, 0]}"#).starts_with("wavelength_m: wavenumbers turn back")
    );
    assert!(refused(r#"{"k_curve_rad_m": [1, 2, 3]}"#).contains("3 wavenumbers for 1024 pixels"));
    assert!(refused(r#"{"range_db": [90, 40]}"#).starts_with("range_db: 90 dB to 40 dB is no range"));
}

#[test]
fn a_measured_curve_of_wavenumbers_does_what_the_polynomial_does() {
    let curve: Vec<f64> = (0..1024)
        .map(|i| std::f64::consts::TAU / (840e-9 + 50e-9 * (2.0 * f64::from(i) / 1023.0 - 1.0)))
        .collect();
    let json = trocar_sdk::serde_json::json!({ "k_curve_rad_m": curve }).to_string();
    let scale = |json: &str| Bench::<OctProcessor>::ready(json).read::<(), f64>("depth_scale", ()).unwrap();
    assert!((scale(&json) / scale("{}") - 1.0).abs() < 1e-12);
}
