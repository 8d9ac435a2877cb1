//! Speed of the sources on the bench: `cargo run --release -p trocar-stereo --example source_speed`.
//!
//! Invariant: pairs of 1024 × 768 RGB8. The bench keeps a copy of each frame, which is in these figures and
//! not in a host's.

use std::time::{Duration, Instant};

use trocar_sdk::data::StereoHeader;
use trocar_sdk::testing::Bench;
use trocar_stereo::{PhantomSource, PipeSource};

const SECONDS: f64 = 5.0;

fn main() {
    for format in ["rgb8", "bayer_rg8", "yuyv"] {
        let mut bench = Bench::<PhantomSource>::new(format!(r#"{{"format": "{format}"}}"#));
        let (begun, mut pairs) = (Instant::now(), 0);
        while begun.elapsed().as_secs_f64() < SECONDS {
            bench.step(1);
            pairs += bench.frames::<StereoHeader>("image").len();
        }
        println!("phantom_source {format}: {:.1} pairs/s", pairs as f64 / begun.elapsed().as_secs_f64());
    }
    let pipe = r#"{"command": ["cat", "/dev/zero"], "width": 1024, "height": 768, "layout": "stacked"}"#;
    let mut bench = Bench::<PipeSource>::new(pipe);
    let (begun, mut pairs, mut bytes, mut longest) = (Instant::now(), 0, 0, Duration::ZERO);
    while begun.elapsed().as_secs_f64() < SECONDS {
        let step = Instant::now();
        bench.step(1);
        longest = longest.max(step.elapsed());
        for (_, frame, _) in bench.frames::<StereoHeader>("image") {
            (pairs, bytes) = (pairs + 1, bytes + frame.len());
        }
        std::thread::yield_now();
    }
    let (seconds, sent) = (begun.elapsed().as_secs_f64(), bench.state().sent);
    println!(
        "pipe_source: {:.1} pairs/s, {:.0} MB/s, {} left out of {}; longest step {:.2} ms",
        f64::from(pairs) / seconds,
        bytes as f64 / seconds * 1e-6,
        sent.left_out,
        sent.emitted + sent.left_out,
        longest.as_secs_f64() * 1e3
    );
}
