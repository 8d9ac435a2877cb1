//! 1 kHz for a while: whether the grid holds, whether all periods are accounted for, and how late cycles
//! begin.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use serde_json::Value;
use trocar::model::Execution;

use crate::baseline;
use crate::lab::{Lab, as_number};
use crate::table::{Goal, Table, duration};

const PERIOD_NS: u64 = 1_000_000;

pub(crate) fn measure(table: &mut Table, seconds: u64) {
    let lab = Lab::new();
    lab.create("clock", "clock", Execution::default());
    lab.start();
    let stop = Arc::new(AtomicBool::new(false));
    let bare = baseline::sleeper(PERIOD_NS, stop.clone());
    thread::sleep(Duration::from_secs(seconds));
    stop.store(true, Ordering::Release);
    let mut bare = bare.join().expect("the sleeping thread does not panic");
    let figures = lab.invoke("clock/time/figures", Value::Null);
    let figure = |name: &str| as_number(&figures[name]);
    bare.sort_by(f64::total_cmp);
    let of_bare = |part: f64| bare[(bare.len() as f64 * part) as usize];
    table.title(&format!("1 kHz for {seconds} s"));
    let (executed, skipped, elapsed) = (figure("executed"), figure("skipped"), figure("elapsed"));
    let off = figure("off_grid");
    table.count("cycles off the grid", &format!("{off}"), "0", off == 0.0, &format!("{executed} cycles"));
    let sum = format!("{executed} + {skipped}");
    let exact = executed + skipped == elapsed;
    table.count("executed + skipped", &sum, &format!("{elapsed} elapsed"), exact, "the host's deadlines");
    // Both the first and the last step belong to what was counted; either may begin late.
    let clocked = figure("clocked") / PERIOD_NS as f64 + 1.0;
    let holds = (executed + skipped - clocked).abs() <= 1.0;
    let goal = format!("{} ± 1", executed + skipped);
    table.count(
        "periods by a clock read in the steps",
        &format!("{clocked:.2}"),
        &goal,
        holds,
        "executed + skipped",
    );
    let beside = "a bare loop of sleeps at the same time";
    table.row("lateness p50", figure("late_p50"), Goal::None, beside, of_bare(0.5));
    table.row("lateness p99", figure("late_p99"), Goal::Times(1.5), beside, of_bare(0.99));
    let worst = duration(figure("late_max"));
    table.count("latest cycle", &worst, "", true, &format!("{beside}: {}", duration(of_bare(1.0 - 1e-9))));
}
