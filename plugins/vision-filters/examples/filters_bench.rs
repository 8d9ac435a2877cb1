//! Times the filters on raw images and writes what they make, for `tests/bench/peers/vision.py`, which has
//! OpenCV do the same.
//!
//! Invariant: one thread; reads and writes plain bytes only; one JSON line for each filter.
//!
//! ```text
//! filters_bench ROUNDS RGB SENSOR YUYV WIDTH HEIGHT CALIBRATION OUT
//! ```
//! `RGB`, `SENSOR` (BAYER_RG8) and `YUYV` are images of `WIDTH` × `HEIGHT`; `OUT` is the beginning of the
//! names of results.

use std::path::Path;
use std::time::Instant;

use trocar_imaging::Calibration;
use trocar_sdk::data::PixelFormat;
use trocar_vision_filters::color::{To, convert_row};
use trocar_vision_filters::remap::Remap;
use trocar_vision_filters::resize::{Method, Resizer};
use trocar_vision_filters::view::{Format, Shape, View, ViewMut};
use trocar_vision_filters::{debayer, gray, pip};

type Failed = Box<dyn std::error::Error>;

struct Bench {
    rounds: usize,
    out: String,
}

impl Bench {
    /// Times `work` on `bytes`, then writes them.
    fn time(&self, name: &str, bytes: &mut [u8], mut work: impl FnMut(&mut [u8])) -> Result<(), Failed> {
        let mut times_ms: Vec<f64> = (0..self.rounds.max(1))
            .map(|_| {
                let begin = Instant::now();
                work(std::hint::black_box(bytes));
                begin.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times_ms.sort_by(f64::total_cmp);
        std::fs::write(format!("{}.{name}", self.out), bytes)?;
        let (least, median) = (times_ms[0], times_ms[times_ms.len() / 2]);
        println!(r#"{{"filter": "{name}", "min_ms": {least:.4}, "median_ms": {median:.4}}}"#);
        Ok(())
    }
}

fn main() -> Result<(), Failed> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [rounds, rgb, sensor, yuyv, width, height, calibration, out] = &args[..] else {
        return Err("filters_bench ROUNDS RGB SENSOR YUYV WIDTH HEIGHT CALIBRATION OUT".into());
    };
    let bench = Bench { rounds: rounds.parse()?, out: out.clone() };
    let (width, height): (usize, usize) = (width.parse()?, height.parse()?);
    let (rgb, sensor, yuyv) = (std::fs::read(rgb)?, std::fs::read(sensor)?, std::fs::read(yuyv)?);
    let colour = Shape { width, height, format: Format::Rgb8 };
    let grey = Shape { format: Format::Gray8, ..colour };
    let picture = View::packed(colour, &rgb)?;
    let mut three = vec![0; colour.packed_bytes()];

    let calibration = Calibration::load(Path::new(calibration))?;
    let (sx, sy) = (calibration.width as f64 / width as f64, calibration.height as f64 / height as f64);
    // The calibration's map, stretched to the size of the image.
    let map = Remap::new(width, height, |u, v| {
        let (x, y) = calibration.cameras[0].source(u * sx, v * sy);
        (x / sx, y / sy)
    });
    bench.time("remap", &mut three, |to| {
        let mut to = ViewMut::packed(colour, to).expect("made to fit");
        assert!(map.run(&picture, &mut to), "made for this size");
    })?;
    bench.time("gray", &mut vec![0; grey.packed_bytes()], |to| {
        gray::convert(&picture, &mut ViewMut::packed(grey, to).expect("made to fit"));
    })?;
    let mosaic = View::packed(grey, &sensor)?;
    bench.time("debayer", &mut three, |to| {
        for (y, to) in to.chunks_mut(3 * width).enumerate() {
            debayer::row(debayer::neighbours(grey.height, y).map(|y| mosaic.row(y)), y % 2 == 1, to);
        }
    })?;
    bench.time("yuyv", &mut three, |to| {
        for (from, to) in yuyv.chunks(2 * width).zip(to.chunks_mut(3 * width)) {
            assert!(convert_row(PixelFormat::YUYV, from, To::Rgb8, to), "a known format");
        }
    })?;
    let mut resizer = Resizer::new(colour, width / 3, height / 3, Method::Area);
    let mut small = vec![0; resizer.to().packed_bytes()];
    assert!(resizer.run(&picture, &mut ViewMut::packed(resizer.to(), &mut small)?), "made for this size");
    let inset = View::packed(resizer.to(), &small)?;
    three.copy_from_slice(&rgb);
    bench.time("pip", &mut three, |to| {
        let mut to = ViewMut::packed(colour, to).expect("made to fit");
        pip::lay(&inset, &mut to, 16, 16, 255);
    })
}
