//! The guide's example, the sine into the new filter at 1 kHz, for as long as a first look takes.
//!
//! Promise: at most 0.1 % of all samples is lost between the two, on a machine with nothing else to do and
//! beside a program that keeps one processor busy. Only `./tests/run --times` runs these tests.

use serde_json::json;
use trocar_tests::{HostProcess, Trocar, World, eventually, number};

use super::{Path, Stdio, built_filter};

/// Samples that are waited for: twenty seconds.
const SAMPLES: u64 = 20_000;

/// A program that asks for a whole processor, until it is dropped.
struct Busy(std::process::Child);

impl Busy {
    fn start() -> Busy {
        let child =
            std::process::Command::new("sh").args(["-c", "while :; do :; done"]).stdin(Stdio::null()).spawn();
        Busy(child.unwrap())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn of_twenty_seconds_of_the_guides_example_one_in_a_thousand_is_lost_at_most_also_beside_a_busy_processor() {
    let world = World::with_plugins(&["sine"]);
    let file = built_filter(&world);
    let idle = lost(&file);
    let busy = {
        let _busy = Busy::start();
        lost(&file)
    };
    println!(
        "figure: of {SAMPLES} samples {idle} were lost on an idle machine, {busy} beside a busy processor"
    );
    for (when, lost) in [("on an idle machine", idle), ("beside a busy processor", busy)] {
        assert!(lost * 1000 <= SAMPLES, "{when}: {lost} of {SAMPLES} samples were lost");
    }
}

/// Types the guide's commands; gives the losses of its connection until so many samples had passed.
fn lost(file: &Path) -> u64 {
    let world = World::with_plugins(&["sine"]);
    world.drop_in(file);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "sine");
    grpc.await_class("host", "my_filter");
    let trocar = Trocar::at(&world, host.address());
    for words in [
        &["create", "host/source", "sine/sine"][..],
        &["create", "host/f", "my-filter/my_filter"],
        &["connect", "host/f/raw", "host/source/value"],
        &["start", "host/source", "host/f"],
    ] {
        trocar.run(words).ends_with(0);
    }
    let counts = || {
        let all = grpc.ok("GcmService/List", json!({}))["connections"].clone();
        let [passed, dropped, skipped] = ["passed", "dropped", "skipped"].map(|what| number(&all[0][what]));
        (passed, dropped + skipped)
    };
    let before = eventually("the filter takes samples", || match counts() {
        (0, _) => Err("none has passed".to_owned()),
        (passed, _) => Ok(passed),
    });
    let (_, lost) = eventually("the samples", || match counts() {
        counts @ (passed, _) if passed >= before + SAMPLES => Ok(counts),
        (passed, lost) => Err(format!("{passed} passed, {lost} lost")),
    });
    lost
}
