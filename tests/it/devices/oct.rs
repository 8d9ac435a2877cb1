//! OCT of a raw file: from counts to a distance, and every light that there can be.

use std::f64::consts::TAU;

use serde_json::{Value, json};

use super::{OK, Site};

const SAMPLES: usize = 1024;
/// Lines of each light in the file: 100 ms at 4 kHz.
const LINES: usize = 400;

/// What a line shows.
#[derive(Clone, Copy)]
enum Light {
    /// A surface 500 µm of optical path away.
    Surface,
    /// The reference arm alone.
    Reference,
    Dark,
    Saturated,
}

/// Lines of 12-bit counts of a spectrometer from 790 to 890 nm, in little endian.
fn spectra(lights: &[Light]) -> Vec<u8> {
    let mut random = fastrand::Rng::with_seed(7);
    let mut bytes = Vec::with_capacity(2 * SAMPLES * LINES * lights.len());
    for light in lights {
        for _ in 0..LINES {
            for pixel in 0..SAMPLES {
                let x = 2.0 * (pixel as f64 + 0.5) / SAMPLES as f64 - 1.0;
                let k = TAU / (840e-9 + 50e-9 * x);
                let lamp = 2000.0 * (-2.0 * x * x).exp();
                let count = match light {
                    Light::Surface => lamp * (1.0 + 0.3 * (2.0 * k * 500e-6).cos()),
                    Light::Reference => lamp,
                    Light::Dark => 10.0,
                    Light::Saturated => 5000.0,
                };
                let noisy = count + 20.0 * (random.f64() - 0.5);
                bytes.extend((noisy.clamp(0.0, 4095.0) as u16).to_le_bytes());
            }
        }
    }
    bytes
}

/// File, processor and tracker in one stream.
fn chain(site: &Site, path: &str) {
    let grpc = &site.grpc;
    grpc.create("host/file", "oct_file", json!({ "path": path }));
    let behind = json!({ "stream_of": "host/file" });
    // No dispersion in what this test makes.
    let processor = json!({ "dispersion_rad": [0, 0] });
    grpc.create_with("host/ascan", "oct_processor", processor, behind.clone());
    grpc.create_with("host/surface", "surface_tracker", json!({}), behind);
    grpc.connect("host/ascan/spectra", "host/file/spectra");
    grpc.connect("host/surface/ascan", "host/ascan/ascan");
    for component in ["host/surface", "host/ascan", "host/file"] {
        grpc.start(component);
    }
}

#[test]
fn a_raw_file_plays_through_every_light_and_each_is_told_when_it_begins_and_ends() {
    let site = Site::with(&["oct"]);
    let cycle = [Light::Surface, Light::Reference, Light::Dark, Light::Saturated];
    site.world.write("cycle.u16", spectra(&cycle));
    chain(&site, "cycle.u16");
    let paths = [
        "ascan/processor/dark",
        "ascan/processor/saturated",
        "surface/surface/surface_lost",
        "surface/surface/surface_found",
    ];
    let selections: Vec<Value> = paths.iter().map(|path| json!({ "path": format!("host/{path}") })).collect();
    let mut events = site.grpc.stream("InteractService/Subscribe", &json!({ "selections": selections }));
    let mut next = |name: &str, value: Option<bool>| {
        events.until(&format!("{name} {value:?}"), |item| {
            let named = item["path"].as_str().is_some_and(|path| path.ends_with(name));
            named && value.is_none_or(|value| item["json"] == value)
        })["json"]
            .clone()
    };
    let found = next("surface_found", None);
    // 500 µm of optical path in what is between tip and retina.
    let distance_m = found["distance"].as_f64().unwrap();
    assert!((distance_m - 500e-6 / 1.336).abs() < 1e-6 && found["valid"] == true, "{found}");
    assert_eq!(found["velocity"], "NaN", "nobody tells it where the robot is: {found}");
    let lost = next("surface_lost", None);
    assert_eq!((&lost["valid"], &lost["snr_db"]), (&json!(false), &json!(0)), "{lost}");
    for (name, value) in
        [("dark", true), ("dark", false), ("saturated", false), ("dark", true), ("saturated", true)]
    {
        next(name, Some(value));
    }
    next("surface_found", None);
    let [ascan, surface] = ["host/ascan", "host/surface"].map(|component| site.row(component));
    let count = |name: &str| ascan[name].as_u64().unwrap();
    assert!(count("dark_lines") >= LINES as u64 && count("saturated_lines") > 0, "{ascan}");
    assert_eq!((count("refused_frames"), surface["refused_frames"].as_u64()), (0, Some(0)));
}

#[test]
fn background_window_range_and_dispersion_are_set_while_it_runs_and_what_cannot_be_is_refused() {
    let site = Site::with(&["oct"]);
    site.world.write("surface.u16", spectra(&[Light::Surface]));
    chain(&site, "surface.u16");
    let processor = |member: &str| format!("host/ascan/processor/{member}");
    let failed = |member: &str, arg: Value, words: &str| {
        site.refuses(&processor(member), &arg, "COMMAND_FAILED", words)
    };
    site.until("host/surface", "a surface", |row| row["last"]["valid"] == true);
    failed("set_dispersion", json!({ "a2": 1800, "a3": 4 }), "a2: 1800 rad is not within ±1000 rad");
    failed("set_dispersion", json!({ "a2": 1, "a3": "NaN" }), "a3: NaN rad is not within ±1000 rad");
    failed("set_window", json!("square"), "there are hann, hamming, blackman, rectangle");
    failed("set_range_db", json!({ "low": 90, "high": 45 }), "90 dB to 45 dB is no range");
    for lines in [255, 65537] {
        site.refuses(
            &processor("set_background"),
            &json!(lines),
            "ARGUMENT_INVALID",
            &format!("lines {lines} is"),
        );
    }
    site.call(&processor("set_window"), &json!("blackman")).ends_with(OK);
    site.call(&processor("set_range_db"), &json!({ "low": 40, "high": 90 })).ends_with(OK);
    assert_eq!(site.row("host/ascan")["range"], json!({ "low": 40, "high": 90 }));

    // A wrong one makes the surface wide and weak; the search finds that there is none in these spectra.
    let snr_db = || site.row("host/surface")["last"]["snr_db"].as_f64().unwrap();
    let sharp_db = snr_db();
    site.call(&processor("set_dispersion"), &json!({ "a2": 25, "a3": -10 })).ends_with(OK);
    site.until("host/surface", "weaker", |row| row["last"]["snr_db"].as_f64().unwrap() < sharp_db - 6.0);
    let found = site.event_of(&processor("dispersion_done"), &processor("auto_dispersion"), &Value::Null);
    assert!(found["taken"] == true && found["a2"].as_f64().unwrap().abs() < 0.5, "{found}");
    let taken = site.grpc.invoke(&processor("dispersion"), Value::Null);
    assert_eq!((&taken["a2"], &taken["a3"]), (&found["a2"], &found["a3"]));
    site.until("host/surface", "as sharp as before", |row| {
        row["last"]["snr_db"].as_f64().unwrap() > sharp_db - 1.0
    });

    // The surface does not move in this file: in a background it goes away with the rest.
    assert_eq!(site.event_of(&processor("background_done"), &processor("set_background"), &json!(256)), 256);
    site.until("host/surface", "nothing is left", |row| row["last"]["valid"] == false);
}

#[test]
fn a_file_that_is_no_raw_file_and_a_spectrometer_that_does_not_fit_are_refused_with_the_figures() {
    let site = Site::with(&["oct"]);
    for (name, bytes) in [("three.u16", 6144), ("odd.u16", 4097), ("empty.u16", 0)] {
        site.world.write(name, vec![0; bytes]);
    }
    site.world.write("good.u16", spectra(&[Light::Saturated]));
    site.trocar().run(&["create", "host/file", "oct_file"]).ends_with(OK).says("CREATED");
    let refused = |config: Value, words: &str| site.unfit("host/file", &config, "COMPONENT_REFUSED", words);
    refused(json!({ "path": "missing.u16" }), "path: missing.u16: cannot be read: No such file");
    refused(json!({ "path": "plugins" }), "path: plugins: is no regular file");
    refused(
        json!({ "path": "three.u16", "ascans": 2 }),
        "6144 B are no frames of 2 lines of 1024 u16, 4096 B each (2048 B are left over)",
    );
    refused(
        json!({ "path": "odd.u16" }),
        "4097 B are no frames of 1 lines of 1024 u16, 2048 B each (1 B are left over)",
    );
    refused(json!({ "path": "empty.u16" }), "path: empty.u16: is empty; name a file of raw spectra");
    refused(json!({ "path": "good.u16", "bits": 10 }), "more than 10 bits hold");
    site.unfit(
        "host/file",
        &json!({ "path": "good.u16", "ascan": 4 }),
        "CONFIG_INVALID",
        "did you mean ascans?",
    );
    site.unfit(
        "host/file",
        &json!({ "path": "good.u16", "samples": 10 }),
        "CONFIG_INVALID",
        "samples: 10 px is below 64 px",
    );
    site.configure("host/file", &json!({ "path": "three.u16", "ascans": 3 }));
    site.configure("host/file", &json!({ "path": "good.u16", "ascans": 1 }));

    site.grpc.create_with(
        "host/ascan",
        "oct_processor",
        json!({ "samples": 512 }),
        json!({ "stream_of": "host/file" }),
    );
    let refused = |config: Value, words: &str| site.unfit("host/ascan", &config, "COMPONENT_REFUSED", words);
    refused(
        json!({ "k_curve_rad_m": [1, 2, 3] }),
        "k_curve_rad_m: 3 wavenumbers for 512 pixels: give one for each",
    );
    refused(json!({ "wavelength_m": [0, 0, 0, 0] }), "wavelength_m: pixel 0 has the wavenumber inf rad/m");
    refused(json!({ "range_db": [95, 45] }), "range_db: 95 dB to 45 dB is no range");
    site.grpc.connect("host/ascan/spectra", "host/file/spectra");
    let mut events = site.grpc.stream(
        "InteractService/Subscribe",
        &json!({ "selections": [
        { "path": "host/ascan" }, { "path": "host/ascan/processor/refused" } ] }),
    );
    // What was there when the stream began is told first: from then on nothing is missed.
    events.until("the state", |item| item["path"] == "host/ascan");
    site.grpc.start("host/ascan");
    site.grpc.start("host/file");
    let why = events.until("why", |item| item["path"] == "host/ascan/processor/refused")["json"].clone();
    assert!(why.as_str().unwrap().contains("another number of pixels: configure samples"), "{why}");
    site.until("host/ascan", "counted", |row| {
        row["refused_frames"].as_u64() > Some(1) && row["processed"] == 0
    });
}
