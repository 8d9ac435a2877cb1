//! Matches pairs from raw files and times it, for `tests/bench/peers/vision.py`, which has the same pairs
//! matched by OpenCV.
//!
//! Invariant: reads and writes plain bytes only; one JSON line for each job, in the order of the jobs.
//!
//! ```text
//! depth_bench ROUNDS LEFT RIGHT WIDTH HEIGHT OUT METHOD=bm,N_DISP=96,BLOCK=15 …
//! ```

use std::time::Instant;

use trocar_sdk::data::{ImageHeader, PixelFormat};
use trocar_stereo_depth::{Matcher, Method, Settings};

type Failed = Box<dyn std::error::Error>;

fn main() -> Result<(), Failed> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [rounds, left, right, width, height, out, jobs @ ..] = &args[..] else {
        return Err("depth_bench ROUNDS LEFT RIGHT WIDTH HEIGHT OUT SETTINGS…".into());
    };
    let (rounds, width, height): (usize, u32, u32) = (rounds.parse()?, width.parse()?, height.parse()?);
    let (left, right) = (std::fs::read(left)?, std::fs::read(right)?);
    let header =
        ImageHeader { width, height, stride: width, format: PixelFormat::GRAY8, ..Default::default() };
    let (left, right) = (header.image(&left)?, header.image(&right)?);
    for (n, job) in jobs.iter().enumerate() {
        let (settings, portable) = settings(job)?;
        let make = if portable { Matcher::portable } else { Matcher::new };
        let mut matcher = make(width as usize, height as usize, settings)?;
        let mut map = vec![0; (width * height) as usize];
        let mut times_ms = Vec::with_capacity(rounds);
        for _ in 0..rounds.max(1) {
            let begin = Instant::now();
            let done = std::hint::black_box(&mut matcher).run(&left, &right, &mut map);
            times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
            assert!(done, "the images have the size the matcher was made for");
        }
        times_ms.sort_by(f64::total_cmp);
        let bytes: Vec<u8> = map.iter().flat_map(|d| d.to_le_bytes()).collect();
        std::fs::write(format!("{out}.{n}"), bytes)?;
        let (least, median) = (times_ms[0], times_ms[times_ms.len() / 2]);
        println!(r#"{{"job": "{job}", "min_ms": {least:.3}, "median_ms": {median:.3}}}"#);
    }
    Ok(())
}

/// `key=value` pairs over the defaults, and whether special instructions are left aside (`portable=1`).
fn settings(job: &str) -> Result<(Settings, bool), Failed> {
    let (mut s, mut portable) = (Settings::default(), false);
    for pair in job.split(',') {
        let (key, value) = pair.split_once('=').ok_or_else(|| format!("{pair}: no key=value"))?;
        match key {
            "method" => s.method = if value == "bm" { Method::Bm } else { Method::Sgm },
            "n_disp" => s.n_disp = value.parse()?,
            "block" => s.block = value.parse()?,
            "p1" => s.p1 = value.parse()?,
            "p2" => s.p2 = value.parse()?,
            "uniqueness" => s.uniqueness = value.parse()?,
            "texture" => s.texture = value.parse()?,
            "consistency" => s.consistency = value.parse()?,
            "portable" => portable = value == "1",
            _ => return Err(format!("{key}: no such setting").into()),
        }
    }
    Ok((s, portable))
}
